"""Data sets: cards, download and verification, indexing, splits and the views that methods and metrics get."""

from __future__ import annotations

#: Data set name to the class that opens it, as a lazy string; ``folder`` is asked for as ``folder:PATH``.
BUILTIN_DATASETS: dict[str, str] = {
    "synthetic": "benchmark.data.synthetic:SyntheticDataset",
    "kinder-gator": "benchmark.data.kinder_gator:KinderGator",
    "bandai-namco": "benchmark.data.bandai_namco:BandaiNamco",
    "adult2child": "benchmark.data.folder:Adult2Child",
    "folder": "benchmark.data.folder:FolderDataset",
}

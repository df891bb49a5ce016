"""What the contract asks of a probe."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from benchmark.api import FitContext, Probe, ProbeInfo, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, SmallView, perform, small_view
from benchmark.commands.conformance.methods import fingerprint
from benchmark.commands.conformance.outcome import Check, require
from benchmark.registry import PROBES

#: Beginnings of files that hold pickled objects: protocols 2 and later, and what old versions of torch write.
_PICKLES = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


@cache
def fitted(name: str) -> Probe:
    """The registered probe, fitted to the small view; once for all metrics that name it."""
    return fit(PROBES.get(name), small_view())


def fit(probe: type[Probe], view: SmallView, seed: int = 0) -> Probe:
    """A new probe, fitted to ``view``."""
    task = StyleTask(ADULT, CHILD, perform("walk", CHILD, 1).skeleton)
    return probe().fit(view, task, rng=np.random.default_rng(seed), ctx=FitContext())


class ProbeBench:
    """A probe class, and what it learns from a handful of clips."""

    def __init__(self, probe: type[Probe]) -> None:
        self.probe = probe

    @cached_property
    def view(self) -> SmallView:
        """The training clips."""
        return small_view()

    @cached_property
    def fitted(self) -> Probe:
        """The probe, fitted once."""
        return fit(self.probe, self.view)


def contents(probe: Probe) -> dict[str, object]:
    """Everything that a probe saves, by file and array, as things that can be compared."""
    found: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "probe"
        probe.save(folder)
        for path in sorted(folder.rglob("*")):
            where = path.relative_to(folder).as_posix()
            if path.suffix == ".npz":
                with np.load(path, allow_pickle=False) as arrays:
                    found |= {f"{where}/{key}": arrays[key].tobytes() for key in arrays.files}
            elif path.is_file():
                found[where] = path.read_bytes()
    return found


def _info(bench: ProbeBench) -> None:
    info = getattr(bench.probe, "info", None)
    require(isinstance(info, ProbeInfo), "set the class attribute info = ProbeInfo(name=…, summary=…)")
    assert isinstance(info, ProbeInfo)
    require(bool(info.summary.strip()) and "\n" not in info.summary, "info.summary must be one line")


def _learns(bench: ProbeBench) -> None:
    probe = bench.probe()
    before = {name for name in vars(probe) if name.endswith("_")}
    require(not before, f"the constructor sets {', '.join(sorted(before))}: only fit may")
    learned = [name for name in vars(bench.fitted) if name.endswith("_") and not name.startswith("_")]
    require(isinstance(bench.fitted, bench.probe), "fit must return self")
    require(bool(learned), "fit stores nothing in attributes that end in an underscore")


def _repeatable(bench: ProbeBench) -> None:
    again = fit(bench.probe, small_view())
    require(contents(again) == contents(bench.fitted), "the same clips and generator give two different probes")


def _save_load(bench: ProbeBench) -> None:
    before = contents(bench.fitted)
    require(bool(before), "save writes nothing")
    pickled = [name for name, data in before.items() if isinstance(data, bytes) and data.startswith(_PICKLES)]
    require(not pickled, f"{', '.join(pickled)} is pickled: write safetensors, npz or JSON")
    with tempfile.TemporaryDirectory() as name:
        bench.fitted.save(Path(name) / "probe")
        loaded = bench.probe.load(Path(name) / "probe")
    require(contents(loaded) == before, "what is loaded is not what was saved")


def _inputs_unchanged(bench: ProbeBench) -> None:
    view = small_view()
    clips = [*view.clips(ADULT), *view.clips(CHILD)]
    before = [fingerprint(clip) for clip in clips]
    fit(bench.probe, view)
    require(before == [fingerprint(clip) for clip in clips], "fit writes to the training clips")


PROBE_CHECKS: Sequence[Check] = (
    Check("info", "info is complete", _info),
    Check("learns", "fit learns, and nothing else does", _learns),
    Check("repeatable", "the same clips and generator give the same probe", _repeatable),
    Check("save-load", "a loaded probe is the one that was saved, and no file is pickled", _save_load),
    Check("inputs-unchanged", "no training clip is written to", _inputs_unchanged),
)

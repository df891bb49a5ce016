"""Lossless clip files: arrays in an ``.npz``, everything else as JSON inside it; nothing in them can execute."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmark.errors import BenchmarkError, MotionFileError
from benchmark.motion._atomic import atomic_write
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import EndSite, Skeleton


def save(clip: MotionClip, path: Path | str) -> None:
    """Write ``clip`` to ``path``, bit for bit (the raw channels of its source file excepted), whole or not at all."""
    skeleton = clip.skeleton
    header = {
        "names": skeleton.names,
        "parents": skeleton.parents.tolist(),
        "orders": skeleton.orders,
        "roles": dict(skeleton.roles),
        "end_sites": [[end.parent, list(end.offset)] for end in skeleton.end_sites],
        "fps": clip.fps,
        "meta": asdict(clip.meta),
    }
    arrays = {"offsets": skeleton.offsets, "rotations": clip.rotations, "root": clip.root}
    if clip.translations is not None:
        arrays["translations"] = clip.translations
    if clip.residual is not None:
        arrays["residual"] = clip.residual
    text = np.frombuffer(json.dumps(header, sort_keys=True).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, header=text, **arrays)  # type: ignore[arg-type]
    atomic_write(Path(path), (buffer.getvalue(),))


def load(path: Path | str) -> MotionClip:
    """Read a clip written by :func:`save`; a :class:`~benchmark.errors.MotionFileError` names a damaged file."""
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
            arrays = {name: file[name] for name in file.files if name != "header"}
        skeleton = Skeleton(
            tuple(header["names"]),
            np.array(header["parents"]),
            arrays["offsets"],
            tuple(EndSite(parent, tuple(offset)) for parent, offset in header["end_sites"]),
            tuple(header["orders"]),
            header["roles"],
        )
        return MotionClip(
            skeleton,
            arrays["rotations"],
            arrays["root"],
            header["fps"],
            ClipMeta(**header["meta"]),
            arrays.get("translations"),
            arrays.get("residual"),
        )
    except FileNotFoundError:
        raise MotionFileError(path, "no such file") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, BenchmarkError) as error:
        raise MotionFileError(path, f"not a clip written by this suite ({error})") from error

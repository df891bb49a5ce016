"""Lossless clip files: arrays in an ``.npz``, everything else as JSON inside it; nothing in them can execute."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

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


def read_arrays(path: Path | str) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file as :func:`numpy.savez` writes it, by name.

    Nothing is unpickled, and nothing is made that is larger than the file: members must be stored, not compressed, and as long
    as their headers say.

    Raises
    ------
    MotionFileError
        Naming the file, and the member that is damaged, compressed, or holds objects.
    """
    path = Path(path)
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > path.stat().st_size:
                raise MotionFileError(
                    path, "its members are larger than the file: compressed, or not written by this suite"
                )
            arrays = {}
            for member in members:
                with archive.open(member) as stream:
                    arrays[member.filename.removesuffix(".npy")] = _read_array(stream, member.file_size)
            return arrays
    except FileNotFoundError:
        raise MotionFileError(path, "no such file") from None
    except MotionFileError:
        raise
    except Exception as error:  # zipfile, zlib and the reader of headers say many things of damaged bytes
        raise MotionFileError(
            path, f"not a clip or arrays written by this suite ({type(error).__name__}: {error})"
        ) from error


_HEADERS: dict[tuple[int, int], Callable[..., tuple[tuple[int, ...], bool, np.dtype]]] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def _read_array(stream: IO[bytes], size: int) -> NDArray[Any]:
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"an array of format {version[0]}.{version[1]}")
    shape, by_columns, dtype = _HEADERS[version](stream)
    if dtype.hasobject:
        raise ValueError("an array of Python objects, which only pickle could read")
    data = stream.read()
    if any(length < 0 for length in shape) or math.prod(shape) * dtype.itemsize != len(data) or len(data) > size:
        raise ValueError(f"an array of shape {shape} and type {dtype} in {len(data)} bytes")
    return np.frombuffer(bytearray(data), dtype).reshape(shape, order="F" if by_columns else "C")


def load(path: Path | str) -> MotionClip:
    """Read a clip written by :func:`save`; a :class:`~benchmark.errors.MotionFileError` names a damaged file."""
    path = Path(path)
    arrays = read_arrays(path)
    try:
        header = json.loads(arrays.pop("header").tobytes())
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
    except (
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        IndexError,
        OverflowError,
        RecursionError,
        BenchmarkError,
    ) as error:
        raise MotionFileError(path, f"not a clip written by this suite ({type(error).__name__}: {error})") from error

"""What a probe has learned, as arrays and JSON facts in a folder; nothing in the files can execute."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import MotionFileError, StoreError

_ARRAYS, _FACTS = "arrays.npz", "facts.json"


def write_arrays(folder: Path, arrays: Mapping[str, NDArray], facts: Mapping[str, Any]) -> None:
    """Write arrays, bit for bit, and JSON-ready facts into ``folder``, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / _ARRAYS, **arrays)  # type: ignore[arg-type]
    (folder / _FACTS).write_text(json.dumps(facts, indent=2, sort_keys=True, allow_nan=False))


def read_arrays(folder: Path) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """What :func:`write_arrays` wrote; a :class:`~benchmark.errors.StoreError` for a folder that holds nothing of that kind."""
    from benchmark.motion.npz import read_arrays as read_npz

    try:
        return read_npz(folder / _ARRAYS), json.loads((folder / _FACTS).read_text())
    except (OSError, ValueError, RecursionError, MotionFileError) as error:
        raise StoreError(f"{folder} holds no probe of this suite ({error}): remove it and fit again") from error

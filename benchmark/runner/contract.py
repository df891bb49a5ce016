"""Whether a result keeps the contract of :mod:`benchmark.api`."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmark.api import Capabilities, StyleTask, TransferResult
from benchmark.digest import canonical_json
from benchmark.errors import ConfigError, ContractError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton

#: How many times as long as its source a result may be; more would fill memory and disk and is no rendering of the source.
#: A source shorter than a second counts as one: a copied clip may be long beside it.
LONGEST = 50

#: Metres by which a result's bones may differ from the skeleton it is said to be on.
BONE_TOLERANCE = 1e-6


def check_result(result: Any, source: MotionClip, task: StyleTask, capabilities: Capabilities) -> TransferResult:
    """Return ``result`` if it is what the capabilities promise.

    Parameters
    ----------
    result
        What ``transfer`` returned.
    source
        The clip it was given.
    task
        The task it was given.
    capabilities
        What the method says of itself.

    Raises
    ------
    ContractError
        Naming the promise that was broken.
    """
    if not isinstance(result, TransferResult):
        raise ContractError(f"transfer must return a TransferResult, not {type(result).__name__}")
    for name in ("clip", "raw_clip", "round_trip"):
        clip = getattr(result, name)
        if clip is None and name != "clip":
            continue
        _check_clip(clip, name, source)
    clip = result.clip
    if not capabilities.uses_reference:
        _check_skeleton(clip.skeleton, source.skeleton, task, capabilities)
    if not capabilities.changes_timing and len(clip) != len(source):
        raise ContractError(
            f"the result has {len(clip)} frames and the source {len(source)}, but changes_timing is False"
        )
    if len(clip) > LONGEST * max(len(source), round(source.fps)):
        raise ContractError(
            f"the result has {len(clip)} frames, more than {LONGEST} times those of the source, {len(source)}"
        )
    if result.time_map is not None:
        _check_time_map(result.time_map, clip, source)
    if result.contacts is not None:
        contacts = np.asarray(result.contacts)
        if contacts.dtype != np.bool_ or contacts.ndim != 2 or len(contacts) != len(clip):
            raise ContractError(
                f"contacts must be booleans of shape ({len(clip)}, F), not {contacts.dtype} {contacts.shape}"
            )
    if result.copied_from is not None and not isinstance(result.copied_from, str):
        raise ContractError(f"copied_from must be a clip id, not {result.copied_from!r}")
    try:
        canonical_json(dict(result.diagnostics))
    except (ConfigError, TypeError, ValueError) as error:
        raise ContractError(f"diagnostics must be ready for JSON: {error}") from error
    return result


def _check_clip(clip: Any, name: str, source: MotionClip) -> None:
    if not isinstance(clip, MotionClip):
        raise ContractError(f"the result's {name} must be a MotionClip, not {type(clip).__name__}")
    # A clip checks itself when it is made; arrays altered afterwards would escape that.
    for part in ("rotations", "root"):
        if not np.all(np.isfinite(getattr(clip, part))):
            raise ContractError(f"{part} of the result's {name} are not finite")
    if np.max(np.abs(np.sum(clip.rotations**2, axis=-1) - 1.0)) > 1e-6:
        raise ContractError(f"rotations of the result's {name} are not unit quaternions")
    if abs(clip.fps - source.fps) > 1e-9 * source.fps:
        raise ContractError(f"the result's {name} has {clip.fps:g} frames per second and the source {source.fps:g}")


def _check_skeleton(found: Skeleton, source: Skeleton, task: StyleTask, capabilities: Capabilities) -> None:
    onto_target = capabilities.changes_proportions and task.target_skeleton is not None
    expected = task.target_skeleton if onto_target and task.target_skeleton is not None else source
    whose = "task.target_skeleton" if onto_target else "the source's skeleton"
    promise = f"changes_proportions is {capabilities.changes_proportions}"
    if not found.same_topology(expected):
        raise ContractError(f"the result's joints are not those of {whose}, but {promise}")
    gap = np.linalg.norm(found.offsets[1:] - expected.offsets[1:], axis=-1)
    if len(gap) and gap.max() > BONE_TOLERANCE:
        joint = found.names[int(gap.argmax()) + 1]
        raise ContractError(f"the bone to {joint!r} is {gap.max():.3g} m off that of {whose}, but {promise}")


def _check_time_map(time_map: Any, clip: MotionClip, source: MotionClip) -> None:
    times = np.asarray(time_map)
    if times.shape != (len(clip),) or not np.issubdtype(times.dtype, np.floating):
        raise ContractError(f"time_map must be floats of shape ({len(clip)},), not {times.dtype} {times.shape}")
    if not np.all(np.isfinite(times)):
        raise ContractError("time_map is not finite")
    if np.any(np.diff(times) < 0):
        frame = int(np.argmax(np.diff(times) < 0)) + 1
        raise ContractError(f"time_map falls at frame {frame}: it must be non-decreasing")
    slack = 0.5 / source.fps
    if times[0] < -slack or times[-1] > source.duration + slack:
        raise ContractError(
            f"time_map runs from {times[0]:.3f} to {times[-1]:.3f} s, outside the source's 0 to {source.duration:.3f} s"
        )

"""The motion that the page plays: joint positions of the input, every method and a real performer, packed into its HTML."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.runner.execute import load_extras
from reports.html.bodies import Body, body_points, make_body
from reports.run import FLOOR, RunView, StoredCell

#: Bytes that all moving pictures may take on the page.
BUDGET = 10_000_000

#: Frames a second that are stored at most; a screen shows what lies between by interpolation.
FPS = 30.0

#: Of longer performances only the beginning is shown.
LONGEST = 20.0

#: After so many clips that did not fit no shorter ones are looked for.
_REFUSED = 3

#: Steps a second at which it is stored where a figure is in its course while the input is at a time.
_PHASE_RATE = 10.0


@dataclass
class Reel:
    """Everything the page plays.

    Attributes
    ----------
    clips
        JSON of each clip: the figures and their packed positions.
    index
        JSON of what is needed before a clip is chosen: titles and bodies.
    notes
        What a viewer must know: cut clips, clips left out.
    """

    clips: list[dict[str, Any]] = field(default_factory=list)
    index: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def make_reel(run: RunView, budget: int = BUDGET) -> Reel:
    """One clip of each action and task, those of unseen actors first, as many as fit into ``budget`` bytes.

    Every task has an equal share. Results are the raw ones of the first repetition that has one.
    """
    reel, bodies = Reel(), _Bodies()
    share = budget // max(1, len(run.tasks))
    wanted = cut = 0
    for task in run.tasks:
        cells = run.cells(task)
        chosen = choose_clips(run, task, cells)
        wanted += len(chosen)
        used = refused = 0
        for clip_id in chosen:
            if refused == _REFUSED:
                break
            clip, short = _clip(run, task, cells, clip_id, bodies)
            size = sum(len(figure["data"]) for figure in clip["figures"])
            if used + size > share:
                refused += 1
                continue
            used += size
            cut += short
            reel.clips.append(clip)
    reel.index = {
        "bodies": [body.to_json() for body in bodies.all],
        "clips": [{"task": clip["task"], "title": clip["title"]} for clip in reel.clips],
    }
    if len(reel.clips) < wanted:
        reel.notes.append(f"{len(reel.clips)} of {wanted} actions are here, as many as the page has room for.")
    if cut:
        reel.notes.append(f"Of {cut} clips only the first {LONGEST:g} seconds are shown.")
    return reel


def choose_clips(run: RunView, task: str, cells: Sequence[StoredCell]) -> list[str]:
    """One source clip of each action: the one that most methods have a result for, of an unseen actor where there is one.

    The clip that moves most (the one of the pose strips) stands first, the others by action.
    """
    counts: dict[str, int] = {}
    facts: dict[str, dict[str, Any]] = {}
    for cell in cells:
        for item in cell.items:
            if item["state"] == "ok":
                counts[item["clip_id"]] = counts.get(item["clip_id"], 0) + 1
                facts[item["clip_id"]] = item
    best: dict[str, str] = {}
    for clip_id in sorted(counts, key=lambda name: (-counts[name], bool(facts[name]["seen_actor"]), name)):
        best.setdefault(str(facts[clip_id]["action"]), clip_id)
    first = run.showpiece(task)
    if first is not None:
        best[str(facts[first]["action"])] = first
    return sorted(best.values(), key=lambda clip_id: (clip_id != first, str(facts[clip_id]["action"]), clip_id))


class _Bodies:
    """The bodies of all figures, each once."""

    def __init__(self) -> None:
        self.all: list[Body] = []

    def place(self, clip: MotionClip) -> int:
        body = make_body(clip.skeleton)
        if body not in self.all:
            self.all.append(body)
        return self.all.index(body)


def _clip(
    run: RunView, task: str, cells: Sequence[StoredCell], clip_id: str, bodies: _Bodies
) -> tuple[dict[str, Any], bool]:
    source_style, _, target_style = task.partition(":")
    found: dict[str, tuple[MotionClip, StoredCell, dict[str, Any]]] = {}
    reasons: dict[str, str] = {}
    for cell in cells:
        item = next((item for item in cell.items if item["clip_id"] == clip_id), None)
        clip = cell.clip(clip_id)
        if clip is not None and item is not None:
            found.setdefault(cell.method, (clip, cell, item))
        elif item is not None:
            reasons.setdefault(cell.method, str(item["reason"] or "no result for this clip"))
    empty = run.results[run.results["cell_key"].isin(run.empty_cells) & (run.results["task"] == task)]
    for row in empty[["method", "status", "reason"]].drop_duplicates("method").to_dict("records"):
        reasons.setdefault(row["method"], f"{row['status']}: {row['reason']}")
    # Without the floor's row there is no input to keep step with; then the longest result is the clock.
    input_clip = (
        found[FLOOR][0] if FLOOR in found else max((entry[0] for entry in found.values()), key=lambda c: c.duration)
    )
    figures = [
        _figure(run, method, (source_style, target_style), clip, cell, item, input_clip, bodies)
        for method, (clip, cell, item) in found.items()
    ]
    facts = run.clip_facts(clip_id)
    seen = "seen in training" if facts["seen_actor"] else "not seen in training"
    who = f"{facts['actor'] or 'an unnamed actor'}, {seen}"
    return {
        "id": clip_id,
        "task": f"{source_style} to {target_style}",
        "title": f"{str(facts['action']).replace('-', ' ')} ({who})",
        "seconds": round(min(LONGEST, input_clip.duration), 4),
        "figures": figures,
        "missing": [
            {"label": run.label(method), "reason": why} for method, why in reasons.items() if method not in found
        ],
    }, any(clip.duration > LONGEST for clip, _, _ in found.values())


def _figure(
    run: RunView,
    method: str,
    styles: tuple[str, str],
    clip: MotionClip,
    cell: StoredCell,
    item: dict[str, Any],
    input_clip: MotionClip,
    bodies: _Bodies,
) -> dict[str, Any]:
    source_style, target_style = styles
    place = bodies.place(clip)
    role = {FLOOR: "input", run.real_method: "real"}.get(method, "method")
    label = {"input": f"{source_style} input", "real": f"real {target_style}"}.get(role, method)
    if role == "real" and run.dataset == "synthetic":
        label = f"held-out {target_style}"
    note = f"on the {target_style}'s body" if role == "input" else ""
    if role == "real":
        note = clip.meta.actor
    elif item.get("copied_from"):
        note = "copy of a training clip"
    extras = load_extras(cell.folder / "outputs" / f"{item['stem']}.extras.npz")
    fps, positions = thin(body_points(clip, bodies.all[place]), clip.fps)
    return {
        "method": method,
        "label": label,
        "role": role,
        "note": note,
        "body": place,
        "fps": round(fps, 6),
        **pack(positions),
        "phase": phase(
            clip, input_clip, extras.get("time_map"), follows=role != "real" and not item.get("copied_from")
        ),
    }


def thin(positions: NDArray[np.float64], fps: float) -> tuple[float, NDArray[np.float64]]:
    """Positions (T, P, 3) at :data:`FPS` frames a second if they have more, and their first :data:`LONGEST` seconds only."""
    rate = min(FPS, fps)
    duration = min((len(positions) - 1) / fps, LONGEST)
    times = np.arange(int(duration * rate + 1e-6) + 1) / rate
    if rate == fps:
        return rate, positions[: len(times)]
    at = np.clip(times * fps, 0.0, len(positions) - 1.0)
    low = np.minimum(at.astype(int), len(positions) - 1)
    high = np.minimum(low + 1, len(positions) - 1)
    share = (at - low)[:, None, None]
    return rate, positions[low] * (1.0 - share) + positions[high] * share


def pack(positions: NDArray[np.float64]) -> dict[str, Any]:
    """Positions (T, P, 3) as 16-bit steps from a corner of the room they need, in base64 (little endian).

    A step is the widest range over 65535: 0.15 mm for someone who moves within 10 m.
    """
    corner = positions.min(axis=(0, 1))
    step = max(float((positions - corner).max()) / 65535.0, 1e-6)
    steps = np.round((positions - corner) / step).astype("<u2")
    return {
        "frames": len(positions),
        "corner": [round(float(value), 6) for value in corner],
        "step": step,
        "data": base64.b64encode(steps.tobytes()).decode(),
    }


def unpack(packed: dict[str, Any], points: int) -> NDArray[np.float64]:
    """The positions (T, P, 3) that :func:`pack` packed, as the page's script reads them."""
    steps = np.frombuffer(base64.b64decode(packed["data"]), "<u2").reshape(packed["frames"], points, 3)
    return np.asarray(packed["corner"]) + packed["step"] * steps


def phase(
    clip: MotionClip, source: MotionClip, time_map: NDArray[np.float64] | None, *, follows: bool
) -> list[int] | None:
    """Milliseconds into ``clip`` that show what ``source`` shows at every tenth of a second.

    ``None`` for a result on the source's own clock. With a stored time map it is turned round; a performance that follows no
    input (real ones, copies of real ones) goes through its own course evenly.
    """
    times = np.arange(0.0, source.duration + 1.0 / _PHASE_RATE, 1.0 / _PHASE_RATE).clip(max=source.duration)
    if time_map is not None:
        seconds = np.interp(times, np.maximum.accumulate(time_map), clip.times[: len(time_map)])
    elif not follows:
        seconds = times * (clip.duration / max(source.duration, 1e-9))
    else:
        return None
    return np.round(1e3 * seconds).astype(int).tolist()

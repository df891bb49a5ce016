"""One cell: fit, transfer every test clip, check each result, and store it all."""

from __future__ import annotations

import contextlib
import json
import re
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.api import (
    Capabilities,
    FitContext,
    Method,
    NotApplicableError,
    StyleTask,
    Supervision,
    TrainView,
    TransferResult,
)
from benchmark.data.base import Dataset
from benchmark.data.views import EvalItem, eval_items, target_skeleton, train_view
from benchmark.errors import BenchmarkError, ContractError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton
from benchmark.runner.contract import check_result
from benchmark.runner.items import ITEMS
from benchmark.runner.job import CellJob, Report
from benchmark.runner.plan import limited
from benchmark.runner.store import RunStore, printable
from benchmark.seeding import generator

#: Files of a cell besides its outputs.
TARGET, MODEL, OUTPUTS = "target-skeleton.npz", "model", "outputs"

#: Training curves, which a method that trains writes beside its model and which are kept beside the results.
CURVES = "train.parquet"

#: Training curves for TensorBoard, which a method writes in its working folder if asked to, kept beside the results.
EVENTS = "tensorboard"

#: In the name of a result that was translated back to the source style.
ROUND_TRIP = "round-trip"


class CellSkippedError(Exception):
    """Raised where a cell turns out not to apply; the message is the reason."""


@dataclass
class _Log:
    """Lines of ``log.jsonl``: seconds since the cell began, the stage, and what the method says, at most one a second."""

    report: Report
    began: float = field(default_factory=time.perf_counter)
    lines: list[str] = field(default_factory=list)
    last: float = -1.0

    def __call__(self, stage: str, fraction: float, message: str, *, always: bool = False) -> None:
        now = time.perf_counter() - self.began
        message = printable(str(message))
        if always or now - self.last >= 1.0:
            self.last = now
            line = {"seconds": round(now, 3), "stage": stage, "fraction": round(float(fraction), 4), "message": message}
            self.lines.append(json.dumps(line, ensure_ascii=False))
        self.report(stage, fraction, message)

    @property
    def text(self) -> str:
        return "\n".join(self.lines) + "\n"


def execute_cell(job: CellJob, report: Report) -> None:
    """Run one cell and store it as ``ok``, ``skipped`` or ``failed``; whatever the method does wrong ends in the store."""
    store = RunStore(job.folder)
    log = _Log(report)
    try:
        with store.writing(job.cell.key) as folder:
            facts = _run(job, store, folder, log)
            (folder / "log.jsonl").write_text(log.text, encoding="utf-8")
            (folder / "cell.json").write_text(
                json.dumps(job.cell.to_json(), indent=1, sort_keys=True), encoding="utf-8"
            )
            store.commit(job.cell.key, folder, "ok", facts=facts)
    except (CellSkippedError, NotApplicableError) as skipped:
        with store.writing(job.cell.key) as folder:
            (folder / "log.jsonl").write_text(log.text, encoding="utf-8")
            store.commit(job.cell.key, folder, "skipped", str(skipped))
    except Exception as error:  # a plug-in may raise anything
        store.commit_failure(job.cell.key, describe(error), traceback.format_exc(), log.text)


def describe(error: BaseException) -> str:
    """An exception in one line."""
    text = " ".join(str(error).split())
    if isinstance(error, BenchmarkError) and not isinstance(error, ContractError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _run(job: CellJob, store: RunStore, folder: Path, log: _Log) -> dict[str, Any]:
    cell = job.cell
    source_style, target_style = cell.styles
    log("prepare", 0.0, "opening the data set", always=True)
    dataset, split = job.dataset.open(), job.load_split()
    items = limited(eval_items(dataset, split, source_style, target_style), job.limit)
    cls = job.load_method()
    needs = cls.info.capabilities
    skeleton = target_skeleton(dataset, split, target_style)
    lacking = [role for role in needs.required_roles if not skeleton.has(role)]
    if lacking:
        raise CellSkippedError(
            f"the target skeleton has no joint in the role{'s'[: len(lacking) > 1]} {', '.join(lacking)}"
        )
    task = StyleTask(source_style, target_style, skeleton)
    _save_skeleton(skeleton, dataset.fps, folder / TARGET)

    work = store.work(cell.key)
    work.mkdir(parents=True, exist_ok=True)
    context = FitContext(cell.device, work, lambda fraction, message: log("fit", fraction, message))
    method = cls(**cell.params)
    train = train_view(dataset, split, source_style, target_style)
    _read_ahead(dataset, items, train, needs, log)
    reset_peak_memory()
    log("fit", 0.0, "", always=True)
    start = time.perf_counter()
    fitted = method.fit(train, task, rng=generator(seed=cell.seed, stage="fit"), ctx=context)
    fit_seconds = time.perf_counter() - start
    if fitted is not method:
        raise ContractError(f"{cls.__name__}.fit must return self, not {type(fitted).__name__}")

    (folder / OUTPUTS).mkdir()
    rows: list[dict[str, Any]] = []
    for index, item in enumerate(items):
        log("transfer", index / len(items), item.record.clip_id, always=True)
        try:
            rows.append(_transfer(job, dataset, method, task, item, index, folder / OUTPUTS))
        except (CellSkippedError, NotApplicableError) as skipped:
            rows.append({**_item_facts(item), "state": "skipped", "reason": str(skipped)})
        except Exception as error:
            error.add_note(f"while transferring clip {item.record.clip_id}")
            raise
    done = [row for row in rows if row["state"] == "ok"]
    if not done:
        raise CellSkippedError("; ".join(sorted({row["reason"] for row in rows})))
    log("save", 1.0, "", always=True)
    method.save(folder / MODEL)
    curves = folder / MODEL / CURVES
    if curves.is_file():
        curves.replace(folder / CURVES)
    if (work / EVENTS).is_dir():
        (work / EVENTS).replace(folder / EVENTS)
    (folder / ITEMS).write_text(json.dumps(rows, indent=1, sort_keys=True, ensure_ascii=False), encoding="utf-8")
    return {
        "costs": {
            "fit_seconds": fit_seconds,
            "peak_memory": peak_memory(),
            "parameters": count_parameters(method),
            "model_bytes": sum(path.stat().st_size for path in (folder / MODEL).rglob("*") if path.is_file()),
        }
    }


def _read_ahead(dataset: Dataset, items: Sequence[EvalItem], train: TrainView, needs: Capabilities, log: _Log) -> None:
    """Read the clips the method will be given, so that neither its time nor its memory includes making them canonical."""
    for index, item in enumerate(items):
        log("prepare", index / len(items), f"reading {item.record.clip_id}")
        dataset.load(item.record.clip_id)
    if needs.supervision != Supervision.NONE:
        log("prepare", 1.0, "reading the training clips")
        train.clips()


def _item_facts(item: EvalItem) -> dict[str, Any]:
    record = item.record
    return {
        "clip_id": record.clip_id,
        "actor": record.actor,
        "action": record.action,
        "seen_actor": item.seen_actor,
        "reference_ids": list(item.reference_ids),
        "has_truth": item.has_truth,
    }


def _transfer(
    job: CellJob, dataset: Dataset, method: Method, task: StyleTask, item: EvalItem, index: int, folder: Path
) -> dict[str, Any]:
    from benchmark.motion import bvh, footlock, npz

    cell, needs, clip_id = job.cell, method.info.capabilities, item.record.clip_id
    source = dataset.load(clip_id)
    if len(source) < needs.min_frames:
        raise CellSkippedError(f"the clip has {len(source)} frames, fewer than the {needs.min_frames} the method needs")
    lacking = [role for role in needs.required_roles if not source.skeleton.has(role)]
    if lacking:
        raise CellSkippedError(f"the clip's skeleton has no joint in the role {', '.join(lacking)}")
    if needs.uses_reference:
        task = replace(task, reference=_reference(job, dataset, task, item))
    rng = generator(seed=cell.seed, stage="transfer", clip=clip_id)
    start = time.perf_counter()
    result = method.transfer(source, task, rng=rng)
    seconds = time.perf_counter() - start
    result = check_result(result, source, task, needs)

    stem = f"{index:04d}-" + re.sub(r"[^A-Za-z0-9.-]+", "_", clip_id)
    variants: dict[str, str | None] = {}
    for variant in job.variants:
        try:
            clip = result.clip if variant == "raw" else footlock.lock_feet(result.clip)
        except BenchmarkError as error:
            variants[variant] = f"the foot lock cannot be applied: {error}"
            continue
        npz.save(clip, folder / f"{stem}.{variant}.npz")
        bvh.save(clip, folder / f"{stem}.{variant}.bvh")
        variants[variant] = None
    if result.raw_clip is not None:
        npz.save(result.raw_clip, folder / f"{stem}.unprocessed.npz")
    if result.round_trip is not None:
        npz.save(result.round_trip, folder / f"{stem}.{ROUND_TRIP}.npz")
    _save_extras(result, folder / f"{stem}.extras.npz")
    return {
        **_item_facts(item),
        "state": "ok",
        "reason": "",
        "stem": stem,
        "variants": variants,
        "frames": len(result.clip),
        "transfer_seconds": seconds,
        "fit_residual": fit_residual(source),
        "copied_from": result.copied_from,
        "diagnostics": dict(result.diagnostics),
    }


def fit_residual(clip: MotionClip) -> dict[str, float] | None:
    """How far measured joints are from the rigid skeleton fitted to them, metres: median and 95th percentile.

    ``None`` for captures that hold rotations.
    """
    if clip.residual is None:
        return None
    median, high = np.percentile(clip.residual[:, 1:], [50.0, 95.0])
    return {"median": float(median), "p95": float(high)}


def _reference(job: CellJob, dataset: Dataset, task: StyleTask, item: EvalItem) -> MotionClip:
    """One of the real target clips of the action: drawn once per source clip, the same for every method and repetition."""
    if not item.reference_ids:
        raise CellSkippedError(
            f"there is no real {task.target_style} clip of {item.record.action!r} outside the training set"
        )
    rng = generator(seed=job.seed, dataset=dataset.id, task=str(task), stage="reference", clip=item.record.clip_id)
    return dataset.load(item.reference_ids[int(rng.integers(len(item.reference_ids)))])


def _save_skeleton(skeleton: Skeleton, fps: float, path: Path) -> None:
    from benchmark.motion import npz, quat

    rest = MotionClip(skeleton, quat.identity(1, len(skeleton)), np.zeros((1, 3)), fps)
    npz.save(rest, path)


def _save_extras(result: TransferResult, path: Path) -> None:
    arrays = {
        name: np.asarray(value) for name in ("time_map", "contacts") if (value := getattr(result, name)) is not None
    }
    if arrays:
        with path.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]


def load_extras(path: Path) -> dict[str, np.ndarray]:
    """``time_map`` and ``contacts`` of a stored result, those it has."""
    if not path.exists():
        return {}
    from benchmark.motion import npz

    return npz.read_arrays(path)


def reset_peak_memory() -> None:
    """Start measuring peak memory anew, where the system can (Linux); elsewhere the peak is that of the whole process."""
    # Writing 5 resets the high-water mark of the resident set: proc_pid_clear_refs(5).
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory() -> int | None:
    """Largest resident memory of this process in bytes since the reset, with interpreter, libraries and clips in it."""
    try:
        import resource
    except ImportError:  # Windows
        import psutil

        return int(psutil.Process().memory_info().peak_wset)
    import sys

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def count_parameters(method: Method) -> int:
    """How many numbers ``fit`` learned: elements of arrays, tensors and floats in the attributes that end in ``_``."""
    return sum(_count(getattr(method, name), 0) for name in method.learned())


def _count(value: Any, depth: int) -> int:
    if depth > 8 or isinstance(value, str | bytes | bool | int):
        return 0
    if isinstance(value, float | np.floating):
        return 1
    if isinstance(value, np.ndarray):
        return int(value.size)
    if callable(getattr(value, "parameters", None)):
        return sum(int(parameter.numel()) for parameter in value.parameters())
    if callable(getattr(value, "numel", None)):
        return int(value.numel())
    if isinstance(value, Mapping):
        return sum(_count(item, depth + 1) for item in value.values())
    if isinstance(value, list | tuple | set | frozenset):
        return sum(_count(item, depth + 1) for item in value)
    if isinstance(value, MotionClip):
        return int(value.rotations.size + value.root.size)
    if is_dataclass(value) and not isinstance(value, type):
        return sum(_count(getattr(value, part.name), depth + 1) for part in fields(value))
    return 0

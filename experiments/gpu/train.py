"""Train a method of the suite on a machine that has torch and little else, and bring back what came out.

Two steps on two machines, both from the root of a checkout:

    python -m experiments.gpu.train collect carry/kinder-gator -d kinder-gator     # where the suite is installed
    python -m experiments.gpu.train fit carry/kinder-gator -o out --device cuda    # where the GPU is

The first writes the training clips, the clips to transfer and the target's body as files (no code, no pickle). The second needs
Python 3.11, numpy, scipy, torch, safetensors and pyarrow, and none of the suite's other dependencies.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.api import FitContext, Method, StyleTask
from benchmark.errors import BenchmarkError
from benchmark.motion import npz
from benchmark.motion.clip import MotionClip
from benchmark.seeding import generator
from methods import BUILTIN

FACTS, TRAIN, TEST, BODY = "task.json", "train", "test", "body.npz"

#: Methods that can be trained this way.
TRAINED = ("cyclegan", "cyclegan-kc", "holden")


class FolderView:
    """A :class:`benchmark.api.TrainView` over clips in memory."""

    def __init__(self, clips: Sequence[MotionClip], fps: float) -> None:
        self._clips, self._fps = tuple(clips), fps

    @property
    def fps(self) -> float:
        """Frames per second of every clip."""
        return self._fps

    @property
    def actions(self) -> tuple[str, ...]:
        """The actions present, sorted."""
        return tuple(sorted({clip.meta.action for clip in self._clips}))

    def clips(
        self, style: str | None = None, *, action: str | None = None, actor: str | None = None
    ) -> Sequence[MotionClip]:
        """The clips that match, in the order of their files."""
        return [
            clip
            for clip in self._clips
            if style in (None, clip.meta.style)
            and action in (None, clip.meta.action)
            and actor in (None, clip.meta.actor)
        ]

    def pairs(self, source_style: str, target_style: str) -> Iterator[tuple[MotionClip, MotionClip]]:
        """Every pair of takes of the same action, source style first."""
        for source in self.clips(source_style):
            for target in self.clips(target_style, action=source.meta.action):
                yield source, target

    def validation(self, fraction: float = 0.1) -> tuple[FolderView, FolderView]:
        """The view cut in two, one clip in so many of each style held out."""
        step = max(2, round(1 / fraction))
        held = {
            id(clip) for style in {c.meta.style for c in self._clips} for clip in self.clips(style)[step - 1 :: step]
        }
        parts = [[clip for clip in self._clips if (id(clip) in held) is wanted] for wanted in (False, True)]
        return FolderView(parts[0], self._fps), FolderView(parts[1], self._fps)


def collect(folder: Path, dataset: str, task: str, limit: int | None) -> dict[str, Any]:
    """Write the clips of a task, divided as a run divides them, into ``folder``; returns what ``task.json`` says."""
    from benchmark.config import load_config
    from benchmark.data.views import eval_items, target_skeleton, train_view
    from benchmark.motion import quat
    from benchmark.motion.clip import ClipMeta
    from benchmark.runner.plan import limited
    from benchmark.runner.run import prepare

    run = prepare(load_config(flags={"dataset": {"name": dataset}, "tasks": [task], "methods": ["identity"]}))
    source, target = task.split(":")
    split = run.splits[0]
    view = train_view(run.dataset, split, source, target)
    body = target_skeleton(run.dataset, split, target)
    test = [
        run.dataset.load(item.record.clip_id) for item in limited(eval_items(run.dataset, split, source, target), limit)
    ]
    for name, clips in ((TRAIN, view.clips()), (TEST, test)):
        (folder / name).mkdir(parents=True, exist_ok=True)
        for index, clip in enumerate(clips):
            npz.save(clip, folder / name / f"{index:05d}.npz")
    npz.save(MotionClip(body, quat.identity(1, len(body)), np.zeros((1, 3)), view.fps, ClipMeta()), folder / BODY)
    facts = {"dataset": dataset, "task": task, "fps": view.fps, "train": len(view.clips()), "test": len(test)}
    (folder / FACTS).write_text(json.dumps(facts, indent=1), encoding="utf-8")
    return facts


def fit(folder: Path, out: Path, name: str, params: dict[str, Any], device: str, seed: int) -> dict[str, Any]:
    """Train on a folder that :func:`collect` wrote, transfer its test clips, and write both; returns ``facts.json``."""
    import importlib

    import torch

    told = json.loads((folder / FACTS).read_text(encoding="utf-8"))
    source, target = told["task"].split(":")
    view = FolderView([npz.load(path) for path in sorted((folder / TRAIN).glob("*.npz"))], told["fps"])
    task = StyleTask(source, target, npz.load(folder / BODY).skeleton)
    module, _, cls = BUILTIN[name].partition(":")
    method: Method = getattr(importlib.import_module(module), cls)(**params)
    out.mkdir(parents=True, exist_ok=True)
    began, last = time.perf_counter(), [0.0]

    def report(fraction: float, message: str) -> None:
        now = time.perf_counter()
        if now - last[0] > 5.0:
            last[0] = now
            print(f"{100 * fraction:5.1f} %  {now - began:6.1f} s  {message}", flush=True)

    # The checkpoint lies beside the results, so the same command goes on after an interruption.
    context = FitContext(device, out / "work", report)
    method.fit(view, task, rng=generator(seed=seed, stage="fit"), ctx=context)
    fit_seconds = time.perf_counter() - began
    rows = method.history_.rows  # type: ignore[attr-defined]
    with (out / "train.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)
    method.save(out / "model")
    (out / "outputs").mkdir(exist_ok=True)
    began = time.perf_counter()
    frames = 0
    for path in sorted((folder / TEST).glob("*.npz")):
        clip = npz.load(path)
        result = method.transfer(clip, task, rng=generator(seed=seed, stage="transfer", clip=path.stem)).clip
        npz.save(result, out / "outputs" / path.name)
        frames += len(clip)
    gpu = torch.cuda.get_device_name() if device == "cuda" else ""
    facts = {
        **told,
        "method": name,
        "params": params,
        "device": device,
        "gpu": gpu,
        "torch": torch.__version__,
        "fit_seconds": round(fit_seconds, 2),
        "transfer_seconds": round(time.perf_counter() - began, 2),
        "transferred_seconds": round(frames / told["fps"], 2),
        "epochs": rows[-1]["epoch"],
        "steps": rows[-1]["step"],
        "steps_per_second": round(rows[-1]["step"] / rows[-1]["seconds"], 3),
    }
    (out / "facts.json").write_text(json.dumps(facts, indent=1), encoding="utf-8")
    return facts


def _assignment(text: str) -> tuple[str, Any]:
    name, sign, value = text.partition("=")
    if not sign:
        raise argparse.ArgumentTypeError(f"write a setting as name=value, not {text!r}")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("collect", help="write a task's clips as files, where the suite is installed")
    one.add_argument("folder", type=Path)
    one.add_argument("-d", "--dataset", default="kinder-gator")
    one.add_argument("-t", "--task", default="adult:child")
    one.add_argument("--limit", type=int, help="transfer only so many clips")
    two = verbs.add_parser("fit", help="train on such a folder, with torch and little else")
    two.add_argument("folder", type=Path)
    two.add_argument("-o", "--out", type=Path, required=True)
    two.add_argument("-m", "--method", choices=TRAINED, default="cyclegan")
    two.add_argument("--set", action="append", type=_assignment, default=[], metavar="NAME=VALUE", dest="params")
    two.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    two.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    if chosen.verb == "fit" and not (chosen.folder / FACTS).is_file():
        parser.error(f"{chosen.folder} has no {FACTS}: make the folder with 'collect'")
    try:
        if chosen.verb == "collect":
            facts = collect(chosen.folder, chosen.dataset, chosen.task, chosen.limit)
        else:
            params = {"preset": "paper", **dict(chosen.params)}
            facts = fit(chosen.folder, chosen.out, chosen.method, params, chosen.device, chosen.seed)
    except BenchmarkError as error:
        parser.exit(1, f"error: {error}\n")
    print(json.dumps(facts, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())

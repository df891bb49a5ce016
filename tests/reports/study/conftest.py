"""A planted run with a few short clips, and a study built of it: small pictures, short videos, nothing to wait for."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from benchmark.motion import npz, quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.roles import find_roles
from benchmark.motion.skeleton import Skeleton
from benchmark.runner.parquet import write_rows
from benchmark.runner.views import LEADERBOARD_COLUMNS, RESULT_COLUMNS, leaderboard
from reports.run import RunView
from reports.study.app import Site, make_app
from reports.study.build import Settings, build_study
from reports.study.layout import StudyFolder
from reports.study.texts import CONSENT, THANKS

METHODS = ("identity", "bold", "child-reference")
ACTIONS = ("jump", "walk", "punch", "bow")
#: P(target) of each method.
CHILDLIKE = {"identity": 0.1, "bold": 0.7, "child-reference": 0.9}
SMALL = Settings(clips=2, catch=1, seconds=2.0, min_watch=0.0, raters=6, size=(160, 120), fps=10)


def figure(scale: float) -> Skeleton:
    """A body with the joints that a figure is drawn from."""
    names = ["Hips", "Spine", "Head"]
    parents, offsets = [-1, 0, 1], [[0.0, 0, 0], [0, 0.3, 0], [0, 0.3, 0]]
    for side, x in (("Left", 1), ("Right", -1)):
        for part, parent, offset in (
            ("Arm", 1, [0.2 * x, 0.2, 0]),
            ("ForeArm", len(names), [0.3 * x, 0, 0]),
            ("Hand", len(names) + 1, [0.25 * x, 0, 0]),
        ):
            names.append(f"{side}{part}")
            parents.append(parent)
            offsets.append(offset)
    for side, x in (("Left", 1), ("Right", -1)):
        first = len(names)
        for part, parent, offset in (
            ("UpLeg", 0, [0.1 * x, 0, 0]),
            ("Leg", first, [0, -0.42, 0]),
            ("Foot", first + 1, [0, -0.42, 0]),
        ):
            names.append(f"{side}{part}")
            parents.append(parent)
            offsets.append(offset)
    roles = find_roles(names, parents)
    return Skeleton(tuple(names), np.array(parents), scale * np.array(offsets)).with_roles(roles)


def motion(method: str, clip: int) -> MotionClip:
    """Two seconds in place; each method and clip has a tempo of its own."""
    skeleton = figure(1.0 if method == "identity" else 0.7)
    time = np.arange(60) / 30
    angles = np.zeros((60, len(skeleton), 3))
    angles[:, 9, 0] = 0.5 * np.sin(2 * np.pi * (1 + METHODS.index(method)) * time + clip)
    root = np.zeros((60, 3))
    root[:, 1] = 0.84 * skeleton.offsets[11][1] / -0.42
    return MotionClip(skeleton, quat.exp(angles / 2), root, 30.0, meta=ClipMeta("a", "adult", ACTIONS[clip % 4]))


def planted_run(folder: Path, *, dataset: str = "synthetic") -> RunView:
    """A finished run with stored clips: three methods, four clips of four actions."""
    rows = []
    for method in METHODS:
        cell = folder / "cells" / f"cell-{method}"
        (cell / "outputs").mkdir(parents=True)
        items = []
        for clip, action in enumerate(ACTIONS):
            clip_id, stem = f"adult/a{clip % 2}/{action}_{clip}", f"{clip:04d}"
            npz.save(motion(method, clip), cell / "outputs" / f"{stem}.raw.npz")
            items.append(
                {
                    "clip_id": clip_id,
                    "state": "ok",
                    "stem": stem,
                    "action": action,
                    "actor": f"a{clip % 2}",
                    "reason": "",
                    "seen_actor": False,
                    "reference_ids": [],
                    "has_truth": False,
                    "variants": {"raw": None},
                    "copied_from": None,
                    "transfer_seconds": 0.1,
                }
            )
            common = {
                **dict.fromkeys((name for name, kind in RESULT_COLUMNS.items() if kind == "string"), "x"),
                "cell_key": f"cell-{method}",
                "method": method,
                "dataset": dataset,
                "source_style": "adult",
                "target_style": "child",
                "clip_id": clip_id,
                "actor": f"a{clip % 2}",
                "action": action,
                "seen_actor": False,
                "repetition": 0,
                "seed": 0,
                "variant": "raw",
                "status": "ok",
                "reason": "",
            }
            rows += [
                {**common, "metric": "recognition/p-target-kinematic", "value": CHILDLIKE[method] + 0.01 * clip},
                {**common, "metric": "cost/transfer_seconds", "value": 0.1},
            ]
        (cell / "items.json").write_text(json.dumps(items))
    write_rows(folder / "results.parquet", rows, RESULT_COLUMNS)
    with (folder / "leaderboard.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, LEADERBOARD_COLUMNS)
        writer.writeheader()
        writer.writerows(leaderboard(rows, {"recognition/p-target-kinematic": ("higher", None)}))
    return RunView(folder)


@pytest.fixture(scope="session")
def plant() -> Callable[..., RunView]:
    """``plant(folder)``: make a planted run."""
    return planted_run


@pytest.fixture(scope="session")
def small() -> Settings:
    """Settings of a study that is quick to make and to take."""
    return SMALL


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> RunView:
    """The planted run."""
    return planted_run(tmp_path_factory.mktemp("planted") / "run")


@pytest.fixture(scope="session")
def built(run, tmp_path_factory) -> StudyFolder:
    """A built study; tests take copies."""
    pytest.importorskip("imageio_ffmpeg")
    return build_study(run, tmp_path_factory.mktemp("built") / "study", SMALL).folder


@pytest.fixture
def study(built, tmp_path) -> StudyFolder:
    """A study of one's own."""
    shutil.copytree(built.path, tmp_path / "study")
    folder = StudyFolder(tmp_path / "study")
    for name in (CONSENT, THANKS):
        (folder.texts / name).write_text("# About\n\nFilled in <b>&</b> agreed.\n")
    return folder


@pytest.fixture
def site(study) -> Iterator[Callable]:
    """``site(**options)``: a client of the study's site, and the site."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it would rather have another client
        from starlette.testclient import TestClient

    opened = []

    def make(**options):
        made = Site(study, **options)
        client = TestClient(make_app(made), base_url="http://study.test", follow_redirects=False)
        client.__enter__()
        opened.append(client)
        return client, made

    yield make
    for client in opened:
        client.__exit__(None, None, None)


@pytest.fixture
def serving() -> Callable:
    """``with serving(study, *options) as (address, process)``: a real server in a process of its own."""
    return server


@contextmanager
def server(study: StudyFolder, *more: str, port: int = 0) -> Iterator[tuple[str, subprocess.Popen]]:
    """A real server in a process of its own: its address, and the process."""
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmark", "study", "serve", str(study.path), "--port", str(port), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "200"},
    )
    try:
        assert process.stdout is not None
        said = []
        for line in process.stdout:
            said.append(line)
            if line.startswith("http://"):
                break
        else:
            raise AssertionError(f"the server did not start: {''.join(said)}")
        yield line.strip(), process
    finally:
        process.terminate()
        process.wait(20)
        if process.stdout is not None:
            process.stdout.close()

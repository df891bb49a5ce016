"""A tiny data set and methods that behave and misbehave, importable by worker processes."""

from __future__ import annotations

import json
import os
import time
from functools import cache
from pathlib import Path

import numpy as np

from benchmark.api import (
    Capabilities,
    Method,
    MethodInfo,
    Metric,
    MetricInfo,
    NotApplicableError,
    Probe,
    ProbeInfo,
    Supervision,
    TransferResult,
)
from benchmark.data.base import ClipRecord, Dataset
from benchmark.data.cards import Card, Citation, Licence
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton

NAMES = (
    "Hips",
    "Chest",
    "Head",
    *(f"{s}{p}" for s in ("Left", "Right") for p in ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")),
)
PARENTS = [-1, 0, 1, 1, 3, 4, 0, 6, 7, 1, 9, 10, 0, 12, 13]
ROLES = {"hips": 0, "chest": 1, "head": 2}
for _i, _side in enumerate(("left", "right")):
    for _j, _part in enumerate(("shoulder", "elbow", "wrist", "hip", "knee", "ankle")):
        ROLES[f"{_side}_{_part}"] = 3 + 6 * _i + _j


def skeleton(scale: float = 1.0) -> Skeleton:
    offsets = [[0, 0, 0], [0, 0.3, 0], [0, 0.3, 0]]
    for x in (1, -1):
        offsets += [[0.2 * x, 0.2, 0], [0.3 * x, 0, 0], [0.25 * x, 0, 0], [0.1 * x, 0, 0], [0, -0.45, 0], [0, -0.45, 0]]
    return Skeleton(NAMES, np.array(PARENTS), scale * np.array(offsets, dtype=float), roles=ROLES)


class Fake(Dataset):
    """Three actors and two actions a style; clips of 12 frames and a second of doing nothing."""

    def __init__(self, *, revision: int = 1, targets: bool = True) -> None:
        self.revision, self.targets = revision, targets

    id = "fake"
    fps = 30.0
    card = Card(
        id="fake",
        title="fake",
        version="1",
        summary="for tests",
        kind="generated",
        licence=Licence(name="MIT", redistribution="yes"),
        citation=Citation(text="none"),
    )

    @property
    def options(self):
        return {"revision": self.revision}

    @property
    def records(self):
        return _records(self.revision, self.targets)

    def load(self, clip_id: str) -> MotionClip:
        record = self.record(clip_id)
        rng = np.random.default_rng(int(record.sha256[:8], 16))
        frames = 12
        angles = np.cumsum(rng.normal(scale=0.05, size=(frames, len(NAMES), 3)), axis=0)
        root = np.cumsum(rng.normal(scale=0.01, size=(frames, 3)), axis=0) + [0, 0.9, 0]
        return MotionClip(
            skeleton(0.6 if record.style == "child" else 1.0), quat.exp(angles), root, self.fps, record.meta
        )

    def truth(self, clip_id: str, target_style: str, skeleton=None) -> MotionClip | None:
        record = self.record(clip_id)
        return self.load(clip_id) if record.action == "walk" else None

    def default_protocol(self, source_style: str, target_style: str) -> str:
        return "actors-kfold"


@cache
def _records(revision: int, targets: bool) -> tuple[ClipRecord, ...]:
    from hashlib import sha256

    found = []
    for style in ("adult", "child") if targets else ("adult", "old"):
        for actor in ("1", "2", "3"):
            for action in ("jump", "walk"):
                for take in ("1", "2"):
                    name = f"{style}{actor}"
                    sha = sha256(f"{style}{actor}{action}{take}{revision}".encode()).hexdigest()
                    found.append(
                        ClipRecord.of(actor=name, style=style, action=action, take=take, path=None, sha256=sha)
                    )
    return tuple(sorted(found, key=lambda record: record.clip_id))


def open_fake(name: str, *, root: Path | None = None, **options) -> Dataset:
    return Fake(**options)


def _info(name: str, **capabilities) -> MethodInfo:
    capabilities = {"supervision": Supervision.NONE, "fit_scope": "none", "changes_proportions": False, **capabilities}
    return MethodInfo(name=name, summary=f"{name} for tests", capabilities=Capabilities(**capabilities))


class Copy(Method):
    """The source itself."""

    info = _info("copy")

    def __init__(self, *, amount: float = 1.0, pause: float = 0.0) -> None:
        self.amount = amount
        self.pause = pause

    def fit(self, train, task, *, rng, ctx):
        time.sleep(self.pause)
        ctx.report(1.0, "done")
        return self

    def transfer(self, source, task, *, rng):
        return TransferResult(source)

    @classmethod
    def variants(cls):
        return {"": {}, "half": {"amount": 0.5}} if cls is Copy else {"": {}}

    @classmethod
    def presets(cls):
        return {"tenth": {"amount": 0.1}} if cls is Copy else {}


class Noisy(Copy):
    """Adds a random walk; learns a random number."""

    info = _info("noisy", stochastic_fit=True, stochastic_transfer=True, fit_scope="per_task")

    def fit(self, train, task, *, rng, ctx):
        self.size_ = float(rng.random())
        self.weights_ = np.zeros((3, 4))
        return self

    def transfer(self, source, task, *, rng):
        return TransferResult(source.replace(root=source.root + self.size_ * rng.normal(size=source.root.shape)))

    def save(self, folder):
        folder.mkdir(parents=True)
        (folder / "size.json").write_text(json.dumps(self.size_))

    @classmethod
    def load(cls, folder):
        self = cls()
        self.size_ = json.loads((folder / "size.json").read_text())
        return self


class Real(Copy):
    """The reference."""

    info = _info("child-reference", uses_reference=True, changes_timing=True, required_roles=())

    def transfer(self, source, task, *, rng):
        return TransferResult(task.reference, copied_from=task.reference.meta.clip_id)


class Raises(Copy):
    info = _info("raises")

    def fit(self, train, task, *, rng, ctx):
        raise RuntimeError("the learning rate exploded")


class RaisesLate(Copy):
    info = _info("raises-late")

    def transfer(self, source, task, *, rng):
        if source.meta.action == "walk":
            raise ValueError("cannot walk")
        return TransferResult(source)


class Nan(Copy):
    info = _info("nan")

    def transfer(self, source, task, *, rng):
        root = source.root.copy()
        root[3, 1] = np.nan
        return TransferResult(source.replace(root=root))


class SneakyNan(Copy):
    """Alters the arrays of a clip after it was checked."""

    info = _info("sneaky-nan")

    def transfer(self, source, task, *, rng):
        root = source.root.copy()
        clip = source.replace(root=root)
        root[3, 1] = np.nan
        return TransferResult(clip)


class WrongSkeleton(Copy):
    info = _info("wrong-skeleton")

    def transfer(self, source, task, *, rng):
        return TransferResult(source.replace(skeleton=skeleton(0.6)))


class WrongLength(Copy):
    info = _info("wrong-length")

    def transfer(self, source, task, *, rng):
        return TransferResult(source.frames(0, 5))


class Loops(Copy):
    """Never returns."""

    info = _info("loops")

    def fit(self, train, task, *, rng, ctx):
        while True:
            pass


class Aborts(Copy):
    info = _info("aborts")

    def fit(self, train, task, *, rng, ctx):
        os.abort()


class Forked(Copy):
    """Starts a process and never returns."""

    info = _info("forked")

    def fit(self, train, task, *, rng, ctx):
        import subprocess

        child = subprocess.Popen(["sleep", "600"])
        Path(os.environ["FAKE_PID_FILE"]).write_text(str(child.pid))
        child.wait()
        return self


class Paired(Copy):
    info = _info("paired", supervision=Supervision.PAIRED)


class NeedsGpu(Copy):
    info = _info("needs-gpu", device="gpu_required")


class At120(Copy):
    info = _info("at-120", fps=120.0)


class NeedsToes(Copy):
    info = _info("needs-toes", required_roles=("left_toe",))


class LongOnly(Copy):
    info = _info("long-only", min_frames=100)


class Learnless(Copy):
    """Finds nothing to learn from."""

    info = _info("learnless")

    def fit(self, train, task, *, rng, ctx):
        raise NotApplicableError("the training clips hold no jump")


class Choosy(Copy):
    """Cannot transfer clips of one action."""

    info = _info("choosy")

    def transfer(self, source, task, *, rng):
        if source.meta.action == "walk":
            raise NotApplicableError("walking was not learned")
        return super().transfer(source, task, rng=rng)


class Checkpoints(Copy):
    """Counts in its work folder how often fit was begun."""

    info = _info("checkpoints")

    def fit(self, train, task, *, rng, ctx):
        assert ctx.work_dir is not None
        count = ctx.work_dir / "count"
        begun = int(count.read_text()) if count.exists() else 0
        count.write_text(str(begun + 1))
        if begun == 0:
            os.abort()
        return self


class Height(Metric):
    """Mean height of the root."""

    info = MetricInfo(name="test/height", summary="mean height", unit="m", direction="none")

    def compute(self, sample):
        return float(sample.clip.root[:, 1].mean())


class Gap(Metric):
    """Difference of the root's height to the references'."""

    info = MetricInfo(name="test/gap", summary="gap to real", unit="m", direction="lower", needs="reference")

    def compute(self, sample):
        return float(abs(sample.clip.root[:, 1].mean() - np.mean([r.root[:, 1].mean() for r in sample.references])))


class TruthGap(Metric):
    info = MetricInfo(name="test/truth", summary="gap to truth", unit="m", direction="lower", needs="truth")

    def compute(self, sample):
        return float(abs(sample.clip.root[:, 1].mean() - sample.truth.root[:, 1].mean()))


class Spread(Metric):
    info = MetricInfo(name="test/spread", summary="spread over clips", unit="m", direction="none", scope="set")

    def compute(self, sample):
        raise NotApplicableError("set")

    def compute_set(self, samples):
        return float(np.std([sample.clip.root[:, 1].mean() for sample in samples]))


class Broken(Metric):
    info = MetricInfo(name="test/broken", summary="divides by zero", unit="1", direction="lower")

    def compute(self, sample):
        return 1 / 0


class Infinite(Metric):
    info = MetricInfo(name="test/infinite", summary="infinite", unit="1", direction="lower")

    def compute(self, sample):
        return float("inf")


class Crash(Metric):
    info = MetricInfo(name="test/crash", summary="ends the process", unit="1", direction="lower")

    def compute(self, sample):
        os.abort()


class MeanHeight(Probe):
    """Mean height of the root over the training clips of the target style, and a number drawn at random."""

    info = ProbeInfo("mean-height", "mean height in training")

    def fit(self, train, task, *, rng, ctx):
        self.height_ = float(np.mean([clip.root[:, 1].mean() for clip in train.clips(task.target_style)]))
        self.drawn_ = float(rng.random())
        return self

    def save(self, folder):
        folder.mkdir(parents=True)
        (folder / "probe.json").write_text(json.dumps([self.height_, self.drawn_]))

    @classmethod
    def load(cls, folder):
        probe = cls()
        probe.height_, probe.drawn_ = json.loads((folder / "probe.json").read_text())
        return probe


class Blind(MeanHeight):
    info = ProbeInfo("blind", "has nothing to learn from")

    def fit(self, train, task, *, rng, ctx):
        raise NotApplicableError("nothing to learn from")


class Lame(MeanHeight):
    """Fails unless the environment says otherwise."""

    info = ProbeInfo("lame", "fails")

    def fit(self, train, task, *, rng, ctx):
        if os.environ.get("FAKE_LAME") == "abort":
            os.abort()
        if os.environ.get("FAKE_LAME") != "heal":
            raise ValueError("it hurts")
        return super().fit(train, task, rng=rng, ctx=ctx)


NO_PROBES: dict[str, str] = {}
PROBES = {"mean-height": "fakebench:MeanHeight", "blind": "fakebench:Blind", "lame": "fakebench:Lame"}


class AboveMean(Metric):
    """Height of the root over that in training."""

    info = MetricInfo("probed/height", "height over training", "m", "none", probe="mean-height")

    def compute(self, sample):
        return float(sample.clip.root[:, 1].mean()) - sample.probes[self.info.probe].height_


class Drawn(AboveMean):
    info = MetricInfo("probed/drawn", "the probe's number", "1", "none", scope="set", probe="mean-height")

    def compute_set(self, samples):
        return samples[0].probes[self.info.probe].drawn_


class Unseen(AboveMean):
    info = MetricInfo("probed/blind", "through a probe that does not apply", "1", "none", probe="blind")


class Hurt(AboveMean):
    info = MetricInfo("probed/lame", "through a probe that fails", "1", "none", probe="lame")


PROBED_METRICS = {
    "test/height": "fakebench:Height",
    "probed/height": "fakebench:AboveMean",
    "probed/drawn": "fakebench:Drawn",
    "probed/blind": "fakebench:Unseen",
    "probed/lame": "fakebench:Hurt",
}

METHODS = {
    cls.info.name: f"fakebench:{cls.__name__}"
    for cls in (
        Copy,
        Noisy,
        Real,
        Raises,
        RaisesLate,
        Nan,
        SneakyNan,
        WrongSkeleton,
        WrongLength,
        Loops,
        Aborts,
        Forked,
        Paired,
        NeedsGpu,
        At120,
        NeedsToes,
        LongOnly,
        Learnless,
        Choosy,
        Checkpoints,
    )
}
METHODS["absent"] = "fakebench_absent:Method"
METRICS = {
    cls.info.name: f"fakebench:{cls.__name__}" for cls in (Height, Gap, TruthGap, Spread, Broken, Infinite, Crash)
}
GOOD_METRICS = {name: METRICS[name] for name in ("test/height", "test/gap", "test/truth", "test/spread")}

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import FitContext, NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import MEASURED_ACTIONS, SmallView, perform
from benchmark.data.synthetic import SyntheticDataset
from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample, sample_at
from benchmark.motion.retarget import retarget
from eval.features.kinematic import kinematic_features
from eval.metrics import distribution
from eval.metrics.window_sets import Windows, capped, neighbours, sample_size, windows_of
from eval.probes.encoder import MotionEncoder

Y = np.array([0.0, 1.0, 0.0])
METRICS = sorted(
    (each for each in vars(distribution).values() if isinstance(each, type) and "info" in vars(each)),
    key=lambda each: each.info.name,
)
NAMES = [each.info.name for each in METRICS]


class QuickEncoder(MotionEncoder):
    """Trained for a moment."""

    steps = 40


def real(style: str, takes: range) -> list[MotionClip]:
    return [perform(action, style, take) for action in MEASURED_ACTIONS for take in takes]


@pytest.fixture(scope="module")
def probes() -> dict[str, MotionEncoder]:
    view = SmallView(tuple(real("adult", range(1, 5)) + real("child", range(1, 5))))
    task = StyleTask("adult", "child")
    return {"motion-encoder": QuickEncoder().fit(view, task, rng=np.random.default_rng(0), ctx=FitContext())}


@pytest.fixture(scope="module")
def identity(probes) -> list[Sample]:
    """Adults on a child's body, with other children's performances to compare with."""
    skeleton = perform("walk", "child", 1).skeleton
    task = StyleTask("adult", "child", skeleton)
    references = real("child", range(10, 22))
    return [
        Sample(
            retarget(clip, skeleton),
            clip,
            tuple(other for other in references if other.meta.action == clip.meta.action),
            None,
            task,
            probes=probes,
        )
        for clip in real("adult", range(5, 15))
    ]


@pytest.fixture(scope="module")
def performers(identity) -> list[Sample]:
    """The row of real performers: every result a copy of a reference."""
    rows = []
    for index, sample in enumerate(identity):
        copy = sample.references[index % 6]
        others = tuple(clip for clip in sample.references if clip is not copy)
        rows.append(replace(sample, clip=copy, references=others, copied_from=copy.meta.clip_id))
    return rows


def values(samples: list[Sample]) -> dict[str, float]:
    return {metric.info.name: metric().compute_set(samples) for metric in METRICS}


def altered(samples: list[Sample], change) -> list[Sample]:
    return [
        replace(each, clip=change(each.clip), references=tuple(change(clip) for clip in each.references))
        for each in samples
    ]


def test_there_are_two_of_every_kind() -> None:
    assert len(METRICS) == 22
    for metric in METRICS:
        assert metric.info.scope == "set" and metric.info.probe == "motion-encoder"
        assert metric.info.name.endswith(metric.which)
        assert metric.__doc__
    with pytest.raises(ContractError, match="compute_set"):
        METRICS[0]().compute(None)  # type: ignore[arg-type]


def test_real_performers_are_nearer_to_real_performers_than_adults_are(identity, performers) -> None:
    ours, floor = values(identity), values(performers)
    for which in ("kinematic", "learned"):
        for name in ("frechet", "frechet-limit", "kid", "mmd"):
            assert floor[f"distribution/{name}-{which}"] < 0.5 * ours[f"distribution/{name}-{which}"], name
        for name in ("precision", "recall", "coverage"):
            assert floor[f"distribution/{name}-{which}"] > ours[f"distribution/{name}-{which}"] + 0.1, name
        assert abs(floor[f"distribution/diversity-ratio-{which}"] - 1.0) < 0.25
        error = ours[f"distribution/kid-error-{which}"]
        assert ours[f"distribution/kid-{which}"] > 2.0 * error > 0.0
        assert ours[f"distribution/mmd-p-{which}"] == pytest.approx(0.001)
        assert floor[f"distribution/mmd-p-{which}"] > 0.05


def _placed(clip: MotionClip) -> MotionClip:
    turn = quat.from_axis_angle(Y, np.array(2.1))
    rotations = np.array(clip.rotations)
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [3.0, 0.0, -1.5])


def _flipped(clip: MotionClip) -> MotionClip:
    sign = np.where(np.random.default_rng(6).random(clip.rotations.shape[:2]) < 0.5, -1.0, 1.0)
    return clip.replace(rotations=clip.rotations * sign[..., None])


def _grown(clip: MotionClip) -> MotionClip:
    return MotionClip(clip.skeleton.scaled(1.6), clip.rotations, 1.6 * clip.root, clip.fps, clip.meta)


CHANGES = {
    "place and facing": _placed,
    "quaternion signs": _flipped,
    "size": _grown,
    "frame rate": lambda clip: resample(clip, 30.0),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_is_no_part_of_a_motion_does_not_matter(identity, change) -> None:
    first, second = values(identity), values(altered(identity, change))
    for name in NAMES:
        assert second[name] == pytest.approx(first[name], rel=1e-5, abs=1e-6), name


def test_the_same_samples_have_the_same_value(identity) -> None:
    assert values(identity) == values(list(identity))


def test_results_that_are_all_alike(identity) -> None:
    walks = [each for each in identity if each.clip.meta.action == "walk"]
    alike = [replace(each, clip=walks[0].clip) for each in identity]
    for ratio, coverage in (
        (distribution.DiversityRatio(), distribution.Coverage()),
        (distribution.DiversityRatioLearned(), distribution.CoverageLearned()),
    ):
        assert ratio.compute_set(alike) < 0.5
        assert coverage.compute_set(alike) < coverage.compute_set(identity)


def test_the_size_of_subsamples_depends_on_sources_and_real_motion_alone(identity, performers) -> None:
    size = sample_size(identity)
    assert size == sample_size(performers)
    # Where an action has one source the copy is nobody's reference any more, and still part of real motion.
    few = [replace(each, references=each.references[:1]) for each in identity]
    copies = [
        replace(each, clip=each.references[0], references=(), copied_from=each.references[0].meta.clip_id)
        for each in few
    ]
    real_windows = {clip: len(kinematic_features(clip)) for each in few for clip in each.references}
    assert len(real_windows) == 3, "a clip for each action"
    assert sample_size(few) == sample_size(copies) == int(sum(real_windows.values()) / 3)
    halved = [replace(each, clip=each.clip.frames(0, 30)) for each in identity]
    assert size == sample_size(halved)
    windows = len(
        windows_of((each.source for each in identity), identity[0].probes["motion-encoder"], "kinematic").clips
    )
    assert size <= windows // 2


def test_windows_know_their_clip(identity) -> None:
    probe = identity[0].probes["motion-encoder"]
    clips = [identity[0].clip, identity[0].clip.frames(0, 3), identity[1].clip]
    found = windows_of(clips, probe, "kinematic")
    assert found.features.shape[0] == len(found.clips)
    assert sorted(set(found.clips)) == [0, 1], "the clip that is too short has no windows"
    assert set(found.actions) == {"walk"}
    assert set(windows_of(clips, probe, "learned", ["sit", "run", "lie"]).actions) == {"sit", "lie"}
    assert windows_of([], probe, "learned").features.shape == (0, len(probe.learned_.variances))


def test_too_few_windows(identity) -> None:
    metric = distribution.Frechet()
    with pytest.raises(NotApplicableError, match="too few"):
        metric.compute_set([replace(each, clip=each.clip.frames(0, 3)) for each in identity])
    with pytest.raises(NotApplicableError, match="too few"):
        metric.compute_set(identity[:1])
    with pytest.raises(NotApplicableError, match="no results"):
        metric.compute_set([])
    with pytest.raises(NotApplicableError, match="no real target clip"):
        metric.compute_set([replace(each, references=()) for each in identity])


def test_windows_of_one_clip_are_no_sample_of_a_style(rng: np.random.Generator) -> None:
    action = np.full(20, "walk")
    one = Windows(rng.normal(size=(20, 4)), np.zeros(20, dtype=np.int64), action)
    many = Windows(rng.normal(size=(20, 4)), np.arange(20), action)
    for metric in (distribution.KernelDistance(), distribution.DiversityRatio()):
        with pytest.raises(NotApplicableError, match="only one clip"):
            metric.value(many, one, 10)
    with pytest.raises(NotApplicableError, match="three clips"):
        distribution.KernelDistanceError().value(many, replace(many, clips=np.arange(20) % 2), 10)
    with pytest.raises(NotApplicableError, match="the same"):
        distribution.DiversityRatio().value(replace(many, features=np.zeros((20, 4))), many, 10)


def test_results_that_do_one_half_of_what_real_performers_do(rng: np.random.Generator) -> None:
    """Real motion in two clumps, results in one of them: each metric with the real set in its right place."""
    clumps = rng.normal(size=(200, 3)) + 50.0 * np.repeat([0, 1], 100)[:, None]
    real = Windows(clumps, np.arange(200), np.full(200, "walk"))
    ours = Windows(rng.normal(size=(200, 3)), np.arange(200), np.full(200, "walk"))
    assert distribution.Precision().value(real, ours, 80) == pytest.approx(1.0, abs=0.1)
    assert distribution.Recall().value(real, ours, 80) == pytest.approx(0.5, abs=0.1)
    assert distribution.Density().value(real, ours, 80) == pytest.approx(1.0, abs=0.15)
    assert distribution.Coverage().value(real, ours, 80) == pytest.approx(0.5, abs=0.1)
    assert distribution.DiversityRatio().value(real, ours, 80) < 0.1
    assert distribution.KernelDistance().value(real, ours, 80) > 0.0


def test_the_probe_must_be_the_encoder(identity) -> None:
    strangers = [replace(each, probes={"motion-encoder": object()}) for each in identity]
    with pytest.raises(ContractError, match="not a MotionEncoder"):
        distribution.Frechet().compute_set(strangers)


def test_dimension_and_neighbours_shrink_with_the_sample() -> None:
    windows = Windows(np.zeros((100, 32)), np.arange(100), np.full(100, "walk"))
    assert [capped(windows, size).features.shape[1] for size in (5, 25, 100, 1000)] == [1, 2, 10, 32]
    assert [neighbours(size) for size in (4, 16, 40, 1000)] == [1, 2, 5, 5]


class _Blend:
    """A motion between the source on the child's body and its true performance by a child."""

    def __init__(self, data: SyntheticDataset, source: MotionClip, task: StyleTask) -> None:
        self.start = retarget(source, task.target_skeleton)
        truth = data.truth(source.meta.clip_id, "child", task.target_skeleton)
        assert truth is not None
        self.end = truth

    def at(self, share: float) -> MotionClip:
        frames = round((1.0 - share) * len(self.start) + share * len(self.end))
        one, two = (
            sample_at(clip, np.linspace(0.0, clip.duration, frames), fps=clip.fps) for clip in (self.start, self.end)
        )
        rotations = quat.slerp(one.rotations, quat.align(two.rotations, one.rotations), np.full((1, 1), share))
        return one.replace(
            rotations=quat.normalize(rotations), root=(1.0 - share) * one.root + share * two.root, fps=self.start.fps
        )


def test_the_nearer_to_the_truth_the_nearer_to_real_motion() -> None:
    data = SyntheticDataset(seed=5, adults=2, children=4, takes=1)
    held_out = {"adult": ("adult002",), "child": ("child002", "child003", "child004")}
    train, test = [], []
    for record in data.records:
        (test if record.actor in held_out[record.style] else train).append(record.clip_id)
    clips = {name: data.load(name) for name in (*train, *test)}
    view = SmallView(tuple(clips[name] for name in train))
    target = next(clip.skeleton for clip in view.clips("child"))
    task = StyleTask("adult", "child", target)
    probe = QuickEncoder().fit(view, task, rng=np.random.default_rng(0), ctx=FitContext())
    references = [clips[name] for name in test if name.startswith("child")]
    sources = [clips[name] for name in test if name.startswith("adult")]
    assert sources and references
    blends = [_Blend(data, source, task) for source in sources]
    found: dict[str, list[float]] = {name: [] for name in NAMES}
    for share in (0.0, 0.35, 1.0):
        samples = [
            Sample(
                blend.at(share),
                source,
                tuple(clip for clip in references if clip.meta.action == source.meta.action),
                None,
                task,
                probes={"motion-encoder": probe},
            )
            for blend, source in zip(blends, sources, strict=True)
        ]
        for name, value in values(samples).items():
            found[name].append(value)
    for which in ("kinematic", "learned"):
        for name in ("frechet", "frechet-limit", "kid"):
            graded = found[f"distribution/{name}-{which}"]
            assert graded == sorted(graded, reverse=True), (name, which, graded)
        coverage = found[f"distribution/coverage-{which}"]
        assert coverage[0] < coverage[-1], coverage

"""The check itself, small: what the metrics at the core of the suite see is known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.api import Metric, MetricInfo, NotApplicableError, Probe, ProbeInfo
from benchmark.errors import ConfigError, DataError, UnknownNameError
from benchmark.motion.clip import MotionClip
from benchmark.registry import Registry
from eval.meta.check import CLEAN
from eval.meta.study import Setup, Study, choose_clips, make_cases, run_study
from eval.metrics.smoothness import mean_jerk

CORE = (
    "truth/pose-distance",
    "content/pose-distance",
    "physics/jerk-ratio",
    "physics/foot-sliding-factor",
    "physics/foot-skate-speed",
    "physics/floor-penetration",
    "physics/floating",
)
FAULTS = ("noise", "over-smoothing", "foot-slide", "floating", "sunken", "half-style", "no-style", "wrong-action")


@pytest.fixture(scope="module")
def study() -> Study:
    return run_study(CORE, corruptions=FAULTS, clips=8)


@pytest.mark.parametrize(
    ("metric", "fault"),
    [
        *(("truth/pose-distance", fault) for fault in FAULTS if fault != "foot-slide"),
        ("physics/jerk-ratio", "noise"),
        ("physics/jerk-ratio", "over-smoothing"),
        ("physics/foot-sliding-factor", "foot-slide"),
        ("physics/foot-skate-speed", "foot-slide"),
        ("physics/floor-penetration", "sunken"),
        ("physics/floating", "floating"),
        ("content/pose-distance", "wrong-action"),
    ],
)
def test_core_metrics_order_the_grades(study: Study, metric: str, fault: str) -> None:
    found = study.orderings[metric, fault]
    assert found.observed == "ordered"
    assert found.tau == 1.0
    assert found.effect > 0.4


def test_jerk_goes_up_with_noise_and_down_with_smoothing(study: Study) -> None:
    noise, smooth = (study.orderings["physics/jerk-ratio", name].means for name in ("noise", "over-smoothing"))
    assert noise[0] == smooth[0]
    assert 0.7 < noise[0] < 1.2, "a faultless performance is about as jerky as a real one"
    assert all(np.diff(noise) > 0.0)
    assert all(np.diff(smooth) < 0.0)


def test_content_is_bought_with_style(study: Study) -> None:
    for fault in ("half-style", "no-style"):
        assert study.orderings["content/pose-distance", fault].observed == "fooled"
    assert study.orderings["content/pose-distance", "no-style"].means[-1] == pytest.approx(0.0, abs=1e-4)


def test_posture_does_not_see_the_floor(study: Study) -> None:
    for fault in ("foot-slide", "floating", "sunken"):
        assert study.orderings["content/pose-distance", fault].observed == "blind"
        assert study.orderings["physics/jerk-ratio", fault].observed == "blind"


def test_no_expectation_of_the_core_is_broken(study: Study) -> None:
    assert study.surprises() == []
    good, bad = study.verdicts()
    assert bad == 0
    assert good > 20


def test_grade_0_is_measured_once_and_the_numbers_are_all_there(study: Study) -> None:
    clean = [value for value in study.values if value.corruption == CLEAN]
    assert len(clean) == len(CORE) * 8
    graded = [value for value in study.values if value.corruption != CLEAN]
    assert len(graded) == len(CORE) * 8 * (4 * len(FAULTS) - 3)
    assert {value.grade for value in graded} == {1, 2, 3, 4}


def test_processes_give_the_same_numbers(study: Study) -> None:
    apart = run_study(CORE[:2], corruptions=("noise", "wrong-action"), clips=8, jobs=2)
    kept = [v for v in study.values if v.metric in CORE[:2] and v.corruption in (CLEAN, "noise", "wrong-action")]
    assert sorted(apart.values, key=str) == sorted(kept, key=str)


def test_another_seed_is_another_corruption() -> None:
    one, two = (run_study(CORE[:1], corruptions=("noise",), clips=3, seed=seed) for seed in (0, 1))
    assert one.orderings[CORE[0], "noise"].means != two.orderings[CORE[0], "noise"].means
    assert one.orderings[CORE[0], "noise"].observed == "ordered"


def test_clips_are_spread_over_actions_and_are_not_trained_on() -> None:
    chosen = choose_clips(20)
    assert len(set(chosen)) == 20
    assert len({name.rpartition("/")[2].rpartition("_")[0] for name in chosen}) >= 19
    assert choose_clips(5) == chosen[:5]
    with pytest.raises(ConfigError, match="clips to check with"):
        choose_clips(10_000)


def test_a_performance_is_as_a_real_one_is_captured() -> None:
    (case,) = make_cases(Setup(choose_clips(1), {}, {}, 0))
    assert case.performance.skeleton == case.adult.skeleton == case.task.target_skeleton
    assert len(case.performance) == len(case.truth)
    gap = np.linalg.norm(case.performance.positions - case.truth.positions, axis=-1).mean()
    assert 1e-4 < gap < 0.01
    whole = case.blend(0.0)
    assert np.allclose(whole.positions, case.performance.positions)
    assert not np.array_equal(case.blend(1.0).positions[: len(whole)], whole.positions[: len(case.blend(1.0))])


class JerkLimit(Probe):
    """Largest jerk of the training clips."""

    info = ProbeInfo("jerk-limit", "largest jerk of real children")

    def fit(self, train, task, *, rng, ctx) -> JerkLimit:
        self.limit_ = max(mean_jerk(clip) for clip in train.clips("child")[:10])
        return self

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        (folder / "limit.json").write_text(json.dumps(self.limit_))

    @classmethod
    def load(cls, folder: Path) -> JerkLimit:
        probe = cls()
        probe.limit_ = json.loads((folder / "limit.json").read_text())
        return probe


class Hopeless(JerkLimit):
    """Learns nothing."""

    info = ProbeInfo("hopeless", "learns nothing")

    def fit(self, train, task, *, rng, ctx) -> Hopeless:
        raise NotApplicableError("there is nothing to learn")


class OverLimit(Metric):
    """Jerk over the largest of training, of one clip."""

    info = MetricInfo("test/over-limit", "jerk over the limit", "1", "lower", probe="jerk-limit")

    def compute(self, sample) -> float:
        return mean_jerk(sample.clip) / sample.probes["jerk-limit"].limit_


class Never(OverLimit):
    """Through a probe that cannot be had."""

    info = MetricInfo("test/never", "never", "1", "lower", probe="hopeless")


class Variety(Metric):
    """Spread of mean hip height over the set, in leg lengths."""

    info = MetricInfo("test/variety", "spread of hip height", "leg", "higher", scope="set")

    def compute(self, sample) -> float:
        raise AssertionError("scope is set")

    def compute_set(self, samples) -> float:
        def height(clip: MotionClip) -> float:
            return float(np.ptp(clip.root[:, 1])) / clip.skeleton.leg_length

        return float(np.std([height(sample.clip) for sample in samples]))


def test_probes_and_sets() -> None:
    metrics, probes = Registry("metric", "nobody.metrics"), Registry("probe", "nobody.probes")
    for metric in (OverLimit, Never, Variety):
        metrics.register(metric)
    for probe in (JerkLimit, Hopeless):
        probes.register(probe)
    told: list[str] = []
    study = run_study(
        ["all"],
        corruptions=("noise", "one-for-all"),
        clips=12,
        jobs=2,
        registry=metrics,
        probes=probes,
        progress=lambda unit, fraction, message: told.append(unit),
    )
    assert study.left_out == {"test/never": "probe hopeless: there is nothing to learn"}
    assert study.orderings["test/over-limit", "noise"].observed == "ordered"
    collapse = study.orderings["test/variety", "one-for-all"]
    assert collapse.observed in ("ordered", "seen")
    assert collapse.means[-1] == pytest.approx(0.0, abs=1e-9)
    assert study.orderings["test/variety", "noise"].observed == "blind"
    assert {"probe jerk-limit", "faultless", "noise", "one-for-all"} <= set(told)


def test_what_cannot_be_checked_is_refused() -> None:
    with pytest.raises(DataError, match="'synthetic'"):
        run_study(CORE, dataset="kinder-gator")
    with pytest.raises(UnknownNameError, match="over-smoothing"):
        run_study(CORE, corruptions=("over-smothing",))

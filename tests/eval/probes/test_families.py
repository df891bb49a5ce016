"""Both families of classifier on motions: what they must see, and what they must be blind to."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import SmallView, figure, perform, walk
from benchmark.data.catalog import open_dataset
from benchmark.data.splits import make_split
from benchmark.data.synthetic.dataset import SyntheticDataset
from benchmark.data.synthetic.styles import StyleParameters
from benchmark.data.views import train_view
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.resample import low_pass, resample
from eval.probes.linear import KinematicRecogniser
from eval.probes.recogniser import Recogniser
from eval.probes.temporal import Settings, TemporalRecogniser, mirrored

TASK = StyleTask("adult", "child")


def fitted(family: type[Recogniser], clips: list[MotionClip], seed: int = 1) -> Recogniser:
    return family().fit(SmallView(tuple(clips)), TASK, rng=np.random.default_rng(seed), ctx=FitContext())


class Quick(TemporalRecogniser):
    """One network, trained for a moment."""

    members = 1
    settings = Settings(steps=30, batch=16, channels=24, rate=8e-3)


def cast(takes: tuple[int, ...] = (1, 2, 3)) -> list[MotionClip]:
    return [perform(a, s, t) for s in ("adult", "child") for a in ("walk", "wave", "jump") for t in takes]


@pytest.fixture(scope="module", params=(Quick, KinematicRecogniser), ids=lambda family: family.info.name)
def probe(request: pytest.FixtureRequest) -> Recogniser:
    return fitted(request.param, cast())


def test_strangers_are_told_apart_and_so_is_what_they_do(probe: Recogniser) -> None:
    assert probe.facts_["style_accuracy"] > 0.9
    assert probe.facts_["action_accuracy"] > 0.9
    assert probe.facts_["left_out"] == "performers"
    for action in ("walk", "wave", "jump"):
        adult, child = (probe.recognise(perform(action, style, 4)) for style in ("adult", "child"))
        assert adult.target < 0.5 < child.target
        assert adult.action == child.action == action
        assert sum(adult.actions.values()) == pytest.approx(1.0)


def same(probe: Recogniser, one: MotionClip, two: MotionClip, tolerance: float = 1e-4) -> None:
    first, second = probe.recognise(one), probe.recognise(two)
    assert second.target == pytest.approx(first.target, abs=tolerance)
    assert dict(second.actions) == pytest.approx(dict(first.actions), abs=tolerance)


@pytest.mark.parametrize(("action", "style"), [("walk", "adult"), ("wave", "child"), ("jump", "child")])
def test_size_does_not_leak(probe: Recogniser, action: str, style: str) -> None:
    clip = perform(action, style, 4)
    small = MotionClip(clip.skeleton.scaled(0.7), clip.rotations, 0.7 * clip.root, clip.fps, clip.meta)
    assert probe.features(small) == pytest.approx(probe.features(clip), abs=1e-6)
    same(probe, clip, small)


def test_neither_do_place_facing_and_the_signs_of_quaternions(probe: Recogniser, rng: np.random.Generator) -> None:
    clip = perform("walk", "child", 4)
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 2.0)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    rotations[rng.random(rotations.shape[:2]) < 0.5] *= -1.0
    same(probe, clip, clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [3.0, 0.0, -2.0]))


@pytest.mark.parametrize("action", ["walk", "wave", "jump"])
def test_the_frame_rate_hardly_matters(probe: Recogniser, action: str) -> None:
    for style in ("adult", "child"):
        clip = perform(action, style, 4)
        same(probe, clip, resample(clip, 30.0), 0.06)


@pytest.mark.parametrize("family", [Quick, KinematicRecogniser], ids=lambda family: family.info.name)
def test_speed_is_style_not_nuisance(family: type[Recogniser], rng: np.random.Generator) -> None:
    # Nothing but the tempo differs between these adults and children.
    clips = []
    for style, tempo in (("adult", 0.85), ("child", 1.25)):
        for number in range(3):
            body = figure(float(rng.uniform(0.5, 0.9)))
            for take in range(3):
                clip = walk(body, tempo=tempo, phase=float(rng.uniform(0.0, 6.0)))
                clips.append(clip.replace(meta=ClipMeta(f"{style}{number}", style, "walk", str(take), "test")))
    assert fitted(family, clips).facts_["style_accuracy"] > 0.9


def test_saved_and_read_back_to_the_bit(probe: Recogniser, tmp_path) -> None:
    probe.save(tmp_path)
    again = type(probe).load(tmp_path)
    for take in (4, 5):
        clip = perform("walk", "child", take)
        one, two = probe.recognise(clip), again.recognise(clip)
        assert (one.target, dict(one.actions)) == (two.target, dict(two.actions))
    assert not any(path.suffix in (".pkl", ".pt") for path in tmp_path.iterdir())


def test_the_same_generator_gives_the_same_networks_and_leaves_the_global_one_alone() -> None:
    import torch

    state = torch.random.get_rng_state()
    one, two, other = (fitted(Quick, cast((1, 2)), seed) for seed in (3, 3, 4))
    assert torch.equal(state, torch.random.get_rng_state())
    assert all(np.array_equal(one.members_[0][name], two.members_[0][name]) for name in one.members_[0])
    assert not np.array_equal(one.members_[0]["first.weight"], other.members_[0]["first.weight"])
    clip = perform("walk", "child", 4)
    assert one.recognise(clip).target == two.recognise(clip).target != other.recognise(clip).target


def test_what_fills_up_a_short_clip_says_nothing() -> None:
    import torch

    from eval.probes.tcn import TemporalNetwork

    with torch.random.fork_rng(devices=[]):
        network = TemporalNetwork(5, 8, 2, 3).eval()
    x = torch.linspace(-1.0, 1.0, 64 * 5).reshape(1, 64, 5)
    mask = torch.zeros(1, 64)
    mask[:, 16:41] = 1.0
    # The last frame that counts is 40; what it is computed from ends 14 frames later.
    beyond, within = x.clone(), x.clone()
    beyond[:, 55:], within[:, 54] = 100.0, 100.0
    with torch.inference_mode():
        given = network(x, mask)
        for one, two, three in zip(given, network(beyond, mask), network(within, mask), strict=True):
            assert torch.equal(one, two)
            assert not torch.equal(one, three)


def test_a_mirror_exchanges_the_sides() -> None:
    clip = perform("wave", "child", 2)
    skeleton = clip.skeleton
    # Reflected in the plane x = 0: each joint takes the place and the turn of its counterpart.
    other = [
        skeleton.names.index(name.replace("left", "*").replace("right", "left").replace("*", "right"))
        for name in skeleton.names
    ]
    twin = MotionClip(
        skeleton.with_offsets(skeleton.offsets[other] * [-1.0, 1.0, 1.0]),
        clip.rotations[:, other] * [1.0, 1.0, -1.0, -1.0],
        clip.root * [-1.0, 1.0, 1.0],
        clip.fps,
    )
    features = TemporalRecogniser().features
    assert mirrored(features(clip)) == pytest.approx(features(twin), abs=1e-6)
    assert np.abs(features(twin) - features(clip)).max() > 0.5
    assert np.array_equal(mirrored(mirrored(features(clip))), features(clip))


def test_individual_gaits_without_a_style_give_chance() -> None:
    # Tempo, swing and arms are drawn for each performer; "adult" and "child" are names only.
    draws = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        clips = []
        for style in ("adult", "child"):
            for number in range(3):
                body, own = figure(float(rng.uniform(0.5, 0.9))), rng.uniform(size=3)
                for take in range(3):
                    clip = walk(
                        body,
                        tempo=0.8 + 0.5 * own[0],
                        swing=0.3 + 0.2 * own[1],
                        arms=1.0 + 0.4 * own[2],
                        phase=float(rng.uniform(0.0, 6.0)),
                    )
                    meta = ClipMeta(f"{style}{number}", style, "walk", str(take), "test")
                    clips.append(clip.replace(meta=meta))
        draws += [fitted(family, clips).facts_["style_accuracy"] for family in (Quick, KinematicRecogniser)]
    # Performers are right or wrong as a whole: two families of 4 draws of 6 performers, the families not independent.
    assert np.mean(draws) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(24))


#: Three adults and three children teach; one more of each is judged.
DATA = SyntheticDataset(adults=4, children=4, takes=2, actions=("walk", "punch", "skip"))


@pytest.fixture(scope="module", params=(Quick, KinematicRecogniser), ids=lambda family: family.info.name)
def taught(request: pytest.FixtureRequest) -> Recogniser:
    clips = [DATA.load(record.clip_id) for record in DATA.records if not record.actor.endswith("004")]
    return fitted(request.param, clips)


def test_real_strangers_are_recognised(taught: Recogniser) -> None:
    adults, children = (
        np.array([taught.recognise(DATA.load(r.clip_id)).target for r in DATA.records if r.actor == name])
        for name in ("adult004", "child004")
    )
    assert np.mean(children > 0.5) >= 0.8
    assert np.mean(adults > 0.5) <= 0.2
    assert children.mean() > adults.mean() + 0.35


def test_probability_grows_on_the_way_from_adult_to_child(taught: Recogniser) -> None:
    adult, child = DATA.parameters("adult"), DATA.parameters("child")
    skeleton = DATA.median_actor("adult").skeleton
    sources = [record.clip_id for record in DATA.records if record.actor == "adult004" and record.take == "1"]
    means = []
    for share in (0.0, 0.33, 0.67, 1.0):
        between = {
            field.name: (1.0 - share) * getattr(adult, field.name) + share * getattr(child, field.name)
            for field in fields(StyleParameters)
        }
        clips = [DATA.truth(source, "child", skeleton, parameters=replace(adult, **between)) for source in sources]
        means.append(np.mean([taught.recognise(clip).target for clip in clips]))
    assert np.all(np.diff(means) > 0.0)
    assert means[-1] - means[0] > 0.35


def test_neither_smoothing_nor_noise_makes_one_style_of_the_other(taught: Recogniser, rng: np.random.Generator) -> None:
    for actor, child in (("adult004", False), ("child004", True)):
        clips = [DATA.load(record.clip_id) for record in DATA.records if record.actor == actor]
        plain, smooth, rough = (
            np.mean([taught.recognise(change(clip)).target for clip in clips])
            for change in (lambda clip: clip, lambda clip: low_pass(clip, 6.0), lambda clip: trembling(clip, rng))
        )
        assert smooth == pytest.approx(plain, abs=0.05)
        assert (plain > 0.5, smooth > 0.5, rough > 0.5) == (child, child, child)


def trembling(clip: MotionClip, rng: np.random.Generator) -> MotionClip:
    """Every joint turned by about a degree, anew in each frame, as capture noise does."""
    vectors = np.radians(0.6) * rng.standard_normal((*clip.rotations.shape[:2], 3))
    angles = np.linalg.norm(vectors, axis=-1)
    turns = quat.from_axis_angle(vectors / angles[..., None], angles)
    return clip.replace(rotations=quat.normalize(quat.mul(clip.rotations, turns)))


@pytest.mark.real_data
def test_real_performers_never_seen_are_told_apart(real_data: Path) -> None:
    dataset = open_dataset("kinder-gator", root=real_data)
    view = train_view(dataset, make_split(dataset, "adult", "child", seed=0), "adult", "child")
    probe = KinematicRecogniser().fit(view, TASK, rng=np.random.default_rng(1), ctx=FitContext())
    # Three adults and three children, a pair of them left out at a time.
    assert (probe.facts_["left_out"], probe.facts_["folds"]) == ("performers", 3)
    assert probe.facts_["style_accuracy"] > 0.6
    assert probe.facts_["action_accuracy"] > 10.0 * probe.facts_["chance_action"]

from __future__ import annotations

import json
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from benchmark.api import FitContext, NotApplicableError, StyleTask
from benchmark.commands.conformance.figures import SmallView, figure, perform
from benchmark.errors import ContractError, StoreError
from benchmark.motion.clip import ClipMeta, MotionClip
from eval.probes.linear import KinematicRecogniser
from eval.probes.recogniser import Examples, calibrate, deal, softmax

TASK = StyleTask("adult", "child")
STILL = perform("wave", "adult", 1).frames(0, 5)


def labelled(actor: str, style: str, action: str, take: int) -> MotionClip:
    return STILL.replace(meta=ClipMeta(actor, style, action, str(take), "test"))


def examples(style: list[int], action: list[int]) -> Examples:
    return Examples([np.zeros((1, 1))] * len(style), np.array(style), np.array(action))


class Planted(KinematicRecogniser):
    """Looks at numbers drawn for each clip in place of its motion."""

    drawn: ClassVar[dict[str, np.ndarray]] = {}

    def features(self, clip: MotionClip) -> np.ndarray:
        return self.drawn[clip.meta.clip_id]

    def mirrored(self, features: np.ndarray) -> np.ndarray:
        return features


def planted(
    rng: np.random.Generator,
    *,
    actors: int = 3,
    takes: int = 8,
    style: float = 0.0,
    actor: float = 0.0,
    noise: float = 1.0,
) -> tuple[type[Planted], SmallView]:
    """Six columns: the style moves the first, the performer all of them."""
    clips, drawn = [], {}
    for label, name in enumerate((TASK.source_style, TASK.target_style)):
        for number in range(actors):
            own = actor * rng.standard_normal(6)
            for action in ("walk", "wave"):
                for take in range(takes):
                    clip = labelled(f"{name}{number}", name, action, take)
                    row = own + noise * rng.standard_normal((3, 6)) + np.eye(6)[0] * style * (2 * label - 1)
                    drawn[clip.meta.clip_id] = row + 3.0 * np.eye(6)[5] * (action == "wave")
                    clips.append(clip)
    return type("Drawn", (Planted,), {"drawn": drawn}), SmallView(tuple(clips))


def fitted(kind: type[Planted], view: SmallView, seed: int = 1) -> Planted:
    return kind().fit(view, TASK, rng=np.random.default_rng(seed), ctx=FitContext())


def test_every_action_counts_the_same_and_says_nothing_about_the_style() -> None:
    given = examples([0] * 6 + [1] * 4, [0, 0, 0, 0, 1, 2, 0, 1, 1, 1])
    assert given.shared.tolist() == [True] * 5 + [False] + [True] * 4
    weights = given.action_weights
    for action in range(3):
        assert weights[given.action == action].sum() == pytest.approx(1 / 3)
    for action in range(2):
        for style in range(2):
            cell = (given.action == action) & (given.style == style)
            assert weights[cell].sum() == pytest.approx(1 / 6)
            assert given.style_weights[cell].sum() == pytest.approx(1 / 4)
    assert given.style_weights[5] == 0.0


def test_an_action_that_one_style_does_more_often_does_not_give_it_away() -> None:
    # Adults mostly walk and children mostly wave, and that is all the numbers tell.
    clips, drawn = [], {}
    rng = np.random.default_rng(4)
    for style, counts in (("adult", (20, 2)), ("child", (2, 20))):
        for action, count in zip(("walk", "wave"), counts, strict=True):
            for take in range(count):
                clip = labelled(f"{style}{take % 2}", style, action, take)
                drawn[clip.meta.clip_id] = rng.standard_normal((2, 6)) * 0.1 + np.eye(6)[0] * (action == "wave")
                clips.append(clip)
    probe = fitted(type("Drawn", (Planted,), {"drawn": drawn}), SmallView(tuple(clips)))
    assert probe.facts_["action_accuracy"] == 1.0
    walking = [probe.recognise(clip).target for clip in clips if clip.meta.action == "walk"]
    waving = [probe.recognise(clip).target for clip in clips if clip.meta.action == "wave"]
    assert np.mean(walking) == pytest.approx(0.5, abs=0.1)
    assert np.mean(waving) == pytest.approx(0.5, abs=0.1)


def test_performers_are_left_out_whole_one_of_each_style_at_a_time() -> None:
    clips = [labelled(f"{s}{n}", s, a, t) for s in ("adult", "child") for n in range(3) for a in "xy" for t in range(2)]
    given = examples([int(c.meta.style == "child") for c in clips], [int(c.meta.action == "y") for c in clips])
    fold, by_performer = deal(clips, given)
    assert by_performer
    assert sorted(set(fold)) == [0, 1, 2]
    for number in range(3):
        assert len({clips[i].meta.actor for i in np.flatnonzero(fold == number)}) == 2
        assert {clips[i].meta.style for i in np.flatnonzero(fold == number)} == {"adult", "child"}
    for actor in {clip.meta.actor for clip in clips}:
        assert len({fold[i] for i, clip in enumerate(clips) if clip.meta.actor == actor}) == 1


def test_who_performs_both_styles_is_left_out_of_both() -> None:
    clips = [labelled(f"p{n}", s, "x", t) for s in ("adult", "child") for n in range(n0(s), 4) for t in range(2)]
    given = examples([int(c.meta.style == "child") for c in clips], [0] * len(clips))
    fold, by_performer = deal(clips, given)
    assert by_performer
    for actor in {clip.meta.actor for clip in clips}:
        assert len({fold[i] for i, clip in enumerate(clips) if clip.meta.actor == actor}) == 1


def n0(style: str) -> int:
    """So that the two casts overlap without being the same."""
    return 0 if style == "adult" else 1


@pytest.mark.parametrize("actors", [("", ""), ("one", "two")])
def test_clips_are_left_out_where_performers_are_not_known(actors: tuple[str, str]) -> None:
    names = dict(zip(("adult", "child"), actors, strict=True))
    clips = [labelled(names[s], s, a, t) for s in ("adult", "child") for a in "xy" for t in range(6)]
    given = examples([int(c.meta.style == "child") for c in clips], [int(c.meta.action == "y") for c in clips])
    fold, by_performer = deal(clips, given)
    assert not by_performer
    for style in (0, 1):
        for action in (0, 1):
            assert np.bincount(fold[(given.style == style) & (given.action == action)]).tolist() == [2, 2, 2]
    # Blocks: neighbours are left out together.
    assert np.flatnonzero(np.diff(fold[:6])).tolist() == [1, 3]


@pytest.mark.parametrize("factor", [0.3, 1.0, 4.0])
def test_the_temperature_is_the_factor_by_which_scores_are_too_sure(factor: float, rng: np.random.Generator) -> None:
    true = 2.0 * rng.standard_normal((6000, 3))
    labels = (softmax(true).cumsum(axis=1) < rng.random((6000, 1))).sum(axis=1)
    found = calibrate([factor * row[None] for row in true], labels, np.full(6000, 1.0))
    assert found == pytest.approx(factor, rel=0.08)


def test_scores_that_know_nothing_are_flattened(rng: np.random.Generator) -> None:
    scores = [10.0 * rng.standard_normal((4, 2)) for _ in range(400)]
    labels = rng.integers(0, 2, 400)
    temperature = calibrate(scores, labels, np.ones(400))
    assert max(abs(softmax(each, temperature).mean(axis=0)[1] - 0.5) for each in scores) < 0.2


def test_no_number_of_hits_makes_certain() -> None:
    labels = np.arange(10) % 2
    scores = [np.array([[-50.0, 50.0]]) * (2 * label - 1) for label in labels]
    temperature = calibrate(scores, labels, np.ones(10))
    # Platt's target for ten hits: the eleven in twelve of a success more.
    assert softmax(scores[1], temperature)[0, 1] == pytest.approx(11 / 12, abs=1e-3)


def test_a_planted_style_is_found_and_probabilities_keep_their_word(rng: np.random.Generator) -> None:
    kind, view = planted(rng, takes=40, style=0.5)
    probe = fitted(kind, view)
    # The mean of three unit normals 0.5 to either side: right in Phi(0.5 sqrt 3) = 0.807 of all clips.
    assert probe.facts_["style_accuracy"] == pytest.approx(0.807, abs=0.06)
    assert probe.facts_["action_accuracy"] > 0.95
    fresh_kind, fresh = planted(np.random.default_rng(77), actors=5, takes=60, style=0.5)
    judged = [(softmax_target(probe, fresh_kind.drawn[clip.meta.clip_id]), clip.meta.style) for clip in fresh.held]
    for low, high in ((0.0, 0.35), (0.35, 0.5), (0.5, 0.65), (0.65, 1.0)):
        chosen = [(p, style == "child") for p, style in judged if low <= p < high]
        assert len(chosen) > 80
        stated, true = np.mean(chosen, axis=0)
        assert stated == pytest.approx(true, abs=0.1)


def softmax_target(probe: Planted, features: np.ndarray) -> float:
    scores = probe.scores(probe.members_[0], features)
    return float(softmax(scores.style, probe.temperatures_["style"])[:, 1].mean())


def test_without_a_style_strangers_are_judged_at_chance() -> None:
    kind, view = planted(np.random.default_rng(5), takes=25)
    facts = fitted(kind, view).facts_
    # 300 independent clips: four standard deviations.
    assert facts["style_accuracy"] == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(300))
    assert facts["chance_style"] == 0.5
    assert facts["style_p_target"]["adult"] == pytest.approx(0.5, abs=0.05)


def test_individuals_are_not_taken_for_styles() -> None:
    # Every performer is recognisable and the style does nothing: leaving out clips would find a style, performers do not.
    by_performer, by_clip = [], []
    for seed in range(24):
        kind, view = planted(np.random.default_rng(seed), takes=3, actor=2.0)
        by_performer.append(fitted(kind, view).facts_["style_accuracy"])
        hidden = tuple(
            clip.replace(meta=replace(clip.meta, actor="", take=f"{clip.meta.actor}-{clip.meta.take}"))
            for clip in view.held
        )
        drawn = {new.meta.clip_id: kind.drawn[old.meta.clip_id] for old, new in zip(view.held, hidden, strict=True)}
        by_clip.append(fitted(type("Drawn", (Planted,), {"drawn": drawn}), SmallView(hidden)).facts_["style_accuracy"])
    # Six performers are either right or wrong as a whole, so the mean of 24 draws of 6 has a deviation of 0.5 / 12.
    assert np.mean(by_performer) == pytest.approx(0.5, abs=4 * 0.5 / 12)
    assert np.mean(by_clip) > 0.8


def test_saved_and_read_back_to_the_bit(tmp_path, rng: np.random.Generator) -> None:
    kind, view = planted(rng, style=1.0)
    probe = fitted(kind, view)
    probe.save(tmp_path)
    again = kind.load(tmp_path)
    for clip in view.held:
        one, two = probe.recognise(clip), again.recognise(clip)
        assert (one.target, dict(one.actions)) == (two.target, dict(two.actions))
    assert (again.styles_, again.actions_, again.facts_) == (probe.styles_, probe.actions_, probe.facts_)
    assert again.facts_["left_out"] == "performers"


def test_the_same_generator_gives_the_same_probe_and_fitting_again_forgets(rng: np.random.Generator) -> None:
    kind, view = planted(rng, style=0.3)
    one, two = fitted(kind, view), fitted(kind, view)
    clip = view.held[0]
    assert one.recognise(clip) == one.recognise(clip)
    assert one.recognise(clip).target == two.recognise(clip).target
    half = SmallView(tuple(clip for clip in view.held if clip.meta.take in "0123"))
    before = one.recognise(clip).target
    one.fit(half, TASK, rng=np.random.default_rng(1), ctx=FitContext())
    assert one.facts_["clips"] == len(half.held)
    assert len(one.members_) == 1
    assert one.recognise(clip).target != before


def test_what_is_stored_is_checked(tmp_path, rng: np.random.Generator) -> None:
    kind, view = planted(rng)
    with pytest.raises(StoreError, match="remove it and fit again"):
        kind.load(tmp_path / "nowhere")
    fitted(kind, view).save(tmp_path)
    facts = json.loads((tmp_path / "facts.json").read_text())
    (tmp_path / "facts.json").write_text(json.dumps({**facts, "probe": "another"}))
    with pytest.raises(StoreError, match="holds no recogniser-kinematic"):
        kind.load(tmp_path)
    (tmp_path / "facts.json").write_text(json.dumps(facts))
    (tmp_path / "arrays.npz").write_bytes(b"PK nothing")
    with pytest.raises(StoreError, match="remove it and fit again"):
        kind.load(tmp_path)


def test_where_there_is_nothing_to_learn() -> None:
    def view(*kinds: tuple[str, str]) -> SmallView:
        return SmallView(tuple(labelled(f"{s}{n}", s, a, n) for s, a in kinds for n in range(2)))

    class Blind(Planted):
        def features(self, clip: MotionClip) -> np.ndarray:
            return np.zeros((1, 2))

    for given in (view(("adult", "walk"), ("child", "wave")), view(("adult", "walk")), view(("child", "walk"))):
        with pytest.raises(NotApplicableError, match="no action is performed in both"):
            Blind().fit(given, TASK, rng=np.random.default_rng(1), ctx=FitContext())
    with pytest.raises(NotApplicableError, match="cannot be told from itself"):
        KinematicRecogniser().fit(
            view(("adult", "walk")), StyleTask("adult", "adult"), rng=np.random.default_rng(1), ctx=FitContext()
        )
    with pytest.raises(ContractError, match="was not fitted"):
        KinematicRecogniser().recognise(perform("walk", "adult", 1))


def test_a_training_clip_too_short_to_describe_is_left_out() -> None:
    clips = [perform(a, s, t) for s in ("adult", "child") for a in ("walk", "wave") for t in (1, 2)]
    clips.append(labelled("adult1", "adult", "jump", 1))
    probe = KinematicRecogniser().fit(SmallView(tuple(clips)), TASK, rng=np.random.default_rng(1), ctx=FitContext())
    assert probe.facts_["clips"] == 8
    assert probe.actions_ == ("walk", "wave")


def test_a_body_with_core_joints_only_will_do() -> None:
    view = SmallView(
        tuple(perform(a, s, t, roles="core") for s in ("adult", "child") for a in ("walk", "wave") for t in (1, 2))
    )
    probe = KinematicRecogniser().fit(view, TASK, rng=np.random.default_rng(1), ctx=FitContext())
    assert probe.recognise(perform("walk", "child", 3)).action == "walk"
    assert figure(0.8, roles="core").has("hips")

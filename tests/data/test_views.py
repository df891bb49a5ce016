from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmark.api import TrainView
from benchmark.data.splits import make_split
from benchmark.data.views import eval_items, target_skeleton, train_view
from benchmark.errors import DataError, LeakageError

SIZES = {"a0": 1.0, "a1": 1.1, "a2": 0.9, "a3": 1.2, "c0": 0.6, "c1": 0.7, "c2": 0.5, "c3": 0.8, "c4": 0.65, "c5": 0.55}


@pytest.fixture
def people(grid, make_clip):
    return grid(4, 6, 5, 2, lambda record: make_clip(SIZES[record.actor], frames=4))


def ids(clips):
    return [clip.meta.clip_id for clip in clips]


def test_a_view_shows_the_training_clips_and_no_other(people):
    split = make_split(people, "adult", "child")
    view: TrainView = train_view(people, split, "adult", "child")
    assert people.loads == [], "nothing is read before it is asked for"
    assert ids(view.clips()) == list(split.train)
    assert sorted(people.loads) == list(split.train)
    assert view.clips()[0] is view.clips()[0] and len(people.loads) == len(split.train)
    assert view.fps == 30.0 and view.actions == tuple(f"action{i}" for i in range(5))
    assert ids(view.clips("child")) == [i for i in split.train if i.startswith("child")]
    assert ids(view.clips("adult", action="action3")) == [
        i for i in split.train if i.startswith("adult") and "action3_" in i
    ]
    actor = people.record(split.train[0]).actor
    assert ids(view.clips(actor=actor)) == [i for i in split.train if f"/{actor}/" in i]
    assert list(view.clips("martian")) == []


def test_pairs_are_every_pair_of_takes_of_an_action(people):
    split = make_split(people, "adult", "child")
    view = train_view(people, split, "adult", "child")
    found = [(a.meta.clip_id, b.meta.clip_id) for a, b in view.pairs("adult", "child")]
    wanted = [
        (a, b)
        for a in split.train
        for b in split.train
        if a.startswith("adult") and b.startswith("child") and people.record(a).action == people.record(b).action
    ]
    assert found == wanted and len(found) > 0


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(fraction=st.floats(0.01, 0.5), seed=st.integers(0, 5))
def test_validation_cuts_by_clip(people, fraction, seed):
    split = make_split(people, "adult", "child", seed=seed)
    view = train_view(people, split, "adult", "child")
    large, small = view.validation(fraction)
    assert sorted(large.clip_ids + small.clip_ids) == list(split.train)
    assert set(large.clip_ids).isdisjoint(small.clip_ids)
    for style in ("adult", "child"):
        total = len(view.clips(style))
        assert len(small.clips(style)) == max(1, round(fraction * total))
    again = train_view(people, split, "adult", "child").validation(fraction)
    assert again[1].clip_ids == small.clip_ids
    with pytest.raises(ValueError, match="fraction"):
        view.validation(0.7)


def test_items_know_their_references(people):
    split = make_split(people, "adult", "child")
    items = eval_items(people, split, "adult", "child")
    assert [i.record.clip_id for i in items] == [i.clip_id for i in split.test]
    assert [i.seen_actor for i in items] == [i.seen_actor for i in split.test]
    for item in items:
        wanted = [i for i in split.references if people.record(i).action == item.record.action]
        assert list(item.reference_ids) == wanted and wanted
        assert not item.has_truth
    assert people.loads == []


def test_items_know_whether_there_is_a_truth(people, monkeypatch):
    split = make_split(people, "adult", "child")
    first = split.test[0].clip_id
    truth = people.load(split.references[0])
    monkeypatch.setattr(type(people), "truth", lambda self, clip_id, style: truth if clip_id == first else None)
    items = eval_items(people, split, "adult", "child")
    assert [i.has_truth for i in items] == [True] + [False] * (len(items) - 1)


def test_the_target_skeleton_is_the_median_training_childs(people):
    for seed in range(6):
        split = make_split(people, "adult", "child", seed=seed)
        trained = sorted({people.record(i).actor for i in split.train if i.startswith("child")}, key=SIZES.__getitem__)
        leg = target_skeleton(people, split, "child").leg_length
        assert leg == pytest.approx(0.86 * SIZES[trained[1]])
    even = make_split(people, "adult", "child", n_train=2, protocol="paper")
    trained = sorted({people.record(i).actor for i in even.train if i.startswith("child")}, key=SIZES.__getitem__)
    assert target_skeleton(people, even, "child").leg_length == pytest.approx(0.86 * SIZES[trained[0]])
    with pytest.raises(DataError, match="no training clip of style 'old'"):
        target_skeleton(people, even, "old")


def test_where_performers_are_unknown_a_clip_stands_for_them(listed, record, make_clip):
    dataset = listed(
        [record(s, "", f"a{i}", "1") for s in ("normal", "old") for i in range(9)], lambda r: make_clip(0.9, frames=3)
    )
    split = make_split(dataset, "normal", "old")
    assert target_skeleton(dataset, split, "old").leg_length == pytest.approx(0.86 * 0.9)
    assert len(dataset.loads) <= 5


def test_views_check_the_split_on_every_load(people, listed):
    split = make_split(people, "adult", "child")
    with pytest.raises(DataError, match="for adult:child, not for child:adult"):
        train_view(people, split, "child", "adult")
    with pytest.raises(DataError, match="for adult:child, not for adult:old"):
        eval_items(people, split, "adult", "old")
    from dataclasses import replace

    leaky = replace(split, train=(*split.train, split.references[0]))
    for use in (train_view, eval_items):
        with pytest.raises(LeakageError):
            use(people, leaky, "adult", "child")

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmark.data.bandai_namco import BandaiNamco
from benchmark.data.catalog import open_dataset
from benchmark.data.leakage import natural
from benchmark.data.splits import Split, TestItem, available_protocols, check, load_split, make_split
from benchmark.errors import DataError, LeakageError, UnknownNameError

SETTINGS = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def sides(split, dataset):
    return (
        [dataset.record(i) for i in split.train],
        [dataset.record(i.clip_id) for i in split.test],
        [dataset.record(i) for i in split.references],
    )


@SETTINGS
@given(
    adults=st.integers(2, 6),
    children=st.integers(2, 6),
    actions=st.integers(2, 12),
    takes=st.integers(1, 4),
    n_train=st.integers(1, 5),
    seed=st.integers(0, 50),
    fold=st.integers(0, 3),
)
def test_paper_protocol(grid, adults, children, actions, takes, n_train, seed, fold):
    dataset = grid(adults, children, actions, takes)

    def make():
        return make_split(dataset, "adult", "child", protocol="paper", n_train=n_train, seed=seed, fold=fold)

    if n_train + 1 > min(adults, children):
        with pytest.raises(DataError, match=r"performers of each style.*protocols that would work"):
            make()
        return
    split = make()
    train, _, references = sides(split, dataset)
    assert split.digest == make().digest
    assert Counter(r.style for r in train).keys() == {"adult", "child"}
    seen = [i for i in split.test if i.seen_actor]
    unseen = [i for i in split.test if not i.seen_actor]
    trained = {r.actor for r in train}
    assert len(trained) == 2 * n_train
    assert {dataset.record(i.clip_id).actor for i in unseen}.isdisjoint(trained)
    assert len({dataset.record(i.clip_id).actor for i in unseen}) == 1 and len(unseen) == actions * takes
    # Every clip of a child outside training, and the clips held out of training, are references; nothing else.
    outside = {r.clip_id for r in dataset.records if r.style == "child"} - set(split.train)
    assert set(split.references) == outside
    # Ten percent of each training adult's clips, and the same number of each training child's.
    per_actor = actions * takes
    most = max(1, round(0.1 * per_actor))
    for style, left_out in (("adult", seen), ("child", [r for r in references if r.actor in trained])):
        actors = [r.actor for r in train if r.style == style]
        assert len(left_out) == n_train * per_actor - len(actors)
        assert all(per_actor - most <= n <= per_actor for n in Counter(actors).values())
    if n_train * takes >= 2 and n_train * most * 2 <= actions:
        assert all(n == per_actor - most for n in Counter(r.actor for r in train).values())
    # What is tested is still learned from someone else, and can be compared with a real child.
    for item in seen:
        record = dataset.record(item.clip_id)
        for style in ("adult", "child"):
            assert any(r.action == record.action and r.style == style for r in train)
        assert any(r.action == record.action and r.take == record.take for r in references if r.actor in trained)
        assert any(r.action == record.action for r in references)
    combinations = [(dataset.record(i.clip_id).action, dataset.record(i.clip_id).take) for i in seen]
    # Three performers cannot each hold out another of two combinations.
    if n_train > 1 and len(combinations) <= per_actor:
        assert len(set(combinations)) == len(combinations)


def test_where_actions_run_out_other_takes_are_held_out(grid):
    dataset = grid(5, 5, 2, 2)
    for seed in range(10):
        split = make_split(dataset, "adult", "child", protocol="paper", n_train=4, seed=seed)
        seen = [dataset.record(item.clip_id) for item in split.test if item.seen_actor]
        assert len(seen) == len({(record.action, record.take) for record in seen}) == 4


@SETTINGS
@given(adults=st.integers(2, 7), children=st.integers(2, 7), folds=st.integers(0, 7), seed=st.integers(0, 9))
def test_actor_folds_partition_the_performers(grid, adults, children, folds, seed):
    dataset = grid(adults, children, 3, 2)
    most = min(adults, children)
    if folds == 1 or folds > most:
        with pytest.raises(DataError, match="folds must be between"):
            make_split(dataset, "adult", "child", protocol="actors-kfold", folds=folds)
        return
    count = folds or min(5, most)
    tested, referenced = Counter(), Counter()
    for fold in range(count):
        split = make_split(dataset, "adult", "child", protocol="actors-kfold", folds=folds, fold=fold, seed=seed)
        train, test, references = sides(split, dataset)
        assert {r.actor for r in train}.isdisjoint({r.actor for r in (*test, *references)})
        assert len(train) + len(test) + len(references) == len(dataset.records)
        tested.update({r.actor for r in test})
        referenced.update({r.actor for r in references})
        assert not any(i.seen_actor for i in split.test)
    assert tested == Counter({f"a{i}": 1 for i in range(adults)})
    assert referenced == Counter({f"c{i}": 1 for i in range(children)})
    with pytest.raises(DataError, match=f"folds 0 to {count - 1}"):
        make_split(dataset, "adult", "child", protocol="actors-kfold", folds=folds, fold=count)


@SETTINGS
@given(takes=st.integers(2, 12), blocks=st.integers(2, 4), actors=st.integers(1, 2))
def test_take_blocks_are_contiguous_and_cover_all(grid, takes, blocks, actors):
    dataset = grid(actors, actors, 2, takes)
    tested = Counter()
    for fold in range(blocks):
        try:
            split = make_split(dataset, "adult", "child", protocol="take-block", blocks=blocks, fold=fold)
        except DataError as error:
            assert takes < blocks and "leaves nothing to transfer" in str(error)
            continue
        _, test, _ = sides(split, dataset)
        tested.update(r.clip_id for r in test)
        for actor in {r.actor for r in test}:
            for action in {r.action for r in test}:
                held = sorted(int(r.take) for r in test if (r.actor, r.action) == (actor, action))
                assert held == list(range(held[0], held[-1] + 1))
                assert takes // blocks <= len(held) <= -(-takes // blocks)
    assert tested == Counter({r.clip_id: 1 for r in dataset.records if r.style == "adult"})


@SETTINGS
@given(actions=st.integers(2, 9), seed=st.integers(0, 9))
def test_action_folds_partition_the_actions(grid, actions, seed):
    dataset = grid(1, 1, actions, 1)
    tested = Counter()
    for fold in range(min(3, actions)):
        split = make_split(dataset, "adult", "child", protocol="action", fold=fold, seed=seed)
        train, test, references = sides(split, dataset)
        assert {r.action for r in train}.isdisjoint({r.action for r in test})
        assert {r.action for r in test} == {r.action for r in references}
        assert all(item.seen_actor for item in split.test)
        tested.update({r.action for r in test})
    assert tested == Counter({f"action{i}": 1 for i in range(actions)})


def test_seed_and_fold_choose_others(grid):
    dataset = grid(6, 6, 10, 2)
    paper = {
        make_split(dataset, "adult", "child", protocol="paper", seed=s, fold=f).train
        for s in range(3)
        for f in range(2)
    }
    assert len(paper) == 6
    assert len({make_split(dataset, "adult", "child", protocol="action", seed=s).train for s in range(4)}) > 1


def test_a_split_is_the_same_for_ever(grid):
    """A golden manifest: another value here means that stored splits no longer match what the code makes."""
    split = make_split(grid(5, 5, 10, 2), "adult", "child", protocol="paper", seed=1)
    assert sorted({i.split("/")[1] for i in split.train}) == ["a0", "a1", "a4", "c0", "c2", "c4"]
    assert split.digest == "fbd18d41133327e4d024d5e911a1145b60a279a0d94bc6d6ab98a699dcfeea01"


def test_people_who_perform_both_styles_stay_on_one_side(listed, record):
    people = [f"p{i}" for i in range(5)]
    dataset = listed([record(s, p, a, "1") for s in ("normal", "old") for p in people for a in ("walk", "run", "bow")])
    for protocol in ("paper", "actors-kfold"):
        for seed in range(5):
            split = make_split(dataset, "normal", "old", protocol=protocol, seed=seed)
            train, _, _ = sides(split, dataset)
            unseen = {dataset.record(i.clip_id).actor for i in split.test if not i.seen_actor}
            assert unseen and unseen.isdisjoint({r.actor for r in train})
            for style in ("normal", "old"):
                assert {r.actor for r in train if r.style == style} == {r.actor for r in train}


def test_half_shared_performers_never_lead_to_a_leak(listed, record):
    dataset = listed(
        [record("normal", p, a, "1") for p in ("p0", "p1", "p2", "p3", "p4") for a in ("walk", "run")]
        + [record("old", p, a, "1") for p in ("p3", "p4", "q0", "q1", "q2", "q3") for a in ("walk", "run")]
    )
    made = 0
    for seed in range(12):
        try:
            split = make_split(dataset, "normal", "old", protocol="paper", n_train=2, seed=seed)
        except DataError as error:
            assert "performers of each style" in str(error)
            continue
        made += 1
        train, _, _ = sides(split, dataset)
        trained = {r.actor for r in train}
        assert len({dataset.record(item.clip_id).actor for item in split.test if not item.seen_actor}) == 1
        assert all(item.seen_actor == (dataset.record(item.clip_id).actor in trained) for item in split.test)
    assert made


def test_auto_suits_what_is_there(grid, listed, record):
    assert make_split(grid(4, 4, 5, 1), "adult", "child").protocol == "paper"
    two = make_split(grid(2, 3, 5, 1), "adult", "child")
    assert (two.protocol, two.parameters["n_train"]) == ("paper", 1)
    assert make_split(grid(1, 3, 5, 4), "adult", "child").protocol == "take-block"
    assert make_split(grid(1, 1, 5, 2), "adult", "child").parameters == {"blocks": 2}
    assert make_split(grid(1, 1, 5, 1), "adult", "child").protocol == "action"
    with pytest.raises(DataError, match=r"1 actions in both; no protocol can split"):
        make_split(listed([record("adult", "a", "walk", "1"), record("child", "c", "walk", "1")]), "adult", "child")


def test_too_little_says_what_there_is_and_what_would_work(grid):
    with pytest.raises(DataError) as caught:
        make_split(grid(3, 2, 4, 3), "adult", "child", protocol="paper")
    text = str(caught.value)
    assert "adult: 36 clips, 3 performers" in text and "child: 24 clips, 2 performers" in text
    assert "paper with n_train=1, actors-kfold, take-block, action" in text
    assert available_protocols(grid(1, 1, 1, 2), "adult", "child") == ("take-block with blocks=2",)
    with pytest.raises(DataError, match="two takes"):
        make_split(grid(2, 2, 4, 1), "adult", "child", protocol="take-block")
    with pytest.raises(DataError, match="two actions"):
        make_split(grid(2, 2, 1, 4), "adult", "child", protocol="action")


def test_wrong_requests(grid):
    dataset = grid(4, 4, 4, 1)
    with pytest.raises(UnknownNameError, match="did you mean 'paper'"):
        make_split(dataset, "adult", "child", protocol="papre")
    with pytest.raises(UnknownNameError, match="n_train"):
        make_split(dataset, "adult", "child", protocol="paper", ntrain=2)
    with pytest.raises(UnknownNameError, match="did you mean 'child'"):
        make_split(dataset, "adult", "chld")
    with pytest.raises(DataError, match="two different styles"):
        make_split(dataset, "adult", "adult")
    for bad in ({"n_train": 0}, {"n_train": 1.5}, {"held_out": 0.7}, {"fold": -1}):
        with pytest.raises(DataError):
            make_split(dataset, "adult", "child", protocol="paper", **bad)


def test_manifests_round_trip_and_refuse_edits(grid, tmp_path):
    dataset = grid(4, 4, 6, 2)
    split = make_split(dataset, "adult", "child")
    path = tmp_path / "run" / "split.json"
    split.to_json(path)
    again = load_split(path, dataset)
    assert again == split and again.digest == split.digest
    stored = json.loads(path.read_text())
    for change in (
        lambda c: c["train"].pop(),
        lambda c: c.update(seed=5),
        lambda c: c["test"][0].update(seen_actor=not c["test"][0]["seen_actor"]),
        lambda c: c.update(digest="0" * 64),
    ):
        content = json.loads(json.dumps(stored))
        change(content)
        path.write_text(json.dumps(content))
        with pytest.raises(DataError, match="changed after it was written"):
            Split.from_json(path)
    for text, match in (
        ("{", "not a split manifest"),
        ("[]", "format 1"),
        (json.dumps({**stored, "format": 2}), "format 1"),
        (json.dumps({**stored, "fold": "0"}), "fold"),
        (json.dumps({**stored, "extra": 1}), "extra"),
    ):
        path.write_text(text)
        with pytest.raises(DataError, match=match):
            Split.from_json(path)
    with pytest.raises(DataError, match="no split manifest"):
        Split.from_json(tmp_path / "absent.json")


def test_an_altered_or_lost_clip_is_named(grid, listed):
    dataset = grid(4, 4, 6, 1)
    split = make_split(dataset, "adult", "child")
    victim = split.references[0]
    altered = listed([replace(r, sha256="f" * 64) if r.clip_id == victim else r for r in dataset.records])
    with pytest.raises(DataError, match=f"{victim}.*altered"):
        check(split, altered)
    lost = listed([r for r in dataset.records if r.clip_id != victim])
    with pytest.raises(DataError, match=f"{victim}.*not in data set"):
        check(split, lost)
    with pytest.raises(DataError, match=f"{victim}.*without the digest"):
        check(replace(split, files={k: v for k, v in split.files.items() if k != victim}), dataset)
    with pytest.raises(DataError, match="made for data set 'folder'"):
        check(split, listed(list(dataset.records), card="synthetic"))


def test_planted_leaks_are_found(grid, listed):
    dataset = grid(5, 5, 6, 3)
    split = make_split(dataset, "adult", "child", protocol="paper")
    check(split, dataset)
    seen = next(i for i in split.test if i.seen_actor)
    unseen = next(i for i in split.test if not i.seen_actor)
    child = next(i for i in split.train if i.startswith("child"))
    adult = next(i for i in split.train if i.startswith("adult"))
    leaks = {
        "is listed under training and under test": replace(split, train=(*split.train, seen.clip_id)),
        "is listed under training and under reference": replace(split, train=(*split.train, split.references[0])),
        "listed under training and under training": replace(split, train=(*split.train, adult)),
        "marked as of an unseen": replace(split, test=(TestItem(seen.clip_id, False),)),
        "marked as of a seen": replace(split, test=(TestItem(unseen.clip_id, True),)),
        "test clip .* has style 'child'": replace(
            split, train=tuple(i for i in split.train if i != child), test=(*split.test, TestItem(child, True))
        ),
        "reference clip .* has style 'adult'": replace(
            split, train=tuple(i for i in split.train if i != adult), references=(*split.references, adult)
        ),
    }
    for message, leaky in leaks.items():
        leaky = replace(leaky, files={r.clip_id: r.sha256 for r in dataset.records})
        with pytest.raises(LeakageError, match=message):
            check(leaky, dataset)


def test_one_file_under_two_names_is_a_leak(grid, listed):
    dataset = grid(4, 4, 6, 1)
    split = make_split(dataset, "adult", "child")
    for other in (split.test[0].clip_id, split.references[0]):
        content = dataset.record(split.train[0]).sha256
        twins = listed([replace(r, sha256=content) if r.clip_id == other else r for r in dataset.records])
        with pytest.raises(LeakageError, match="the same file under two names"):
            make_split(twins, "adult", "child")
        both = [r.clip_id for r in twins.records if r.sha256 == content]
        assert len(both) == 2


def test_one_take_under_two_ids_is_a_leak(grid, listed):
    dataset = grid(4, 4, 6, 1)
    split = make_split(dataset, "adult", "child")
    copy = replace(dataset.record(split.train[0]), clip_id="zz", sha256="e" * 64)
    more = listed([*dataset.records, copy])
    leaky = replace(split, test=(*split.test, TestItem("zz", True)), files={**split.files, "zz": copy.sha256})
    with pytest.raises(LeakageError, match="the same take"):
        check(leaky, more)


@pytest.mark.parametrize(
    ("protocol", "message"),
    [
        ("actors-kfold", "performer '.*' is in training"),
        ("action", "action '.*' is in training"),
        ("take-block", "lies between"),
    ],
)
def test_protocol_leaks_are_found(grid, protocol, message):
    dataset = grid(4, 4, 6, 9)
    split = make_split(dataset, "adult", "child", protocol=protocol, fold=1)
    # A reference moves to training: for take blocks the one in the middle of its block, so that its neighbours stay.
    moved = next(i for i in split.references if protocol != "take-block" or i.endswith("_4"))
    leaky = replace(split, train=(*split.train, moved), references=tuple(i for i in split.references if i != moved))
    with pytest.raises(LeakageError, match=message):
        check(leaky, dataset)


def test_a_performer_in_two_styles_on_both_sides_is_a_leak(listed, record):
    people = [f"p{i}" for i in range(4)]
    dataset = listed([record(s, p, a, "1") for s in ("normal", "old") for p in people for a in ("walk", "run", "bow")])
    split = make_split(dataset, "normal", "old", protocol="paper", n_train=2)
    person = dataset.record(split.train[0]).actor
    keep = tuple(i for i in split.train if not i.startswith(f"old/{person}/"))
    moved = tuple(i for i in split.train if i.startswith(f"old/{person}/"))
    leaky = replace(split, train=keep, references=(*split.references, *moved))
    with pytest.raises(LeakageError, match="in training in one style and a reference in another"):
        check(leaky, dataset)


def test_takes_sort_as_numbers():
    takes = ["10", "a10", "2-010", "9", "a2", "1", "2-9", "²"]
    assert sorted(takes, key=natural) == ["a2", "a10", "²", "1", "2-9", "2-010", "9", "10"]


def test_bandai_namco_prefers_the_recording_with_more_takes(record):
    """`normal` and `active` are in both recordings; a task of the two never mixes them."""
    dataset = object.__new__(BandaiNamco)
    dataset.part = None
    names = [("1", "walk", "001"), *(("2", "walk", f"{take:03d}") for take in range(1, 10))]
    dataset.records = tuple(
        record(s, "", action, f"{part}-{take}") for s in ("active", "normal") for part, action, take in names
    )
    split = make_split(dataset, "normal", "active")
    assert split.protocol == "take-block" and len(split.clip_ids) == 18
    assert all("_2-" in clip_id for clip_id in split.clip_ids)


@pytest.mark.real_data
def test_kinder_gator_by_the_papers_protocol(kinder_gator):
    dataset = open_dataset("kinder-gator", root=kinder_gator)
    split = make_split(dataset, "adult", "child")
    assert split.protocol == "paper"
    train, _, references = sides(split, dataset)
    assert Counter(r.style for r in train)["child"] == 66 and 65 <= Counter(r.style for r in train)["adult"] <= 66
    seen = [i for i in split.test if i.seen_actor]
    assert len(seen) == 6 and len(split.test) - 6 in (23, 24)
    assert len(references) == 4 * 24 + 6
    assert len({dataset.record(i.clip_id).action for i in seen}) == 6


@pytest.mark.real_data
def test_bandai_namco_by_what_each_recording_allows(bandai_namco):
    dataset = open_dataset("bandai-namco", root=bandai_namco)
    first = make_split(dataset, "normal", "childish")
    assert first.protocol == "action" and not any("_2-" in i for i in first.clip_ids)
    second = make_split(dataset, "normal", "elderly")
    assert second.protocol == "take-block" and not any("_1-" in i for i in second.clip_ids)
    assert (len(second.train), len(second.test), len(second.references)) == (32, 8, 8)
    assert not any(item.seen_actor for item in second.test)
    assert make_split(open_dataset("bandai-namco", root=bandai_namco, part=1), "normal", "old").protocol == "action"
    with pytest.raises(DataError, match="'childish' is in dataset-1, 'elderly' in dataset-2"):
        make_split(dataset, "childish", "elderly")

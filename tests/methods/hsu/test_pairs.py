"""Ranking and keeping pairs of takes."""

from __future__ import annotations

import numpy as np

from methods.hsu.pairs import Pair, Take, keep, rank


def take(name: str, action: str, values: np.ndarray) -> Take:
    return Take(name, action, values)


def curve(shift: float, frames: int = 60) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, frames)
    return np.stack([np.sin(t + shift), np.cos(2 * t + shift), np.sin(3 * t + shift)], axis=-1)[:, None].repeat(
        4, axis=1
    )


def test_the_closest_come_first_and_actions_do_not_mix() -> None:
    sources = [take("a1", "walk", curve(0.0)), take("a2", "jump", curve(1.0))]
    targets = [take("c1", "walk", curve(1.5)), take("c2", "walk", curve(0.1, 80)), take("c3", "jump", curve(0.9))]
    pairs = rank(sources, targets, 30.0)
    assert {(pair.source.clip_id, pair.target.clip_id) for pair in pairs} == {("a1", "c1"), ("a1", "c2"), ("a2", "c3")}
    assert [pair.distance for pair in pairs] == sorted(pair.distance for pair in pairs)
    assert pairs[-1].target.clip_id == "c1"


def test_ranking_reports_progress() -> None:
    seen: list[float] = []
    rank([take("a", "walk", curve(0.0))], [take("c", "walk", curve(0.0))] * 4, 30.0, seen.append)
    assert seen == [0.25, 0.5, 0.75, 1.0]


def test_keeping() -> None:
    takes = {name: take(name, name[0], curve(0.0)) for name in ("w1", "w2", "j1", "w8", "w9", "j9")}
    ranked = [
        Pair(takes[source], takes[target], float(index))
        for index, (source, target) in enumerate([("w1", "w8"), ("w1", "w9"), ("w2", "w9"), ("j1", "j9"), ("w2", "w8")])
    ]

    def kept(**rule: int) -> list[tuple[str, str]]:
        return [(pair.source.clip_id, pair.target.clip_id) for pair in keep(ranked, **rule)]

    assert len(kept(partners=0, per_action=0)) == 5
    assert kept(partners=1, per_action=0) == [("w1", "w8"), ("w2", "w9"), ("j1", "j9")]
    assert kept(partners=0, per_action=2) == [("w1", "w8"), ("w1", "w9"), ("j1", "j9")]
    assert kept(partners=1, per_action=1) == [("w1", "w8"), ("j1", "j9")]

from __future__ import annotations

from collections import Counter

import numpy as np

from reports.study.choices import UNSURE, action_choices, plain_action

SHOWN = ("jump", "walk-as-fast-as-you-can", "kick", "punch", "bow", "throw-a-ball-with-left-arm")


def test_the_right_answer_is_there_and_no_wrong_one_is_like_it():
    lists = action_choices(SHOWN, ["jump-with-one-leg", "walk"], count=5, rng=np.random.default_rng(0))
    assert set(lists) == set(SHOWN)
    for action, offered in lists.items():
        assert plain_action(action) in offered and offered[-1] == UNSURE
        assert len(set(offered)) == len(offered) == 6
        assert list(offered[:-1]) == sorted(offered[:-1])
    assert "jump with one leg" not in lists["jump"]
    assert "walk" not in lists["walk-as-fast-as-you-can"]


def test_wrong_answers_are_actions_of_the_study_equally_often():
    lists = action_choices(SHOWN, ["dance"], count=4, rng=np.random.default_rng(1))
    wrong = Counter(name for action, offered in lists.items() for name in offered[:-1] if name != plain_action(action))
    assert "dance" not in wrong
    assert max(wrong.values()) - min(wrong.values()) <= 1


def test_further_actions_fill_a_short_list():
    lists = action_choices(["jump"], ["walk", "bow", "kick"], count=4, rng=np.random.default_rng(0))
    assert set(lists["jump"]) == {"jump", "walk", "bow", "kick", UNSURE}

"""The answers that a page offers to "which action is being performed?"."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

#: The last answer of every list.
UNSURE = "I cannot tell"

#: Words that do not make two actions alike.
_SMALL = "a an and as at can do fast five for from in it of on one other over place the then to two up with you your"


def plain_action(action: str) -> str:
    """An action's name as a person reads it: ``walk-as-fast-as-you-can`` is ``walk as fast as you can``."""
    return re.sub(r"[\s_\-]+", " ", action).strip()


def action_choices(
    shown: Sequence[str], others: Sequence[str], *, count: int, rng: np.random.Generator
) -> Mapping[str, tuple[str, ...]]:
    """The list of answers for each action, the same for every stimulus of that action and so for every condition.

    Parameters
    ----------
    shown
        Actions of the stimuli.
    others
        Further actions of the data set, used where those shown are not enough.
    count
        Answers in a list, the right one among them; :data:`UNSURE` comes on top.
    rng
        Decides among wrong answers that are equally good.

    Returns
    -------
    mapping
        Action to its answers in alphabetical order, so that the place says nothing. A wrong answer has no word of weight in
        common with the right one: *jump* is no wrong answer to *jump with one leg*. Every action serves as a wrong answer about
        equally often.
    """
    shown = sorted(set(shown))
    used = dict.fromkeys([*shown, *sorted(set(others) - set(shown))], 0)
    lists = {}
    for action in (shown[index] for index in rng.permutation(len(shown))):
        pool = [name for name in used if not _alike(name, action)]
        draw = dict(zip(pool, rng.permutation(len(pool)), strict=True))
        pool.sort(key=lambda name: (name not in shown, used[name], draw[name]))
        chosen: list[str] = []
        for name in pool:
            # Nor are two wrong answers alike: who cannot tell jumps apart could rule both out.
            if len(chosen) < count - 1 and not any(_alike(name, other) for other in chosen):
                chosen.append(name)
                used[name] += 1
        lists[action] = (*sorted(plain_action(name) for name in (*chosen, action)), UNSURE)
    return lists


def _alike(first: str, second: str) -> bool:
    return first == second or bool(_weighty(first) & _weighty(second))


def _weighty(action: str) -> frozenset[str]:
    words = re.findall(r"[^\W\d_]+", action.casefold())
    return frozenset(re.sub(r"(ing|s)$", "", word) for word in words if word not in _SMALL.split())

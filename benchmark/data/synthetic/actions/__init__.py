"""How each of the 21 actions is performed: content, body and style in, score out."""

from __future__ import annotations

from collections.abc import Callable

from benchmark.data.synthetic.actions import gestures, jumps, locomotion
from benchmark.data.synthetic.body import Body
from benchmark.data.synthetic.content import Content
from benchmark.data.synthetic.score import Score
from benchmark.data.synthetic.styles import StyleParameters

PERFORMANCES: dict[str, Callable[[Score], None]] = {
    "throw-a-ball-with-left-arm": gestures.throw,
    "throw-a-ball-with-right-arm": gestures.throw,
    "punch": gestures.punch,
    "kick": gestures.kick,
    "jump-with-one-leg": jumps.one_leg,
    "jump-with-the-other-leg": jumps.one_leg,
    "idle": gestures.idle,
    "broad-jump-forward": jumps.broad_jump,
    "jump-as-high-as-you-can-in-place": jumps.jump_high,
    "jump": jumps.jump,
    "5-jumping-jacks": jumps.jumping_jacks,
    "walk": locomotion.there_and_back,
    "walk-as-fast-as-you-can": locomotion.there_and_back,
    "hop-scotch": locomotion.hop_scotch,
    "sneaky-walk": locomotion.there_and_back,
    "happy-walk": locomotion.there_and_back,
    "jog": locomotion.there_and_back,
    "run-as-fast-as-you-can": locomotion.there_and_back,
    "skip": locomotion.skip,
    "run-and-jump": locomotion.run_and_jump,
    "walk-step-over-obstacle": locomotion.step_over,
}


def write_score(content: Content, body: Body, style: StyleParameters) -> Score:
    """The score of ``content`` for a body and a style."""
    score = Score(body, style, content)
    PERFORMANCES[content.action](score)
    return score

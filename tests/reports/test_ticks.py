"""Axes of logarithms of every length have two ticks or more, told apart, apart, and on the page."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from reports.figures.style import new_figure, style
from reports.figures.ticks import log_ticks

DECADES = (0.0, 1e-6, 1e-3, 0.02, 0.1, 0.3, 0.5, 0.69, 0.71, 1.0, 1.5, 1.99, 2.01, 3.0, 4.0, 5.9, 6.1, 9.0)


@pytest.mark.parametrize("which", ["x", "y"])
@pytest.mark.parametrize("decades", DECADES)
def test_ticks_are_enough_and_apart(which, decades):
    rng = np.random.default_rng(0)
    for middle in 10.0 ** rng.uniform(-4, 4, 6):
        values = middle * 10.0 ** (decades * np.linspace(-0.5, 0.5, 5))
        with style():
            figure = new_figure(2.8, 1.9)
            axes = figure.add_axes((0.2, 0.2, 0.75, 0.75))
            axes.plot(*((values, range(5)) if which == "x" else (range(5), values)))
            getattr(axes, f"set_{which}scale")("log")
            log_ticks(axes, which)
            figure.canvas.draw()
            low, high = getattr(axes, f"get_{which}lim")()
            assert low <= values.min() and values.max() <= high
            assert high >= 2.99 * low
            labels = getattr(axes, f"get_{which}ticklabels")()
            place = {"x": 0, "y": 1}[which]
            shown = [text for text in labels if text.get_text() and low <= text.get_position()[place] <= high]
            names = [text.get_text() for text in shown]
            assert len(names) >= 2 and len(set(names)) == len(names), (middle, names)
            boxes = [text.get_window_extent().padded(-1.0) for text in shown]
            for (one, a), (other, b) in itertools.combinations(zip(names, boxes, strict=True), 2):
                assert not a.overlaps(b), f"{one} lies over {other}"
            if which == "y":
                assert min(box.x0 for box in boxes) >= 0, names


def test_a_span_without_ticks_is_refused():
    with style():
        axes = new_figure(2.0, 2.0).add_subplot()
        axes.set_xscale("log")
        with pytest.raises(ValueError, match="span is 2"):
            log_ticks(axes, "x", span=2.0)

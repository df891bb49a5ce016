"""Figures on the page: grouped, described, within a budget."""

from __future__ import annotations

import numpy as np
import pytest

from reports.drawing import SavedDrawing
from reports.html.pictures import NARROWEST, alternative, gallery, kind_of


@pytest.fixture
def drawings(tmp_path, rng):
    """Three pictures of noise, which compress badly: two wide ones and a narrow one."""
    from PIL import Image

    made = []
    for name, width in (("pose-strip-a", 1500), ("metrics-a-style", 1500), ("something", 200)):
        noise = rng.integers(0, 255, (300, width, 3), dtype=np.uint8)
        made.append(SavedDrawing(name, f"About {name}, n = 3: details. More.", tmp_path))
        Image.fromarray(noise).save(made[-1].png)
    return made


def _bytes(found):
    return sum(len(picture.data) * 4 // 3 for group in found.groups.values() for picture in group)


def test_pictures_that_fit_are_not_touched(drawings):
    found = gallery(drawings)
    assert list(found.groups) == ["Motion", "Scores of every metric", "Other figures"] and not found.notes
    (strip,) = found.groups["Motion"]
    assert strip.data == drawings[0].png.read_bytes() and (strip.width, strip.height) == (1500, 300)


@pytest.mark.parametrize("share", [0.5, 0.25, 0.1, 0.0])
def test_a_budget_is_kept_and_the_page_says_how(drawings, share):
    budget = int(share * _bytes(gallery(drawings)))
    found = gallery(drawings, budget)
    assert _bytes(found) <= budget and found.notes
    assert "the folder figures has all of them whole" in found.notes[-1]
    pictures = [picture for group in found.groups.values() for picture in group]
    assert len(pictures) == 3 and all(p.width >= NARROWEST for p in pictures if p.name != "something")
    assert any("left" in note or "own files only" in note for note in found.notes) == any(not p.data for p in pictures)


def test_alternatives_say_what_is_seen(drawings):
    text = alternative(drawings[0])
    assert text == "Pose strip a: About pose-strip-a, n = 3. The numbers drawn are in pose-strip-a.csv."
    assert kind_of("loss-curves-hsu") == "Training" and kind_of("critical-difference-x") == "Comparison of methods"

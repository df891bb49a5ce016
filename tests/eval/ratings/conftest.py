"""Stimuli and scores of a small study."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

CONDITIONS = ("adult", "ours", "theirs", "child")


@pytest.fixture(scope="session")
def stimuli() -> pd.DataFrame:
    """Four conditions of ten clips, two actions, all of them attention checks."""
    rows: list[dict[str, object]] = []
    for clip in range(10):
        for condition in CONDITIONS:
            action = ("jump-high", "walk")[clip % 2]
            rows.append(
                {
                    "stimulus": f"s{len(rows):03d}",
                    "condition": condition,
                    "clip_id": f"clip{clip}",
                    "action": action,
                    "actor": f"a{clip % 3}",
                    "attention": True,
                    "expected": action,
                }
            )
    return pd.DataFrame(rows)


@pytest.fixture(scope="session")
def scores(stimuli) -> pd.DataFrame:
    """The adult is taken for an adult, the child for a child, ``ours`` is between and ``theirs`` is jittery."""
    chance = {"adult": 0.15, "ours": 0.6, "theirs": 0.2, "child": 0.85}
    return pd.DataFrame(
        {
            "stimulus": stimuli["stimulus"],
            "recognition/p-target-kinematic": stimuli["condition"].map(chance),
            "physics/jerk-ratio": np.where(stimuli["condition"] == "theirs", 8.0, 1.0),
        }
    )

"""Bootstrap interval of a mean, side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from eval.stats.bootstrap import clustered_mean

CLIPS, ACTORS, RESAMPLES, REPEATS = 200, 20, 2000, 9


class Case:
    """Values of clips of actors. Peers know no clusters: they draw clips alone, which is less work."""

    def __init__(self, clips: int, actors: int, resamples: int) -> None:
        rng = np.random.default_rng(23)
        self.resamples = resamples
        self.actors = np.arange(clips) % actors
        self.values = rng.normal(size=clips)
        self.mean = float(self.values.mean())

    def check(self, low: float, high: float) -> None:
        """Hold a peer to an interval of about the right place and size: these clips are independent of their actors."""
        half = 1.96 / np.sqrt(len(self.values))
        if not (abs(self.mean - half - low) < half and abs(self.mean + half - high) < half):
            raise ValueError(f"its interval is {low:.4g} to {high:.4g}")


def _scipy(case: Case) -> Job:
    from scipy.stats import bootstrap

    rng = np.random.default_rng(0)

    def job() -> Any:
        return bootstrap(
            (case.values,), np.mean, n_resamples=case.resamples, method="percentile", vectorized=True, rng=rng
        ).confidence_interval

    case.check(*job())
    return job


def _plain(case: Case) -> Job:
    """Two stages as a loop over draws."""
    rng = np.random.default_rng(0)
    groups = [case.values[case.actors == actor] for actor in np.unique(case.actors)]

    def job() -> Any:
        means = []
        for _ in range(case.resamples):
            drawn = rng.integers(len(groups), size=len(groups) - 1)
            means.append(np.concatenate([rng.choice(groups[index], size=len(groups[index])) for index in drawn]).mean())
        return np.percentile(means, [2.5, 97.5])

    case.check(*job())
    return job


def run(
    console: Any, *, clips: int = CLIPS, actors: int = ACTORS, resamples: int = RESAMPLES, repeats: int = REPEATS
) -> list[dict[str, Any]]:
    """Time an interval of a mean of clips within actors; the floor draws as many random numbers and adds them up."""
    case = Case(clips, actors, resamples)
    labels = case.actors.tolist()
    rng = np.random.default_rng(0)
    peers, missing = collect(
        {"scipy bootstrap, without clusters": _scipy, "plain loop over draws": _plain}, case, console=console
    )
    jobs = {
        "ours": lambda: clustered_mean(case.values, labels, resamples=resamples),
        **peers,
        "floor: drawing and adding": lambda: case.values[rng.integers(clips, size=(resamples, clips))].sum(axis=1),
    }
    return rows(f"Bootstrap, {clips} clips of {actors} actors", interleaved(jobs, repeats=repeats), missing)

"""Where the true performance by a child is known: closer to it than the source is, and constraints hold what they constrain."""

from __future__ import annotations

import numpy as np

from benchmark.api import FitContext, Sample, StyleTask
from benchmark.data.splits import make_split
from benchmark.data.synthetic.dataset import SyntheticDataset
from benchmark.data.views import eval_items, target_skeleton, train_view
from eval.metrics.content import PoseDistance, TrajectoryDeviation
from eval.metrics.foot import FootSkateSpeed
from eval.metrics.truth import TruthPoseDistance
from methods.cyclegan_kc.method import CycleGanKc
from methods.identity import Identity
from methods.nearest import Nearest

_METRICS = {
    "truth": TruthPoseDistance(),
    "content": PoseDistance(),
    "trajectory": TrajectoryDeviation(),
    "skate": FootSkateSpeed(),
}


def test_results_are_closer_to_the_true_child_than_their_sources_and_constraints_hold_what_they_constrain() -> None:
    data = SyntheticDataset(adults=3, children=3, takes=2, actions=["walk", "punch", "jump"], fps_working=30.0)
    train = ["adult001", "adult002", "child001", "child002", "child003"]
    split = make_split(data, "adult", "child", protocol="named", train=train, test=["adult003"])
    task = StyleTask("adult", "child", target_skeleton(data, split, "child"))
    view = train_view(data, split, "adult", "child")
    small = {"filters": 48, "pretrain_epochs": 20, "epochs": 10, "lr": 2e-4}
    methods = {
        "identity": Identity(),
        "nearest": Nearest(),
        "constrained": CycleGanKc(**small),  # type: ignore[arg-type]
        "unconstrained": CycleGanKc(**{**small, **CycleGanKc.presets()["unconstrained"]}),
    }
    found: dict[str, dict[str, float]] = {}
    for name, method in methods.items():
        method.fit(view, task, rng=np.random.default_rng(1), ctx=FitContext())
        rows = []
        for item in eval_items(data, split, "adult", "child"):
            source = data.load(item.record.clip_id)
            result = method.transfer(source, task, rng=np.random.default_rng(2))
            truth = data.truth(item.record.clip_id, "child")
            sample = Sample(result.clip, source, (), truth, task, result.time_map, None, result.copied_from)
            bones = result.diagnostics.get("bone_length_error", 0.0)
            rows.append([*(metric.compute(sample) for metric in _METRICS.values()), bones])
        found[name] = dict(zip((*_METRICS, "bones"), np.mean(rows, axis=0), strict=True))
    ours, free = found["constrained"], found["unconstrained"]
    assert ours["truth"] < 0.9 * found["identity"]["truth"], found
    assert ours["content"] < found["nearest"]["content"], found
    for name in ("bones", "trajectory", "skate"):
        assert ours[name] < 0.9 * free[name], (name, found)

"""Where the true performance by a child is known: closer to it than the source is, and closer to the source than a child."""

from __future__ import annotations

import numpy as np

from benchmark.api import FitContext, Sample, StyleTask
from benchmark.data.splits import make_split
from benchmark.data.synthetic.dataset import SyntheticDataset
from benchmark.data.views import eval_items, target_skeleton, train_view
from eval.metrics.content import PoseDistance
from eval.metrics.foot import FootSkateRatio
from eval.metrics.truth import TruthPoseDistance
from methods.holden.method import Holden
from methods.identity import Identity
from methods.nearest import Nearest

_METRICS = {"truth": TruthPoseDistance(), "content": PoseDistance(), "skate": FootSkateRatio()}


def test_results_are_closer_to_the_true_child_than_their_sources_and_keep_more_content_than_a_real_child() -> None:
    data = SyntheticDataset(adults=3, children=3, takes=2, actions=["walk", "punch", "jump"], fps_working=30.0)
    train = ["adult001", "adult002", "child001", "child002", "child003"]
    split = make_split(data, "adult", "child", protocol="named", train=train, test=["adult003"])
    task = StyleTask("adult", "child", target_skeleton(data, split, "child"))
    view = train_view(data, split, "adult", "child")
    methods = {"identity": Identity(), "nearest": Nearest(), "holden": Holden(filters=64, epochs=20, style_weight=20.0)}
    found: dict[str, dict[str, float]] = {}
    for name, method in methods.items():
        method.fit(view, task, rng=np.random.default_rng(1), ctx=FitContext())
        rows = []
        for item in eval_items(data, split, "adult", "child"):
            source = data.load(item.record.clip_id)
            result = method.transfer(source, task, rng=np.random.default_rng(2))
            truth = data.truth(item.record.clip_id, "child")
            sample = Sample(result.clip, source, (), truth, task, result.time_map, None, result.copied_from)
            rows.append([metric.compute(sample) for metric in _METRICS.values()])
        found[name] = dict(zip(_METRICS, np.mean(rows, axis=0), strict=True))
    assert found["holden"]["truth"] < 0.9 * found["identity"]["truth"], found
    assert found["holden"]["content"] < 0.9 * found["nearest"]["content"], found
    assert found["holden"]["skate"] < 1.1 * found["identity"]["skate"], found

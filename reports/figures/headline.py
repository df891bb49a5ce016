"""Which metrics stand for their group where a figure has room for one of each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

#: For each group, its metrics in order of preference: the first that a run has stands for the group.
HEADLINE: dict[str, tuple[str, ...]] = {
    "recognition": ("recognition/p-target-temporal", "recognition/p-target-kinematic"),
    "style": ("style/d-s", "style/pose-distance"),
    "truth": ("truth/pose-distance",),
    "content": ("content/pose-distance",),
    "timing": ("timing/tempo-error", "timing/tempo-ratio", "timing/duration-ratio"),
    "physics": ("physics/foot-skate-ratio", "physics/jerk-deviation"),
}


def headline_metrics(there: Iterable[str], *, also: Sequence[str] = ()) -> list[str]:
    """One metric of each group that has any, groups in the order of :data:`HEADLINE`, then ``also`` as far as they are there.

    Groups that are not listed, those of a plug-in, are represented by their first metric. Groups of single actions (``jump``)
    are left out: they speak of few clips.
    """
    metrics = list(dict.fromkeys(there))
    groups: dict[str, list[str]] = {}
    for metric in metrics:
        groups.setdefault(metric.partition("/")[0], []).append(metric)
    order = [group for group in HEADLINE if group in groups]
    order += [group for group in groups if group not in HEADLINE and group != "jump"]
    chosen = []
    for group in order:
        wanted = [metric for metric in HEADLINE.get(group, ()) if metric in groups[group]]
        chosen.append(wanted[0] if wanted else groups[group][0])
    return list(dict.fromkeys([*chosen, *(metric for metric in also if metric in metrics)]))

"""Style and content distance of Wang et al. 2021, by Gram matrices of hidden activations."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.errors import ContractError
from eval.metrics.shared import references
from eval.probes.encoder import MotionEncoder


def gram(hidden: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F, F) Gram matrix ``H^T H / T`` of (T, F) activations: the same for a motion and for the motion shown twice."""
    return hidden.T @ hidden / len(hidden)


def gram_distance(one: NDArray[np.float64], two: NDArray[np.float64]) -> float:
    """``|G - G'| / sqrt(|G| |G'|)``, Frobenius norms of the (F, F) Gram matrices of (T, F) and (T', F) activations.

    Without unit, so that quiet and lively motions count alike; 0 where both are 0.
    """
    ours, theirs = gram(one), gram(two)
    size = np.sqrt(np.linalg.norm(ours) * np.linalg.norm(theirs))
    gap = float(np.linalg.norm(ours - theirs))
    return gap / float(size) if size > 0.0 else gap


def style_distance(sample: Sample) -> float:
    """Median over real target clips of the same action of the Gram distance to the result; D_style."""
    encoder = _encoder(sample)
    ours = encoder.hidden(sample.clip)
    return float(np.median([gram_distance(ours, encoder.hidden(clip)) for clip in references(sample)]))


def content_distance(sample: Sample) -> float:
    """Gram distance of the result to its source; D_content."""
    encoder = _encoder(sample)
    return gram_distance(encoder.hidden(sample.clip), encoder.hidden(sample.source))


def style_share(sample: Sample) -> float:
    """D_S of equation 16: ``D_style / (D_style + D_content)``; not applicable where both are 0."""
    style, content = style_distance(sample), content_distance(sample)
    if style + content <= 0.0:
        raise NotApplicableError("result, source and real target motion are the same: neither distance is any")
    return style / (style + content)


def _encoder(sample: Sample) -> MotionEncoder:
    probe = sample.probes["motion-encoder"]
    if not isinstance(probe, MotionEncoder):
        raise ContractError(f"the probe 'motion-encoder' is a {type(probe).__name__}, not a MotionEncoder")
    return probe


def _info(
    name: str, summary: str, direction: Literal["lower", "none"], needs: Literal["none", "reference"]
) -> MetricInfo:
    return MetricInfo(
        name=name,
        summary=summary,
        unit="1",
        direction=direction,
        needs=needs,
        probe="motion-encoder",
        citation="Wang et al. 2021, equations 16 and 17; Gatys et al. 2016 (Gram matrices)",
        code_deps=(
            "benchmark.motion.canonical",
            "benchmark.motion.pose",
            "benchmark.motion.resample",
            "eval.features",
            "eval.metrics.shared",
            "eval.probes.encoder",
            "eval.probes.projection",
        ),
    )


class StyleGramDistance(Metric):
    """D_style: Gram distance in the encoder's hidden space to real target motion of the same action, median.

    The 2021 paper leaves D_style undefined; this is the distance its style loss (equation 6) is built on, divided by time so
    that clips of different length compare, of activations of the frozen ``motion-encoder``. See :func:`gram_distance`.
    """

    info = _info(
        "style/gram-distance", "Gram distance of hidden activations to real target motion", "lower", "reference"
    )

    def compute(self, sample: Sample) -> float:
        """The distance."""
        return style_distance(sample)


class ContentGramDistance(Metric):
    """D_content: Gram distance in the encoder's hidden space to the source.

    It does not see the order of events, and it sees style as it sees content: it is part of the 2021 paper's measure, not a
    measure of content by itself. Like the other distances to the source it is a cost to weigh against style.
    """

    info = _info("content/gram-distance", "Gram distance of hidden activations to the source", "lower", "none")

    def compute(self, sample: Sample) -> float:
        """The distance."""
        return content_distance(sample)


class StyleSimilarity(Metric):
    """D_S of the 2021 paper, equation 16: ``D_style / (D_style + D_content)``.

    Called a similarity there, but a share of distances: lower is closer to the target style than to the source. Below 0.5 the
    result has left the source for the style. The source itself is at 1.
    """

    info = _info("style/d-s", "share of style in the distances to style and content", "lower", "reference")

    def compute(self, sample: Sample) -> float:
        """The share, in [0, 1]."""
        return style_share(sample)


class ContentSimilarity(Metric):
    """D_C of the 2021 paper, equation 17: ``D_content / (D_style + D_content) = 1 - D_S``.

    It holds nothing that D_S does not; the two distances apart do. Given to be set beside the paper's figures.
    """

    info = _info("content/d-c", "share of content in the distances to style and content", "none", "reference")

    def compute(self, sample: Sample) -> float:
        """The share, in [0, 1]."""
        return 1.0 - style_share(sample)

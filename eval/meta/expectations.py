"""What each metric must see and must not see, as claims that the check puts to the test.

One row for each metric and one sign for each corruption:

``+``
    must see it: its value gets worse with every grade (moves one way, for metrics that only describe);
``s``
    must see the gross fault: worse beyond doubt at the last grade. For metrics with a threshold, below which they see nothing;
``.``
    may see it: nothing is claimed;
``0``
    must not see it: no change by a fifth of the spread between clips or more is beyond doubt at the last grade;
``-``
    is known to be fooled: its value gets *better*, for a reason that the metric's description gives. Listed so that nobody
    reads such a metric alone.

The rows of ``distribution/`` were written down before the check was run on them as they are now. Of the others several were
corrected after a first look, where the claim had misunderstood what the metric measures; so agreement with them says that
metrics behave as described, not that they were foreseen to.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase

from benchmark.errors import ContractError
from eval.meta.ordering import Ordering

#: An effect below this, in standard deviations between clips, is no reaction.
UNMOVED = 0.2

#: Heads of the columns of :data:`TABLE`.
COLUMNS = {
    "noi": "noise",
    "bur": "jitter-bursts",
    "smo": "over-smoothing",
    "fro": "frozen-pose",
    "arm": "arm-lag",
    "une": "uneven-timing",
    "slo": "time-stretch",
    "sli": "foot-slide",
    "hea": "heading-drift",
    "flo": "floating",
    "sun": "sunken",
    "bon": "bone-stretch",
    "hal": "half-style",
    "non": "no-style",
    "wro": "wrong-action",
    "one": "one-for-all",
}

TABLE = """
metric                                 noi bur smo fro arm une slo sli hea flo sun bon hal non wro one
truth/pose-distance                     +   +   +   +   +   .   .   0   .   +   +   +   +   +   +   +
content/pose-distance                   .   .   .   +   .   .   0   0   0   0   0   0   -   -   +   +
content/phase-pose-distance             .   .   .   +   .   +   0   0   0   0   0   0   -   -   +   +
content/position-distance               .   .   .   +   .   .   .   0   .   .   .   .   -   -   +   +
content/trajectory-deviation            .   .   .   +   0   .   .   +   0   0   0   0   .   .   +   +
content/heading-deviation               .   .   .   .   .   .   .   0   +   0   0   0   .   .   +   +
content/round-trip-error                +   +   +   +   +   .   .   0   0   0   0   0   .   .   .   .
content/gram-distance                   .   .   .   +   .   .   .   .   .   0   0   .   -   -   +   +
content/d-c                             .   .   .   .   .   .   .   .   .   0   0   .   +   +   .   .
timing/tempo-ratio                      .   .   .   .   .   .   +   0   .   0   0   .   .   .   .   .
timing/tempo-error                      .   .   .   .   .   .   +   0   .   0   0   .   .   .   .   .
timing/duration-ratio                   0   0   0   0   0   0   +   0   0   0   0   0   .   .   .   .
timing/warp-deviation                   .   .   .   .   .   .   .   0   .   .   .   .   .   .   .   .
style/speed-difference                  .   .   +   +   .   .   +   .   .   0   0   .   +   .   +   .
style/range-of-motion-difference        .   .   +   .   .   0   0   0   .   0   0   0   +   .   +   .
style/speed-ratio                       .   .   +   +   .   .   +   .   .   0   0   .   .   .   .   .
style/range-of-motion-ratio             .   .   +   +   .   0   0   0   .   0   0   0   .   .   .   .
style/pose-distance                     .   .   .   +   .   .   .   0   .   .   .   .   +   +   +   .
style/power-spectrum-distance           +   +   +   +   .   .   +   0   .   0   0   .   .   .   +   .
style/gram-distance                     .   .   .   +   .   .   .   .   .   0   0   .   +   +   +   .
style/d-s                               .   .   .   .   .   .   .   .   .   0   0   .   +   +   .   .
recognition/p-target-temporal           .   .   .   .   .   .   .   .   .   0   0   0   +   +   .   .
recognition/p-target-kinematic          .   .   .   .   .   .   .   .   .   0   0   0   +   +   .   .
recognition/style-accuracy-*            .   .   .   .   .   .   .   .   .   0   0   0   s   s   .   .
recognition/action-accuracy-*           .   .   .   .   .   .   .   .   .   0   0   0   0   .   +   s
distribution/frechet-kinematic          .   .   s   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/frechet-learned            .   .   s   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/frechet-limit-kinematic    .   .   s   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/frechet-limit-learned      .   .   s   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/kid-kinematic              .   .   .   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/kid-learned                .   .   .   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/mmd-kinematic              .   .   .   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/mmd-learned                .   .   .   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/mmd-p-*                    .   .   .   .   .   .   .   .   .   0   0   .   .   .   .   .
distribution/precision-*                .   .   .   .   .   .   .   .   .   0   0   .   .   s   .   .
distribution/density-*                  .   .   .   .   .   .   .   .   .   0   0   .   .   s   .   .
distribution/recall-*                   .   .   .   s   .   .   .   .   .   0   0   .   .   .   .   s
distribution/coverage-*                 .   .   .   s   .   .   .   .   .   0   0   .   .   s   .   s
distribution/diversity-ratio-*          .   .   .   s   .   .   .   .   .   0   0   .   .   .   .   s
physics/foot-skate-ratio                .   .   .   .   0   .   .   s   .   .   0   0   .   .   .   .
physics/foot-skate-speed                .   .   .   .   0   .   .   +   .   .   0   0   .   .   .   .
physics/foot-skate-common               .   .   .   .   0   .   .   s   .   -   .   0   .   .   .   .
physics/foot-sliding-factor             +   .   .   .   0   .   .   +   .   0   0   0   .   .   .   .
physics/floor-penetration               +   .   .   .   0   .   0   0   0   -   +   0   .   .   .   .
physics/floating                        .   .   .   .   0   .   .   .   0   +   .   0   .   .   .   .
physics/bone-length-error               0   0   0   0   0   0   0   0   0   0   0   +   0   0   0   0
physics/jerk-ratio                      +   +   +   +   .   .   +   0   .   0   0   .   .   .   .   .
physics/jerk-deviation                  +   +   +   +   .   .   +   0   .   0   0   .   .   .   .   .
physics/log-dimensionless-jerk          +   +   .   .   .   .   .   .   .   0   0   .   .   .   .   .
physics/spectral-arc-length             +   +   .   .   .   .   .   .   .   0   0   .   .   .   .   .
physics/largest-turn-ratio              .   +   .   .   .   .   .   0   .   0   0   0   .   .   .   .
physics/joint-limit-violation           .   s   .   .   .   .   .   0   0   0   0   .   .   .   .   .
physics/pose-jump                       .   +   .   .   .   .   .   0   0   0   0   .   .   .   .   .
jump/landing-knee-angle                 .   .   .   .   0   .   .   0   .   .   .   0   s   .   .   .
jump/arm-swing                          .   .   .   .   .   .   .   0   .   .   .   .   .   .   .   .
jump/landing-duration                   .   .   .   .   0   .   .   0   .   .   .   0   s   .   .   .
jump/recovery-duration                  .   .   .   .   0   .   .   0   .   .   .   0   +   .   .   .
"""


@dataclass(frozen=True)
class Expectation:
    """One cell of the table."""

    sign: str

    @property
    def word(self) -> str:
        """In words, for tables and messages."""
        return _WORDS[self.sign]

    @property
    def asks(self) -> bool:
        """Whether the fault must be seen."""
        return self.sign in "+s"


_WORDS = {
    "+": "worse with every grade",
    "s": "worse at the last grade",
    ".": "anything",
    "0": "no change",
    "-": "better (known to be fooled)",
}


def _read(text: str) -> dict[str, dict[str, Expectation]]:
    lines = [line.split() for line in text.strip().splitlines()]
    heads = lines[0][1:]
    rows: dict[str, dict[str, Expectation]] = {}
    for name, *signs in lines[1:]:
        if len(signs) != len(heads) or set(signs) - set(_WORDS) or name in rows:
            raise ContractError(
                f"the expectations of {name!r} must be one row of {len(heads)} signs of {' '.join(_WORDS)}"
            )
        rows[name] = {COLUMNS[head]: Expectation(sign) for head, sign in zip(heads, signs, strict=True)}
    return rows


DECLARED = _read(TABLE)


def expected(metric: str, corruption: str) -> Expectation:
    """What is declared of ``metric`` (its name, or else a pattern that it matches); ``.`` where nothing is."""
    row = DECLARED.get(metric) or next((DECLARED[name] for name in DECLARED if fnmatchcase(metric, name)), {})
    return row.get(corruption, Expectation("."))


def verdict(expectation: Expectation, ordering: Ordering) -> bool | None:
    """Whether it came as declared; ``None`` where nothing is declared or the metric has no value."""
    if expectation.sign == "." or ordering.observed == "no value":
        return None
    if expectation.sign == "+":
        return ordering.observed == "ordered"
    if expectation.sign == "s":
        return ordering.observed in ("ordered", "seen")
    if expectation.sign == "-":
        return ordering.observed == "fooled"
    return ordering.observed == "blind" or abs(ordering.effect) < UNMOVED

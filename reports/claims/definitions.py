"""Every empirical claim of the papers in our words, and how it is tested."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

POSTER = "Dong, Aloba, Anthony & Jain 2018"
SCALING = "Dong, Paryani, Rana, Aloba, Anthony & Jain 2017"
ADULT2CHILD = "Dong, Aristidou, Shamir, Mahler & Jain 2020"
KINEMATIC = "Wang et al. 2021"

#: Rows by what they stand for.
ADULT, REAL = "identity", "child-reference"

Sign = Literal["lower", "higher"]


@dataclass(frozen=True)
class Contrast:
    """On the same clips, ``left`` has a lower (higher) value of ``metric`` than ``right``.

    Attributes
    ----------
    metric, left, right, sign
        The statement.
    variant
        ``raw`` or ``cleaned``.
    margin
        Larger than 0 for a statement of "no worse": the difference must be above ``-margin`` in the stated direction.
    """

    metric: str
    left: str
    right: str
    sign: Sign
    variant: str = "raw"
    margin: float = 0.0

    @property
    def methods(self) -> tuple[str, ...]:
        """The rows it needs."""
        return self.left, self.right

    @property
    def words(self) -> str:
        """The test in a line."""
        if self.margin:
            return f"{self.metric}: {self.left} no more than {self.margin:g} worse than {self.right} ({self.sign} is better)"
        return f"{self.metric}: {self.left} {self.sign} than {self.right}"


@dataclass(frozen=True)
class Level:
    """The mean of ``metric`` over a method's clips is below (above) ``value``."""

    metric: str
    method: str
    value: float
    sign: Sign
    variant: str = "raw"

    @property
    def methods(self) -> tuple[str, ...]:
        """The rows it needs."""
        return (self.method,)

    @property
    def words(self) -> str:
        """The test in a line."""
        return f"{self.metric} of {self.method} {'below' if self.sign == 'lower' else 'above'} {self.value:g}"


@dataclass(frozen=True)
class Between:
    """``metric`` of a method lower (higher) than another metric of the same clips, both in the same unit."""

    metric: str
    other: str
    method: str
    sign: Sign
    variant: str = "raw"

    @property
    def methods(self) -> tuple[str, ...]:
        """The rows it needs."""
        return (self.method,)

    @property
    def words(self) -> str:
        """The test in a line."""
        return f"{self.method}: {self.metric} {self.sign} than {self.other}"


@dataclass(frozen=True)
class Rated:
    """Raters' answers: ``left`` has more (fewer) of ``measure`` than ``right``, paired within raters.

    ``measure`` is ``child`` (share of "a child" answers) or ``naturalness`` (1 to 7); ``margin`` as in :class:`Contrast`.
    """

    measure: Literal["child", "naturalness"]
    left: str
    right: str
    sign: Sign
    margin: float = 0.0

    @property
    def methods(self) -> tuple[str, ...]:
        """The rows it needs."""
        return self.left, self.right

    @property
    def words(self) -> str:
        """The test in a line."""
        what = {"child": "share of child answers", "naturalness": "naturalness"}[self.measure]
        if self.margin:
            return f"ratings, {what}: {self.left} no more than {self.margin:g} worse than {self.right}"
        return f"ratings, {what}: {self.left} {self.sign} than {self.right}"


@dataclass(frozen=True)
class Nearer:
    """The result's ``measure`` of a jump is nearer to the performers trained on than the source's; see :mod:`reports.jumps`."""

    measure: str
    method: str

    @property
    def methods(self) -> tuple[str, ...]:
        """The rows it needs."""
        return (self.method,)

    @property
    def words(self) -> str:
        """The test in a line."""
        return f"{self.measure.replace('_', ' ')} of {self.method} nearer to the child trained on than the adult's"


Test = Contrast | Level | Between | Rated | Nearer


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes
    ----------
    name
        Short name, unique.
    paper, where
        Source, and the section, figure or table in it.
    statement
        In our words.
    tests
        All must hold.
    alpha
        Two-sided level, after Holm's correction over all tests of a table.
    note
        What the test cannot see, or how it departs from what the paper did.
    every_task
        Whether it is about every style: tested on all tasks of all runs that have what it needs, not on the first.
    """

    name: str
    paper: str
    where: str
    statement: str
    tests: tuple[Test, ...]
    alpha: float = 0.05
    note: str = ""
    every_task: bool = False


@dataclass(frozen=True)
class Untestable:
    """A claim that nothing here can test, with the reason."""

    name: str
    paper: str
    where: str
    statement: str
    reason: str


_KC, _FREE, _GAN = "cyclegan-kc", "cyclegan-kc[unconstrained]", "cyclegan"

CLAIMS: tuple[Claim | Untestable, ...] = (
    Claim(
        "scaling-raises-child-responses",
        SCALING,
        "as told in the 2020 paper, section 2",
        "Dynamic scaling of adult motion gets more child answers than the adult motion, and fewer than a real child's",
        (Rated("child", "dynamic-scaling", ADULT, "higher"), Rated("child", "dynamic-scaling", REAL, "lower")),
    ),
    Claim(
        "jump-bends-lower",
        POSTER,
        "section 3, figure 1",
        "In a jump the translated adult bends the knees lower in landing, as the child does",
        (Nearer("landing_knee_angle", "hsu"),),
        note="the recordings differ by 0.4 degrees only: see experiments/README.md",
    ),
    Claim(
        "jump-longer-landing",
        POSTER,
        "section 3, figure 1",
        "In a jump the translated adult takes longer to land, as the child does",
        (Nearer("landing_duration", "hsu"),),
        note="the recordings differ by an eighth of a frame: see experiments/README.md",
    ),
    Claim(
        "jump-arm-swing",
        POSTER,
        "section 3, figure 2",
        "In a jump the translated adult swings the arms farther, as the child does",
        (Nearer("arm_swing", "hsu"),),
    ),
    Claim(
        "joint-wise-beats-overall",
        ADULT2CHILD,
        "section 5.1",
        "Kernels of each joint's own give natural and childlike motion; kernels over all joints do not",
        (
            Contrast("recognition/p-target-kinematic", _GAN, "cyclegan[convolution=overall]", "higher"),
            Contrast("physics/jerk-deviation", _GAN, "cyclegan[convolution=overall]", "lower"),
        ),
    ),
    Claim(
        "faster-and-wider",
        ADULT2CHILD,
        "section 5.2, figures 5 and 6",
        "Output moves faster and swings more than the adult, as children do",
        (
            Contrast("style/speed-ratio", _GAN, ADULT, "higher"),
            Contrast("style/range-of-motion-ratio", _GAN, ADULT, "higher"),
        ),
    ),
    Claim(
        "coherence-reduces-jerk",
        ADULT2CHILD,
        "section 5.3, figure 7",
        "Without the coherence loss joints are jittery; with it motion is smooth",
        (Contrast("physics/jerk-ratio", _GAN, "cyclegan[coherence=0]", "lower"),),
        note="what the network changes is low-passed at 7 Hz, which hides part of the jitter",
    ),
    Claim(
        "transition-leaves-artefacts",
        ADULT2CHILD,
        "section 5.3",
        "The transition loss makes motion jerky and unstable, and was left out",
        (Contrast("physics/jerk-ratio", "cyclegan[transition=5]", _GAN, "higher"),),
    ),
    Claim(
        "timing-changes-within-a-clip",
        ADULT2CHILD,
        "sections 1 and 5.4",
        "The network changes timing inside a clip, which frame-by-frame style transfer cannot",
        (
            Contrast("timing/warp-deviation", _GAN, ADULT, "higher"),
            Contrast("timing/warp-deviation", _GAN, "holden", "higher"),
        ),
    ),
    Claim(
        "called-child-more-often",
        ADULT2CHILD,
        "section 5.4, figure 8",
        "The CycleGAN's output is called a child's more often than the adult's motion (p < 0.001)",
        (Rated("child", _GAN, ADULT, "higher"),),
        alpha=0.001,
    ),
    Claim(
        "as-natural-as-the-autoencoder",
        ADULT2CHILD,
        "section 5.4, figure 8",
        "The CycleGAN's output is at least as natural as the autoencoder's",
        (Rated("naturalness", _GAN, "holden", "higher", margin=0.5),),
        note="half a point of seven is taken as no difference; the paper says higher",
    ),
    Untestable(
        "as-childlike-as-aberman",
        ADULT2CHILD,
        "section 5.4, figure 8",
        "The output is as childlike and as natural as that of Aberman et al. 2020",
        "the method of Aberman et al. is not part of the suite",
    ),
    Claim(
        "double-translation-aligned",
        ADULT2CHILD,
        "section 5.5",
        "Translated to a child and back, motion has the input's timing and poses",
        (Between("content/round-trip-error", "content/pose-distance", _GAN, "lower"),),
        note="aligned: nearer to the input than the one-way output is",
    ),
    Claim(
        "double-translation-jittery",
        ADULT2CHILD,
        "section 5.5",
        "Translated to a child and back, motion is a bit jittery",
        (Level("content/round-trip-jerk-ratio", _GAN, 1.0, "higher"),),
    ),
    Claim(
        "constraints-reduce-jitter",
        KINEMATIC,
        "sections 1 and 4.5",
        "Kinematic constraints reduce jitter",
        (Contrast("physics/jerk-ratio", _KC, _FREE, "lower"),),
        every_task=True,
    ),
    Claim(
        "constraints-reduce-foot-slide",
        KINEMATIC,
        "sections 1 and 4.5",
        "Kinematic constraints reduce foot sliding",
        (Contrast("physics/foot-skate-ratio", _KC, _FREE, "lower"),),
        note="the constraints of equation 13 have no term for feet",
        every_task=True,
    ),
    Claim(
        "constraints-reduce-penetration",
        KINEMATIC,
        "section 4.5, table 3",
        "Kinematic constraints keep feet from sinking into the floor",
        (Contrast("physics/floor-penetration", _KC, _FREE, "lower"),),
        every_task=True,
    ),
    Claim(
        "constraints-reduce-lag",
        KINEMATIC,
        "section 4.4, table 2",
        "Constrained output does not lag behind the content",
        (Contrast("timing/warp-deviation", _KC, _FREE, "lower"),),
        every_task=True,
    ),
    Claim(
        "constraints-keep-the-trajectory",
        KINEMATIC,
        "section 4.5, table 4",
        "Constrained output follows the content's path over the floor more closely",
        (Contrast("content/trajectory-deviation", _KC, _FREE, "lower"),),
        every_task=True,
    ),
    Claim(
        "content-kept",
        KINEMATIC,
        "section 4.5, tables 2 and 3",
        "Constrained output keeps the content's poses better",
        (Contrast("content/pose-distance", _KC, _FREE, "lower"),),
        every_task=True,
    ),
    Claim(
        "nearer-to-style-than-to-content",
        KINEMATIC,
        "section 4.6, figure 10",
        "Output is nearer to the style than to the content: D_S < D_C",
        (Level("style/d-s", _KC, 0.5, "lower"),),
        note="D_S + D_C = 1, so D_S < D_C is D_S < 1/2",
        every_task=True,
    ),
    Claim(
        "less-content-than-the-autoencoder",
        KINEMATIC,
        "section 4.6, figure 11",
        "By D_S, output is nearer to the style than the autoencoder's",
        (Contrast("style/d-s", _KC, "holden", "lower"),),
        note="of the five methods of figure 11 the suite has these two; equation and features of the others are not public",
        every_task=True,
    ),
)

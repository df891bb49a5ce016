"""What a study can find before anybody is asked, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

#: Assumed where no ratings are there yet: correlation between conditions and Greenhouse-Geisser epsilon.
CORRELATION, EPSILON = 0.5, 0.7

#: Cohen's medium main effect, and the power that is aimed at.
MEDIUM, POWER = 0.25, 0.8


def what_can_be_found(*, raters: int, conditions: int, clips: int) -> Sequence[str]:
    """Power of the planned tests for so many attentive raters, and what it does not say."""
    from eval.stats import power_rm, raters_needed, smallest_dz

    if raters < 3:
        return (f"{raters} raters are too few for any test: three or more are needed.",)
    pairs = conditions * (conditions - 1) // 2
    epsilon = max(EPSILON, 1.0 / (conditions - 1))
    power = power_rm(n=raters, k=conditions, f=MEDIUM, rho=CORRELATION, eps=epsilon)
    needed = raters_needed(k=conditions, f=MEDIUM, rho=CORRELATION, eps=epsilon, power=POWER)
    alone = smallest_dz(n=raters, power=POWER)
    every = smallest_dz(n=raters, alpha=0.05 / pairs, power=POWER)
    return (
        f"{raters} attentive raters find a medium main effect of the condition (f = {MEDIUM:g}; correlation {CORRELATION:g}, "
        f"epsilon {epsilon:.2g} assumed) with probability {power:.2f}; {needed} would do for {POWER:g}.",
        f"With power {POWER:g} they find a paired difference of d_z {alone:.2f} in one contrast, and of {every:.2f} in any of "
        f"the {pairs} pairs of {conditions} conditions.",
        f"That is for these {clips} clips. Whether a difference carries over to other clips depends on their number as much as "
        "on that of raters; `study simulate` rehearses it.",
    )

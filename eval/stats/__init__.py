"""Statistics: data frames and arrays in, data frames and numbers out. Nothing here knows what a motion is.

Importing this package loads numpy only; pandas, scipy.stats and statsmodels are loaded by the functions that need them.
Every wrong input is a ``ValueError`` that says what to do.
"""

from __future__ import annotations

from eval.stats.anova import oneway_anova, rm_anova
from eval.stats.assumptions import check_groups, check_rm
from eval.stats.binary import gee_logit
from eval.stats.bootstrap import Interval, clustered_mean
from eval.stats.comparison import Comparison, compare, sign_flip_p
from eval.stats.correction import holm, holm_within, shaffer
from eval.stats.effects import Effect, cousineau_morey, d_av, dz, eta_p2_interval
from eval.stats.equivalence import tost_paired, tost_pigeonhole, tost_proportions
from eval.stats.mixed import mixed_model
from eval.stats.pigeonhole import pigeonhole_bootstrap, pigeonhole_means
from eval.stats.posthoc import holm_paired, tukey_hsd_between, tukey_hsd_within
from eval.stats.power import power_paired, power_rm, power_table, raters_needed, smallest_dz
from eval.stats.ranks import critical_difference, friedman, friedman_nemenyi, mean_ranks, rank_groups, wilcoxon_holm
from eval.stats.sphericity import Sphericity, mauchly

__all__ = [
    "Comparison",
    "Effect",
    "Interval",
    "Sphericity",
    "check_groups",
    "check_rm",
    "clustered_mean",
    "compare",
    "cousineau_morey",
    "critical_difference",
    "d_av",
    "dz",
    "eta_p2_interval",
    "friedman",
    "friedman_nemenyi",
    "gee_logit",
    "holm",
    "holm_paired",
    "holm_within",
    "mauchly",
    "mean_ranks",
    "mixed_model",
    "oneway_anova",
    "pigeonhole_bootstrap",
    "pigeonhole_means",
    "power_paired",
    "power_rm",
    "power_table",
    "rank_groups",
    "raters_needed",
    "rm_anova",
    "shaffer",
    "sign_flip_p",
    "smallest_dz",
    "tost_paired",
    "tost_pigeonhole",
    "tost_proportions",
    "tukey_hsd_between",
    "tukey_hsd_within",
    "wilcoxon_holm",
]

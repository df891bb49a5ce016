"""Tables, figures and the page that show a finished run. They read what the run stored and recompute nothing."""

from __future__ import annotations

#: Figure name -> where it is made and what it shows.
BUILTIN_FIGURES: dict[str, str] = {
    "metric-dots": "reports.figures.dots:metric_dots",
    "pose-strips": "reports.figures.strips:pose_strips",
    "jump-landing": "reports.figures.jump:jump_landing",
}

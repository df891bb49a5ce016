"""Tables, figures and the page that show a finished run. They read what the run stored and recompute nothing."""

from __future__ import annotations

#: Figure name -> where it is made and what it shows.
BUILTIN_FIGURES: dict[str, str] = {
    "metric-dots": "reports.figures.dots:metric_dots",
    "pose-strips": "reports.figures.strips:pose_strips",
    "comparison-strips": "reports.figures.contents:comparison_strips",
    "trajectories": "reports.figures.trajectories:trajectories",
    "loss-curves": "reports.figures.losses:loss_curves",
    "style-content": "reports.figures.plane:style_content",
    "style-similarity": "reports.figures.similarity:style_similarity",
    "cost-quality": "reports.figures.pareto:cost_quality",
    "tempo": "reports.figures.tempo:tempo",
    "joint-change": "reports.figures.joints:joint_change",
    "jump-overlay": "reports.figures.jump_overlay:jump_overlay",
    "jump-landing": "reports.figures.jump:jump_landing",
    "critical-difference": "reports.figures.critical_difference:critical_difference",
    "ratings": "reports.figures.rating_boxes:ratings",
    "ablation-forest": "reports.figures.ablations:ablation_forest",
}

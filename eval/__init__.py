"""Metrics, probes, statistics and ratings; metrics and probes are named as lazy ``"module:Class"`` strings."""

from __future__ import annotations

BUILTIN_METRICS: dict[str, str] = {
    "physics/foot-skate-ratio": "eval.metrics.foot:FootSkateRatio",
    "physics/foot-skate-speed": "eval.metrics.foot:FootSkateSpeed",
    "physics/foot-sliding-factor": "eval.metrics.foot:FootSlidingFactor",
    "physics/floor-penetration": "eval.metrics.foot:FloorPenetration",
    "physics/jerk-ratio": "eval.metrics.smoothness:JerkRatio",
    "physics/bone-length-error": "eval.metrics.body:BoneLengthError",
    "content/pose-distance": "eval.metrics.content:PoseDistance",
    "content/trajectory-deviation": "eval.metrics.content:TrajectoryDeviation",
    "timing/tempo-ratio": "eval.metrics.timing:TempoRatio",
    "timing/duration-ratio": "eval.metrics.timing:DurationRatio",
    "style/speed-difference": "eval.metrics.style:SpeedDifference",
    "style/range-of-motion-difference": "eval.metrics.style:RangeOfMotionDifference",
    "style/speed-ratio": "eval.metrics.style:SpeedRatio",
    "style/range-of-motion-ratio": "eval.metrics.style:RangeOfMotionRatio",
    "style/pose-distance": "eval.metrics.style:ReferenceDistance",
    "jump/landing-knee-angle": "eval.metrics.jump:LandingKneeAngle",
    "jump/arm-swing": "eval.metrics.jump:ArmSwing",
    "jump/landing-duration": "eval.metrics.jump:LandingDuration",
    "jump/recovery-duration": "eval.metrics.jump:RecoveryDuration",
    "truth/pose-distance": "eval.metrics.truth:TruthPoseDistance",
}

BUILTIN_PROBES: dict[str, str] = {}

"""Metrics: each a small class with a formula, a unit and a direction; see :class:`benchmark.api.Metric`."""

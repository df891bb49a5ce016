"""Ratings of motion by people, or by simulated observers clearly named so: reading, exclusion, simulation, analysis."""

from __future__ import annotations

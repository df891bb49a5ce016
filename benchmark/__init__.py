"""Motion style benchmark: contracts, motion core, data sets, runner and command line."""

from __future__ import annotations

__version__ = "0.1.0"

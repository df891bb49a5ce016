"""A run on the fakes as a program of its own, to be killed: ``driver.py OUT [SETTINGS]``, settings as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

if __name__ == "__main__":
    from benchmark.config import load_config
    from benchmark.registry import Registry
    from benchmark.runner.progress import Quiet
    from benchmark.runner.run import prepare, run

    methods = Registry("method", "test.none", "fakebench:METHODS")
    metrics = Registry("metric", "test.none", "fakebench:GOOD_METRICS")
    flags = {
        "methods": ["copy[pause=0.1]", "noisy[pause=0.1]", "raises", "paired[pause=0.1]"],
        "repetitions": 2,
        "jobs": 2,
        "out": Path(sys.argv[1]),
        "dataset": {"name": "fake"},
        **(json.loads(sys.argv[2]) if len(sys.argv) > 2 else {}),
    }
    prepared = prepare(load_config(flags=flags), methods=methods, metrics=metrics, opener="fakebench:open_fake")
    print("planned", flush=True)
    outcome = run(prepared, Quiet(), methods=methods, metrics=metrics)
    print("done", outcome.executed, flush=True)

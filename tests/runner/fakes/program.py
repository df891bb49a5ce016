"""A run on the fakes as a program of its own: ``program.py OUT SETTINGS``; prints how every cell ended, as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

if __name__ == "__main__":
    from benchmark.config import load_config
    from benchmark.registry import Registry
    from benchmark.runner.progress import Quiet
    from benchmark.runner.run import prepare, run

    methods = Registry("method", "test.none", "hostile:METHODS")
    metrics = Registry("metric", "test.none", "fakebench:GOOD_METRICS")
    flags = {"out": Path(sys.argv[1]), "dataset": {"name": "fake"}, **json.loads(sys.argv[2])}
    prepared = prepare(load_config(flags=flags), methods=methods, metrics=metrics, opener="fakebench:open_fake")
    print("planned", flush=True)
    outcome = run(prepared, Quiet(), methods=methods, metrics=metrics)
    ended = {cell.method: outcome.states[cell.key] for cell in outcome.cells}
    print(json.dumps({name: [status.state, status.reason] for name, status in ended.items()}), flush=True)

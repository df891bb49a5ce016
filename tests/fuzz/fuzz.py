"""Coverage-guided fuzzing of every reader: ``make fuzz``, or ``python tests/fuzz/fuzz.py --seconds 600 [TARGET
...]``.

Each target gets its share of the time in a process of its own, with at most 1 GB of memory and 10 s for one input. It
starts from the committed corpus and from whole files. Inputs that reach new code are kept in a working folder;
``--minimise`` writes the smallest set that reaches as much back into the corpus. What was found (a crash, a hang, too
much memory) is kept as a file and named at the end.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
CORPUS = HERE / "corpus"
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

#: Bytes above which an input is not kept in the repository, and inputs kept for each target.
LARGEST, MOST = 4096, 40

#: Longest input in bytes, seconds and megabytes for one input.
MAX_LEN, TIMEOUT, MEMORY = 8192, 10, 1024


def fuzz_one(name: str, arguments: list[str]) -> None:
    """The body of one target's process; libFuzzer ends it."""
    import atheris

    with atheris.instrument_imports(include=["benchmark", "eval", "methods._torch.weights", "tomllib"]):
        import targets

        target = targets.TARGETS[name]
        folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
        for seed in target.seeds():
            targets.run(target, seed, folder)  # imports what the reader needs, instrumented
    import logging

    logging.disable(logging.CRITICAL)

    def one(data: bytes) -> None:
        targets.run(target, data, folder)

    # libFuzzer starts itself anew when it merges, by the name it is given here.
    atheris.Setup([os.environ.get("FUZZ_SELF", sys.argv[0]), *arguments], one)
    try:
        atheris.Fuzz()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def start(name: str, arguments: list[str], log: Path) -> int:
    """Run one target's process to its end; its exit code."""
    import shlex

    myself = log.with_name(f"{name}.sh")
    line = [sys.executable, str(Path(__file__).resolve()), "--one", name, "--"]
    myself.write_text(f'#!/bin/sh\nexec {shlex.join(line)} "$@"\n')
    myself.chmod(0o755)
    with log.open("ab") as file:
        command = [*line, *arguments]
        environment = {**os.environ, "FUZZ_SELF": str(myself)}
        return subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=False, env=environment).returncode


def fuzz(names: list[str], seconds: int, work: Path) -> int:
    """Fuzz the targets one after another; how many had a finding."""
    import targets

    share = max(1, seconds // len(names))
    findings = 0
    for name in names:
        folder, log = work / name, work / f"{name}.log"
        folder.mkdir(parents=True, exist_ok=True)
        for index, seed in enumerate(targets.TARGETS[name].seeds()):
            (folder / f"seed-{index}").write_bytes(seed)
        found = work / "findings" / f"{name}-"
        found.parent.mkdir(exist_ok=True)
        before = set(found.parent.iterdir())
        log.unlink(missing_ok=True)
        (CORPUS / name).mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        code = start(
            name,
            [
                *(f"-max_total_time={share}", f"-max_len={MAX_LEN}", f"-timeout={TIMEOUT}", f"-rss_limit_mb={MEMORY}"),
                *(f"-artifact_prefix={found}", "-print_final_stats=1", "-reload=0", str(folder), str(CORPUS / name)),
            ],
            log,
        )
        text = log.read_text(errors="replace")
        executed = re.findall(r"stat::number_of_executed_units:\s+(\d+)", text) or re.findall(r"^#(\d+)", text, re.M)
        covered = re.findall(r"cov: (\d+) ft: (\d+)", text)
        peak = re.findall(r"stat::peak_rss_mb:\s+(\d+)", text)
        new = sorted(set(found.parent.iterdir()) - before)
        findings += bool(new) or code != 0
        print(
            f"{name:18} {time.monotonic() - began:5.0f} s  {int(executed[-1]) if executed else 0:9,} executions  "
            f"coverage {covered[-1][0] if covered else '?'} edges, {covered[-1][1] if covered else '?'} features  "
            f"peak {peak[-1] if peak else '?'} MB  "
            + (f"FOUND {new[0]} (log: {log})" if new else "" if code == 0 else f"ENDED {code}: {log}"),
            flush=True,
        )
    return findings


def minimise(names: list[str], work: Path) -> None:
    """Replace the corpus by the smallest inputs that reach what the working folder reaches."""
    for name in names:
        if not (work / name).is_dir():
            continue
        small = work / f"{name}-small"
        shutil.rmtree(small, ignore_errors=True)
        small.mkdir()
        start(
            name,
            ["-merge=1", f"-max_len={LARGEST}", str(small), str(CORPUS / name), str(work / name)],
            work / f"{name}-merge.log",
        )
        kept = sorted(small.iterdir(), key=lambda path: path.stat().st_size)[:MOST]
        shutil.rmtree(CORPUS / name, ignore_errors=True)
        (CORPUS / name).mkdir(parents=True)
        for path in kept:
            shutil.copyfile(path, CORPUS / name / path.name[:16])
        print(f"{name}: {len(kept)} inputs, {sum(path.stat().st_size for path in kept)} bytes")


def main() -> int:
    """Parse the command line and do it."""
    if sys.argv[1:2] == ["--one"]:
        fuzz_one(sys.argv[2], sys.argv[4:])
        return 0
    import targets

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(targets.TARGETS)}; all if left out")
    parser.add_argument("--seconds", type=int, default=600, help="in all, shared evenly [default: 600]")
    parser.add_argument("--work", type=Path, help="working folder, kept; a temporary one if left out")
    parser.add_argument("--minimise", action="store_true", help="write the corpus anew from the working folder")
    options = parser.parse_args()
    names = options.targets or list(targets.TARGETS)
    for name in names:
        if name not in targets.TARGETS:
            parser.error(f"unknown target {name!r}")
    work = options.work or Path(tempfile.mkdtemp(prefix="fuzz-"))
    work.mkdir(parents=True, exist_ok=True)
    try:
        import atheris  # noqa: F401
    except ImportError:
        print("atheris is not installed: pip install -c constraints.txt -e '.[fuzz]' (Linux, CPython)", file=sys.stderr)
        return 2
    findings = fuzz(names, options.seconds, work) if options.seconds else 0
    if options.minimise:
        minimise(names, work)
    print(f"{findings} of {len(names)} targets found something; working folder: {work}")
    return bool(findings)


if __name__ == "__main__":
    sys.exit(main())

"""``slurm-script``: a run as an array job of a SLURM cluster."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

EXAMPLES = """\b
Examples:
  python -m benchmark slurm-script --shards 16 -o job.sh -- --methods all --dataset kinder-gator --task adult:child
  bash job.sh

\b
Everything after -- is what `run` takes. The options of every shard's job are --time, --memory, --cpus, and with --sbatch any
other of sbatch, for example --sbatch=--partition=gpu --sbatch=--gres=gpu:1.
"""


@click.command("slurm-script", epilog=EXAMPLES)
@click.option("--shards", type=click.IntRange(1, 10_000), required=True, help="In how many jobs to divide the cells.")
@click.option("--time", "limit", default="04:00:00", show_default=True, help="Time limit of a job.")
@click.option("--memory", default="4G", show_default=True, help="Memory for each core of a job.")
@click.option("--cpus", type=click.IntRange(1), default=1, show_default=True, help="Cores of a job: cells at a time.")
@click.option("--sbatch", multiple=True, metavar="OPTION", help="A further option of sbatch; may be repeated.")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Where to write the script [default: the terminal].")
@click.argument("arguments", metavar="-- RUN-OPTIONS", nargs=-1, type=click.UNPROCESSED)
def slurm_script(
    shards: int,
    limit: str,
    memory: str,
    cpus: int,
    sbatch: tuple[str, ...],
    out: Path | None,
    arguments: tuple[str, ...],
) -> None:
    """Write a script that submits a run as an array job, and a job after it that puts the parts together.

    The run folder must be on a disk that all nodes share. A job that is ended goes on where it was when the script is run
    again.
    """
    from benchmark.commands.run import run

    # Mistakes are better found here than by a job that has waited a night.
    parsed = run.make_context("run", list(arguments)).params
    for name in ("shard", "jobs", "dry_run"):
        if parsed[name]:
            raise click.UsageError(f"leave --{name.replace('_', '-')} out: the script decides it")
    text = render(arguments, shards=shards, limit=limit, memory=memory, cpus=cpus, sbatch=sbatch)
    if out is None:
        click.echo(text, nl=False)
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
        click.echo(f"submit with: bash {shlex.quote(str(out))}")


def render(
    arguments: tuple[str, ...], *, shards: int, limit: str, memory: str, cpus: int, sbatch: tuple[str, ...] = ()
) -> str:
    """The script's text.

    Parameters
    ----------
    arguments
        Of ``run``.
    shards, limit, memory, cpus, sbatch
        As on the command line.

    Raises
    ------
    click.UsageError
        For a line break in an option, which would be another line of the script.
    """
    for option in (*arguments, *sbatch, limit, memory):
        if "\n" in option or "\r" in option:
            raise click.UsageError(f"a line break in {option!r}")
    command = shlex.join([sys.executable, "-m", "benchmark", "run", *arguments])
    folder = shlex.quote(str(Path.cwd()))
    common = [f"--time={limit}", f"--mem-per-cpu={memory}", *sbatch]
    return "\n".join(
        [
            "#!/bin/bash",
            "# Submits a run as an array job, and a job after it that puts the parts together.",
            "set -euo pipefail",
            "",
            "array=$(sbatch --parsable <<'SHARDS'",
            "#!/bin/bash",
            "#SBATCH --job-name=benchmark",
            f"#SBATCH --array=1-{shards}",
            f"#SBATCH --cpus-per-task={cpus}",
            *(f"#SBATCH {option}" for option in common),
            f"cd {folder}",
            f'srun {command} --quiet --jobs {cpus} --shard "$SLURM_ARRAY_TASK_ID/{shards}"',
            "SHARDS",
            ")",
            "# A failed cell fails its shard's job only: its reason is in the report all the same.",
            "sbatch --parsable --dependency=\"afterany:${array%%;*}\" <<'WHOLE'",
            "#!/bin/bash",
            "#SBATCH --job-name=benchmark-report",
            *(f"#SBATCH {option}" for option in common),
            f"cd {folder}",
            f"srun {command} --jobs 1",
            "WHOLE",
            "",
        ]
    )

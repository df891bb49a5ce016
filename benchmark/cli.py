"""The command line and the only composition root. Importing it, or asking for help, imports nothing heavy."""

from __future__ import annotations

import errno
import importlib
import sys
from collections.abc import Sequence
from typing import Any

import click

from benchmark.errors import BenchmarkError

#: Verb to the command that does it, and what it does in one line.
VERBS: dict[str, tuple[str, str]] = {
    "run": ("benchmark.commands.run:run", "Plan, fit, transfer, score and report; resumes where it was left."),
    "list": ("benchmark.commands.list:list_", "What methods, metrics, datasets and figures there are."),
    "data": ("benchmark.commands.data:data", "Fetch, verify, describe and index data sets."),
    "score": ("benchmark.commands.score:score", "Score the stored clips of a run again, without refitting."),
    "analyze": ("benchmark.commands.analyze:analyze", "Statistics of a run and of ratings, by people or simulated."),
    "claims": ("benchmark.commands.claims:claims", "Each claim of the papers, the test of it, and whether it holds."),
    "report": ("benchmark.commands.report:report", "Write the report of a run again."),
    "figures": ("benchmark.commands.figures:figures", "Draw the figures of a run again."),
    "video": ("benchmark.commands.video:video", "Clips, or the results of a run side by side, as an MP4."),
    "study": ("benchmark.commands.study:study", "Ask people: build, serve, rehearse and analyse a perceptual study."),
    "transfer": ("benchmark.commands.transfer:transfer", "Apply a trained method of a run to your own clip."),
    "compare": ("benchmark.commands.compare:compare", "Two runs side by side, with what differs in their settings."),
    "merge": ("benchmark.commands.merge:merge", "Take the cells of other run folders: parts of one run."),
    "slurm-script": ("benchmark.commands.slurm:slurm_script", "A run as an array job of a SLURM cluster."),
    "metrics-check": (
        "benchmark.commands.metrics_check:metrics_check",
        "Spoil true performances in grades: which metric sees which fault.",
    ),
    "new-method": ("benchmark.commands.new_method:new_method", "Write a plug-in package for a new method."),
    "check-method": ("benchmark.commands.check_method:check_method", "Run the conformance suite against a method."),
}

#: What the user can mend when a file or folder that was named cannot be read or written; other system errors are faults.
PLACE_ERRORS = {
    errno.EACCES: "change its permissions or choose another place",
    errno.EPERM: "change its permissions or choose another place",
    errno.EROFS: "choose a place that can be written to",
    errno.ENOTDIR: "a file is where a folder should be: choose another place",
    errno.EISDIR: "a folder is where a file should be: choose another name",
    errno.EEXIST: "a file is where a folder should be: choose another place",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOSPC: "free some space and run the same command again",
    errno.EDQUOT: "free some space and run the same command again",
}

EXAMPLES = """\b
Examples:
  python -m benchmark run --methods all
  python -m benchmark run --methods identity,nearest --dataset kinder-gator --task adult:child --out runs/kg
  python -m benchmark run --methods 'dynamic-scaling[both]' --preset quick --dry-run
  python -m benchmark list methods -v
  python -m benchmark transfer --run runs/kg --method dynamic-scaling in.bvh -o out.bvh
"""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are used."""

    def list_commands(self, context: click.Context) -> list[str]:
        """The verbs, in the order in which they are used."""
        return list(VERBS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        """Import the verb's command."""
        if name not in VERBS:
            return None
        module, _, attribute = VERBS[name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def resolve_command(
        self, context: click.Context, arguments: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As in click, with the nearest verb suggested for an unknown one."""
        from difflib import get_close_matches

        try:
            return super().resolve_command(context, arguments)
        except click.UsageError as error:
            close = get_close_matches(arguments[0], VERBS, n=1)
            if not close or "mean" in error.message:
                raise
            raise click.UsageError(f"{error.message} Did you mean {close[0]!r}?", context) from error

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """List the verbs without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, VERBS[name][1]) for name in VERBS])


def _print_version(context: click.Context, _: click.Parameter, value: bool) -> None:
    if value and not context.resilient_parsing:
        from importlib.metadata import version

        click.echo(f"motion-style-benchmark {version('motion-style-benchmark')}")
        context.exit()


@click.group(cls=LazyGroup, epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Print the version."
)
def cli() -> None:
    """Compare methods of motion style transfer: adult to child, neutral to old, tired, proud.

    One common split of one data set, several methods, metrics of style, content, physics, timing and cost, and a report.
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and end the process with its exit code.

    0: done; 2: an error the user can mend, in one line; 3: done, but some cells failed; 130: interrupted. Any other
    exception is a fault of the suite and is shown in full.
    """
    sys.exit(call(arguments))


def call(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    try:
        code: Any = cli.main(
            args=None if arguments is None else list(arguments), prog_name="benchmark", standalone_mode=False
        )
    except BenchmarkError as error:
        click.echo(f"error: {error}", err=True)
        return error.exit_code
    except OSError as error:
        if error.errno not in PLACE_ERRORS or error.filename is None:
            raise
        click.echo(f"error: cannot use {error.filename}: {error.strerror}; {PLACE_ERRORS[error.errno]}", err=True)
        return BenchmarkError.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        return 130
    return code if isinstance(code, int) else 0

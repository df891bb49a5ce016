"""``claims``: what the papers claim, tested on finished runs."""

from __future__ import annotations

from pathlib import Path

import click

EPILOG = """\b
Examples:
  python -m benchmark run --config experiments/claims.toml
  python -m benchmark analyze runs/claims
  python -m benchmark claims runs/claims runs/dong2018 runs/styles

\b
Each claim is looked for in the runs in their order; the first that has the rows and metrics it needs is taken. The table is
written into the first run: stats/claims.csv, tables/claims.md and tables/claims.tex. Claims about what people see need
ratings: `analyze` reads those of people, or makes them with simulated observers, and then every such row says so.
"""


@click.command("claims", epilog=EPILOG)
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--only",
    multiple=True,
    metavar="NAME",
    help="Show only claims whose names match, as 'constraints-*'; may be repeated. All are judged and written.",
)
def claims(runs: tuple[Path, ...], only: tuple[str, ...]) -> None:
    """Test each empirical claim of the papers on one or more finished RUNS.

    A claim holds where the stated difference is shown (interval beyond 0, p below the claim's level after Holm's correction
    over all tests), does not hold where it is not, and cannot be tested where the runs lack what it needs.
    """
    from fnmatch import fnmatchcase

    from benchmark.commands.tables import claims_table, make_console
    from benchmark.errors import UnknownNameError
    from reports.claims.definitions import CLAIMS
    from reports.claims.evidence import claim_counts, judge
    from reports.claims.table import write_claims
    from reports.run import RunView

    for pattern in only:
        if not any(fnmatchcase(claim.name, pattern) for claim in CLAIMS):
            raise UnknownNameError("claim", pattern, [claim.name for claim in CLAIMS])
    # All are judged: what a claim's p is corrected for must not depend on which are looked at.
    table = judge([RunView(folder) for folder in runs])
    shown = table[[not only or any(fnmatchcase(name, pattern) for pattern in only) for name in table["claim"]]]
    paths = write_claims(table, runs[0])
    console = make_console()
    console.print(claims_table(shown))
    console.print(claim_counts(shown), soft_wrap=True)
    for path in paths:
        console.print(str(path), markup=False, soft_wrap=True)

"""The tables go through LaTeX with the packages that they say they need, and fit a page."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from reports.latex import latex_escape
from reports.run import RunView
from reports.tables import write_tables
from reports.trajectory_tables import write_trajectory_tables

pytestmark = pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")

DOCUMENT = r"""\documentclass{article}
\usepackage[utf8]{inputenc}\usepackage[margin=2cm]{geometry}
%PACKAGES%
\begin{document}
%BODY%
\end{document}
"""


def compiled(body: str, folder: Path) -> str:
    """What LaTeX says of a document."""
    found = re.search(r"% needs: (.*)", body)
    packages = ""
    for package in found[1].split(", ") if found else ():
        name, _, option = package.partition(" with option ")
        packages += rf"\usepackage[{option}]{{{name}}}" if option else rf"\usepackage{{{name}}}"
    source = DOCUMENT.replace("%PACKAGES%", packages).replace("%BODY%", body)
    (folder / "x.tex").write_text(source, encoding="utf-8")
    for _ in range(2):  # a long table learns its widths from the first
        done = subprocess.run(
            ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape", "x.tex"],
            cwd=folder, capture_output=True, check=False,
        )  # fmt: skip
        said = done.stdout.decode(errors="replace")
        assert done.returncode == 0, said[-2000:]
    return said


def test_every_table_of_a_run_compiles_and_fits(finished, tmp_path):
    run = RunView(finished)
    write_tables(run)
    write_trajectory_tables(run)
    tables = sorted((finished / "tables").glob("*.tex"))
    assert tables
    for table in tables:
        said = compiled(table.read_text(encoding="utf-8"), tmp_path)
        assert "Overfull \\hbox" not in said, f"{table.name} is wider than the page"


@pytest.mark.parametrize(
    "text", [r"\input{/etc/passwd}", "50 % a_b & #1 $x^2$ {~", "−3 – <a> |b| m/s² ³ ·", "\\", "a\n\nb"]
)
def test_texts_from_files_compile(text, tmp_path):
    said = compiled(rf"% needs: booktabs{chr(10)}\section{{{latex_escape(text)}}}", tmp_path)
    assert "root:" not in said and "Missing character" not in said

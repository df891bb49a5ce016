"""Every figure on runs of several shapes: it draws or says why not, and no text is cut or lies over another."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import pyarrow.parquet as parquet
import pytest

from benchmark.api import NotApplicableError
from benchmark.registry import FIGURES
from benchmark.runner.views import RESULTS
from reports.drawing import Drawing, save
from reports.run import RunView

REAL = "child-reference"
METHOD = "dynamic-scaling[time]"


def fabricate(finished: Path, folder: Path, edit: Callable[[pd.DataFrame], pd.DataFrame]) -> Path:
    """A copy of a run whose table of results, and with it what its cells hold, is edited."""
    shutil.copytree(finished, folder, ignore=shutil.ignore_patterns("figures", "report", "tables"))
    table = edit(parquet.read_table(folder / RESULTS).to_pandas())
    table.to_parquet(folder / RESULTS, index=False)
    clips = set(table["clip_id"])
    for path in folder.glob("cells/*/items.json"):
        path.write_text(json.dumps([item for item in json.loads(path.read_text()) if item["clip_id"] in clips]))
    return folder


def one_clip(table: pd.DataFrame) -> pd.DataFrame:
    """Only what concerns one clip, and the costs of fitting."""
    scored = table.loc[table["metric"].str.startswith("content/") & (table["status"] == "ok"), "clip_id"]
    return table[table["clip_id"].isin([scored.iloc[0], ""]) | table["clip_id"].isna()]


def without_anchor(table: pd.DataFrame) -> pd.DataFrame:
    """No real performers."""
    return table[table["method"] != REAL]


def crowded(table: pd.DataFrame) -> pd.DataFrame:
    """Twenty methods, some of whose names are long."""
    own = table[table["method"] == METHOD]
    names = [f"cyclegan[preset=smoke,coherence={n}]" if n % 3 else f"method-{n}" for n in range(17)]
    # Costs spread over decades, other values less.
    growth = own["metric"].str.startswith("cost/").map({True: 1.4, False: 1.06})
    copies = [own.assign(method=name, value=own["value"] * growth**n) for n, name in enumerate(names, 1)]
    return pd.concat([table, *copies], ignore_index=True)


def costs_alike(table: pd.DataFrame) -> pd.DataFrame:
    """Methods whose costs differ by a percent or two, as those that learn nothing do on a machine without other work."""
    rank = pd.factorize(table["method"])[0]
    cost = table["metric"].str.startswith("cost/") & (table["status"] == "ok")
    return table.assign(value=table["value"].where(~cost, 0.0048 * (1.0 + 0.01 * rank)))


EDITS = {
    "whole": lambda table: table,
    "one-clip": one_clip,
    "no-anchor": without_anchor,
    "twenty": crowded,
    "costs-alike": costs_alike,
}


@pytest.fixture(scope="module", params=list(EDITS))
def view(request, finished, tmp_path_factory) -> RunView:
    folder = tmp_path_factory.mktemp("fabricated") / request.param
    return RunView(fabricate(finished, folder, EDITS[request.param]))


@pytest.fixture
def texts(monkeypatch) -> Iterator[list]:
    """The texts drawn while this is in use: an axis also holds labels of ticks that it leaves out."""
    from matplotlib.text import Text

    drawn: list[Text] = []
    real = Text.draw

    def draw(self, renderer, *args, **kwargs):
        if self.get_visible() and self.get_text().strip():
            drawn.append(self)
        return real(self, renderer, *args, **kwargs)

    monkeypatch.setattr(Text, "draw", draw)
    yield drawn


def assert_texts_are_apart(drawing: Drawing, texts: list) -> None:
    """No text leaves the page or shares more than a pixel's rim with another; slanted ones may share their boxes' corners."""
    figure = drawing.figure
    renderer = figure.canvas.get_renderer()
    texts.clear()
    figure.draw(renderer)
    own = list(dict.fromkeys(texts))
    assert own
    boxes = [(text, text.get_window_extent(renderer)) for text in own]
    width, height = figure.bbox.width, figure.bbox.height
    for text, box in boxes:
        inside = box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1
        assert inside, f"{drawing.name}: {text.get_text()!r} is cut: {box} of {width} x {height}"
    upright = [(text, box.padded(-1.0)) for text, box in boxes if text.get_rotation() % 90 == 0]
    for (one, a), (other, b) in itertools.combinations(upright, 2):
        shares = min(a.x1, b.x1) > max(a.x0, b.x0) and min(a.y1, b.y1) > max(a.y0, b.y0)
        assert not shares, f"{drawing.name}: {one.get_text()!r} lies over {other.get_text()!r}"


@pytest.mark.parametrize("name", list(FIGURES.names()))
def test_a_figure_draws_whole_or_says_why_not(name, view, texts, tmp_path):
    try:
        drawings = FIGURES.get(name)(view)
    except NotApplicableError as lacking:
        assert str(lacking)
        return
    for drawing in drawings:
        assert "n = " in drawing.caption or "clip" in drawing.caption
        assert len(drawing.data)
        assert_texts_are_apart(drawing, texts)
    if drawings and view.folder.name == "whole":
        saved = save(drawings[0], tmp_path)
        assert saved.pdf.read_bytes().startswith(b"%PDF") and saved.png.stat().st_size > 1000
        assert saved.pdf.stat().st_size < 500_000
        # Fonts are embedded as TrueType: publishers refuse type 3.
        assert b"/Type3" not in saved.pdf.read_bytes()
        assert len(pd.read_csv(saved.csv)) == len(drawings[0].data)

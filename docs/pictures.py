"""Draw the pictures of the README anew, from a run on synthetic data: `make pictures`.

Reads what `python -m benchmark run` and `python -m benchmark metrics-check` wrote. A run on recordings is refused: no picture
of a recorded person gets in here.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).resolve().parent
#: Widest that a picture is shown, pixels, and colours that are enough for drawings.
WIDTH, COLOURS = 1420, 256
#: Picture of the README -> figure of the run.
FIGURES = {
    "pose-strip": "pose-strip-adult-to-child",
    "recognition": "metrics-adult-to-child-recognition",
    "critical-difference": "critical-difference-adult-to-child",
    "style-content": "style-content-adult-to-child",
    "ratings": "ratings",
}
#: The clip of the picture of a video, and the moment.
CLIP, MOMENT = "adult005/run-as-fast-as-you-can_3", "1.2"
VIDEO_METHODS = "nearest,dynamic-scaling[both],hsu,holden,cyclegan,cyclegan-kc"


def shrink(source: Path, target: Path, *, shaded: bool = False) -> None:
    """Write a picture small enough for a repository: at most ``WIDTH`` wide, with a palette; shades kept if ``shaded``."""
    from PIL import Image

    with Image.open(source) as opened:
        picture = opened.convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    dither = Image.Dither.FLOYDSTEINBERG if shaded else Image.Dither.NONE
    picture.quantize(COLOURS, dither=dither).save(target, optimize=True)
    print(f"{target.relative_to(DOCS.parent)}: {picture.width} x {picture.height}, {target.stat().st_size // 1024} kB")


def screenshot(page: Path, target: Path) -> None:
    """The head of a report and its moving pictures as a browser shows them, if there is a chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": 1420, "height": 900}, reduced_motion="reduce")
        tab.goto(page.resolve().as_uri())
        tab.get_by_role("heading", name="Side by side").scroll_into_view_if_needed()
        tab.evaluate("window.scrollBy(0, document.querySelector('canvas').getBoundingClientRect().top - 190)")
        tab.get_by_role("slider").first.fill(MOMENT)
        tab.wait_for_timeout(500)
        tab.screenshot(path=str(target))
        browser.close()


def main(run: Path, check: Path) -> int:
    """Draw every picture."""
    from reports.run import RunView

    if RunView(run).dataset != "synthetic":
        sys.exit(f"{run} is no run on synthetic data: pictures of recordings do not belong into the repository")
    for name, figure in FIGURES.items():
        shrink(run / "figures" / f"{figure}.png", DOCS / f"{name}.png")
    with tempfile.TemporaryDirectory() as aside:
        still = Path(aside) / "still.png"
        video = [sys.executable, "-m", "benchmark", "video", str(run), "--clip", CLIP, "--methods", VIDEO_METHODS]
        subprocess.run([*video, "--still", MOMENT, "--size", "1420x760", "-o", str(still)], check=True)
        shrink(still, DOCS / "side-by-side.png", shaded=True)
        if shutil.which("chromium"):
            shot = Path(aside) / "report.png"
            screenshot(run / "report" / "index.html", shot)
            shrink(shot, DOCS / "report.png", shaded=True)
    for picture in sorted(check.glob("*.png")):
        shrink(picture, DOCS / "metrics-check.png")
    return 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python docs/pictures.py RUN METRICS_CHECK, as runs/synthetic-adult-child runs/metrics-check")
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))

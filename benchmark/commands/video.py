"""``video``: clips and the results of a run as moving pictures."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from benchmark.errors import ConfigError, SkeletonError, UnknownNameError

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.motion.clip import MotionClip
    from reports.run import RunView
    from reports.video import Panel

EXAMPLES = """\b
Examples:
  python -m benchmark video walk.bvh -o walk.mp4
  python -m benchmark video adult.bvh child.bvh -o both.mp4
  python -m benchmark video runs/kg -o jump.mp4 --clip jump-as-high --methods hsu,cyclegan
  python -m benchmark video runs/kg -o videos --all
  python -m benchmark video walk.bvh -o walk.png --still 1.5
"""

#: Seconds of a stimulus in Dong et al. 2020.
STIMULUS_SECONDS = 10.0


class Size(click.ParamType):
    """Width and height, as ``640x480``."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Two whole numbers with an x between."""
        if isinstance(value, tuple):
            return value
        width, _, height = str(value).lower().partition("x")
        if not (width.strip().isdigit() and height.strip().isdigit()):
            self.fail(f"{value!r} is no size such as 640x480", param, ctx)
        return int(width), int(height)


@dataclass(frozen=True)
class Look:
    """What all videos of one call have in common; the fields are those of :class:`reports.video.Scene`."""

    size: tuple[int, int] | None
    fps: float
    seconds: float | None
    card: bool
    footer: str
    normalise: str
    blind: bool
    still: float | None


@click.command("video", epilog=EXAMPLES)
@click.argument("sources", metavar="FILES|RUN", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--out", "-o", required=True, type=click.Path(path_type=Path), help="The .mp4 to write (.png with --still)."
)
@click.option(
    "--clip", help="Of a run: id of a source clip, or any part of it that only one has; default the liveliest."
)
@click.option("--all", "every", is_flag=True, help="Of a run: one video for each source clip, into the folder OUT.")
@click.option(
    "--methods", "-m", default="", help="Of a run: methods between input and real performer, with commas; all."
)
@click.option("--task", "-t", help="Of a run that has several tasks: which one, as source:target.")
@click.option("--variant", type=click.Choice(["raw", "cleaned"]), default="raw", show_default=True, help="Of a run.")
@click.option("--seconds", type=float, help="Exactly this long: longer clips are cut, shorter ones start again.")
@click.option("--loop", is_flag=True, help=f"The same as --seconds {STIMULUS_SECONDS:g}, as stimuli of the 2020 study.")
@click.option(
    "--card/--no-card", default=True, show_default=True, help='A card that says "Repeat" before starting again.'
)
@click.option("--fps", type=float, default=30.0, show_default=True, help="Frames per second of the video.")
@click.option("--size", type=Size(), help="Width x height; default 640x480, 1280x720 for several figures.")
@click.option(
    "--title", "titles", multiple=True, help="Title of a file's panel, once for each file; default their names."
)
@click.option("--footer", help="Line below the picture; default the data set and licence of a run.")
@click.option(
    "--normalise",
    type=click.Choice(["none", "leg", "height"]),
    help="Bring all figures to one length of leg, or to one height; default none.",
)
@click.option(
    "--blind", is_flag=True, help="For raters: no titles, one colour for both sides, all figures of one height."
)
@click.option("--still", type=float, metavar="SECONDS", help="One picture at this moment instead of a video.")
@click.option(
    "--role-map", type=click.Path(path_type=Path), help="TOML that names joints by role: [roles] hips = 'Hip' …"
)
def video(
    sources: tuple[Path, ...],
    out: Path,
    clip: str | None,
    every: bool,
    methods: str,
    task: str | None,
    variant: str,
    seconds: float | None,
    loop: bool,
    card: bool,
    fps: float,
    size: tuple[int, int] | None,
    titles: tuple[str, ...],
    footer: str | None,
    normalise: str | None,
    blind: bool,
    still: float | None,
    role_map: Path | None,
) -> None:
    """Draw clips as an MP4: one figure, or several side by side and in step.

    FILES are BVH files or the .npz clips of a run; they are set on the floor, seen from the front and their left. RUN is
    the folder of a finished run: the input, each method's result and a real performer. Needs `pip install -e '.[video]'`, or
    an ffmpeg that IMAGEIO_FFMPEG_EXE names.
    """
    from benchmark.commands.tables import make_console

    if loop and seconds is not None:
        raise ConfigError("--loop is --seconds 10: give one of them")
    if still is not None and (loop or seconds is not None):
        raise ConfigError("--still is one moment: it goes with neither --seconds nor --loop")
    look = Look(
        size,
        fps,
        STIMULUS_SECONDS if loop else seconds,
        card,
        footer or "",
        normalise or ("height" if blind else "none"),
        blind,
        still,
    )
    console = make_console()
    if not every:
        _check_suffix(out, still)
    folders = [source for source in sources if source.is_dir()]
    if not folders:
        if clip or every or methods or task:
            raise ConfigError("--clip, --all, --methods and --task are for a run: give its folder instead of files")
        panels = file_panels(
            sources, titles, role_map, lambda words: console.print(words, style="yellow", markup=False)
        )
        _make(console, panels, out, look)
        return
    if len(sources) > 1:
        raise ConfigError(f"{folders[0]} is a folder: give one run, or files only")
    if titles or role_map:
        raise ConfigError("--title and --role-map are for files: the panels of a run are named after its methods")
    _of_run(console, sources[0], out, look, footer, clip, every, methods, task, variant)


def _of_run(
    console: Console,
    folder: Path,
    out: Path,
    look: Look,
    footer: str | None,
    clip: str | None,
    every: bool,
    methods: str,
    task: str | None,
    variant: str,
) -> None:
    from dataclasses import replace

    from reports.run import RunView
    from reports.video.runs import clip_ids, credit, find_clip, run_panels

    run = RunView(folder)
    task = _task(run, task)
    patterns = [name.strip() for name in methods.split(",") if name.strip()]
    known = clip_ids(run, task)
    if not known:
        raise ConfigError(f"the run {folder} has no results of the task {task}")
    look = replace(look, footer=credit(run.dataset) if footer is None else footer)
    if every and clip:
        raise ConfigError("--all draws every clip: leave out --clip")
    if every and out.suffix:
        raise ConfigError(f"--all writes many files: give a folder, not {out}")
    suffix = ".mp4" if look.still is None else ".png"
    for clip_id in known if every else [find_clip(known, clip) if clip else run.showpiece(task) or known[0]]:
        panels = run_panels(run, task, clip_id, methods=patterns, variant=variant)
        target = out / f"{clip_id.replace('/', '_')}{suffix}" if every else out
        console.print(f"{clip_id}: {', '.join(panel.title for panel in panels)}", markup=False, soft_wrap=True)
        _make(console, panels, target, look, title="" if look.blind else f"{clip_id}, {task}")


def _task(run: RunView, task: str | None) -> str:
    if task is None:
        if len(run.tasks) > 1:
            raise ConfigError(f"the run has several tasks, {', '.join(run.tasks)}: choose one by --task")
        return run.tasks[0]
    if task not in run.tasks:
        raise UnknownNameError("task of this run", task, run.tasks)
    return task


def file_panels(
    paths: Sequence[Path], titles: Sequence[str], role_map: Path | None, say: Callable[[str], None]
) -> list[Panel]:
    """A panel for each file; titles are their names where there are several. ``say`` tells of joints that are not known."""
    from reports.video import Panel

    if titles and len(titles) != len(paths):
        raise ConfigError(
            f"{len(titles)} titles for {len(paths)} files: give --title once for each file, or not at all"
        )
    names = list(titles) or ([path.stem for path in paths] if len(paths) > 1 else [""])
    return [Panel(_load(path, role_map, say), name) for path, name in zip(paths, names, strict=True)]


def _load(path: Path, role_map: Path | None, say: Callable[[str], None]) -> MotionClip:
    """A clip from a file, on the floor and facing +Z."""
    from benchmark.motion import bvh, canonical, npz
    from benchmark.motion.roles import load_role_map

    if path.suffix.lower() == ".npz":
        return npz.load(path)
    clip = bvh.load(path, role_map=None if role_map is None else load_role_map(role_map))
    try:
        return canonical.canonicalise(clip, trim=False)
    except SkeletonError as error:
        say(f"{path}: drawn as bare bones, as it lies in the file: {error}")
        return clip.with_root(clip.root - [clip.root[0, 0], clip.positions[..., 1].min(), clip.root[0, 2]])


def _check_suffix(out: Path, still: float | None) -> None:
    wanted = ".mp4" if still is None else ".png"
    if out.suffix.lower() != wanted:
        raise ConfigError(
            f"{out} does not end in {wanted}, which is what is written{' with --still' * (still is not None)}"
        )


def _make(console: Console, panels: Sequence[Panel], out: Path, look: Look, *, title: str = "") -> None:
    from reports.video import Panel, write_still, write_video

    if look.blind:
        panels = [Panel(panel.clip) for panel in panels]
    size = look.size or ((640, 480) if len(panels) == 1 else (1280, 720))
    common: dict[str, Any] = {
        "size": size,
        "footer": look.footer,
        "sides": not look.blind,
        "normalise": look.normalise,
    }
    if look.still is not None:
        write_still(panels, out, at=look.still, **common)
        console.print(f"{out}: {size[0]} x {size[1]}, at {look.still:g} s", markup=False, soft_wrap=True)
        return
    metadata: Mapping[str, str] = {} if look.blind or not title else {"title": title, "comment": look.footer}
    started = time.perf_counter()
    with _progress(console, out.name) as report:
        facts = write_video(
            panels,
            out,
            fps=look.fps,
            seconds=look.seconds,
            repeat_card=look.card,
            metadata=metadata,
            report=report,
            **common,
        )
    rate = facts.frames / (time.perf_counter() - started)
    console.print(
        f"{out}: {facts.frames} frames, {facts.seconds:.2f} s at {look.fps:g} per second, {size[0]} x {size[1]}, "
        f"{facts.bytes / 1e6:.2f} MB; {rate:.0f} frames/s",
        markup=False,
        soft_wrap=True,
    )


@contextmanager
def _progress(console: Console, name: str) -> Iterator[Callable[[float], None] | None]:
    """A bar on a terminal; nothing elsewhere, where the line at the end says all."""
    if not console.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(name, total=1.0)
        yield lambda share: progress.update(task, completed=share)

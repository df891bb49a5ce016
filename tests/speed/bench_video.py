"""A stimulus of 10 s at 640 x 480, from clip to file, on one core: ours beside sticks drawn by other libraries."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from benchmark.data.synthetic import SyntheticDataset
from benchmark.motion.clip import MotionClip
from reports.video import Panel, Scene, write_video
from reports.video.encoder import encode

FPS, SIZE, FRAMES, REPEATS = 30, (640, 480), 300, 5


class Case:
    """A clip, the moments to draw, and a folder to write to."""

    def __init__(self, frames: int, size: tuple[int, int], folder: Path) -> None:
        corpus = SyntheticDataset()
        record = next(r for r in corpus.records if r.style == "adult" and r.action == "walk")
        self.clip: MotionClip = corpus.load(record.clip_id)
        self.frames, self.size, self.folder = frames, size, folder
        self.seconds = frames / FPS
        # Sticks in the picture's plane, one for each bone, at every moment: the peers need no camera of their own.
        spots = (np.arange(frames) * self.clip.fps / FPS).astype(int) % len(self.clip)
        self.joints = (self.clip.positions - self.clip.root[:, None] * [1.0, 0.0, 1.0])[spots]
        self.bones = [(int(self.clip.skeleton.parents[j]), j) for j in range(1, len(self.clip.skeleton))]

    def write(self, name: str, draw: Callable[[int], bytes]) -> Path:
        """Frames drawn one by one, as RGB bytes, to a file, by imageio-ffmpeg as it comes."""
        import imageio_ffmpeg

        path = self.folder / f"{name}.mp4"
        writer = imageio_ffmpeg.write_frames(
            str(path), self.size, fps=FPS, output_params=["-threads", "1"], macro_block_size=1
        )
        writer.send(None)
        for frame in range(self.frames):
            writer.send(draw(frame))
        writer.close()
        return path


def _plot(case: Case, three: bool) -> Job:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(case.size[0] / 100, case.size[1] / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot(projection="3d" if three else None)
    axes.set_xlim(-1, 1)
    axes.set_ylim(*((-1, 1) if three else (0, 2)))
    if three:
        axes.set_zlim(0, 2)
    axes.axis("off")
    lines = [axes.plot(*([0, 1],) * (3 if three else 2), color="k", lw=3)[0] for _ in case.bones]

    def draw(frame: int) -> bytes:
        x, y, z = case.joints[frame].T
        for line, ends in zip(lines, case.bones, strict=True):
            spots = list(ends)
            line.set_data(x[spots], z[spots] if three else y[spots])
            if three:
                line.set_3d_properties(y[spots])
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].tobytes()

    return lambda: case.write("plot3" if three else "plot2", draw)


def _pillow(case: Case) -> Job:
    from PIL import Image, ImageDraw

    width, height = case.size

    def draw(frame: int) -> bytes:
        image = Image.new("RGB", case.size, (236, 236, 236))
        pencil = ImageDraw.Draw(image)
        pixels = (case.joints[frame, :, :2] * [0.45, -0.45] * height + [width / 2, 0.95 * height]).tolist()
        for start, end in case.bones:
            pencil.line((*pixels[start], *pixels[end]), fill=(60, 60, 60), width=6)
        return image.tobytes()

    return lambda: case.write("pillow", draw)


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """This process, and with it the ffmpeg that it starts, on one core; as it is where that cannot be told."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def processor_seconds() -> float:
    """Seconds of processor time of this process and of those that it started and that have ended.

    On one core without other work, time passes at just this rate; with other work on the core, this one says still what ours
    takes. Where children's time is not told, plain time.
    """
    try:
        import resource
    except ImportError:
        return time.perf_counter()
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def run(
    console: Any, *, frames: int = FRAMES, size: tuple[int, int] = SIZE, repeats: int = REPEATS
) -> list[dict[str, Any]]:
    """Frames per second of processor time, drawing and encoding together, from a clip to a finished file.

    ``ours`` draws lit bodies with shadow, ground and footer; the peers draw plain sticks on nothing. ``ours, drawing`` and
    ``ours, encoding`` are its two halves, the second with frames that lie ready.
    """
    with tempfile.TemporaryDirectory() as folder, one_core():
        case = Case(frames, size, Path(folder))
        scene = Scene([Panel(case.clip)], size=size, fps=FPS, seconds=case.seconds, footer="data set, licence")
        ready = list(scene.frames())

        def ours() -> None:
            # A fresh clip: positions are kept with the clip they were computed for.
            panels = [Panel(case.clip.replace())]
            write_video(
                panels, case.folder / "ours.mp4", size=size, fps=FPS, seconds=case.seconds, footer="data set, licence"
            )

        def drawing() -> None:
            for _ in scene.frames():
                pass

        def encoding() -> None:
            encode(ready, len(ready), case.folder / "ready.mp4", size=size, fps=FPS)

        peers, missing = collect(
            {
                "matplotlib 2-D sticks": lambda case: _plot(case, False),
                "matplotlib 3-D sticks": lambda case: _plot(case, True),
                "pillow sticks": _pillow,
            },
            case,
            console=console,
        )
        jobs = {"ours": ours, "ours, drawing": drawing, "ours, encoding": encoding, **peers}
        seconds = interleaved(jobs, repeats=repeats, clock=processor_seconds)
    return rows("Video, 640 x 480 on one core", seconds, missing, work=float(frames), unit="frames/s")

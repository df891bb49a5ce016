"""Frames to an MP4 that every browser plays: H.264, yuv420p, its index in front."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import BenchmarkError, ConfigError
from reports.video.canvas import Canvas

#: Chosen for 100 frames a second on one core with room to draw: see ``tests/speed/bench_video.py``.
_PRESET, _CRF = "superfast", "20"

#: Seconds between two frames that can be jumped to.
_KEY_SECONDS = 2.0


class EncoderError(BenchmarkError):
    """An ffmpeg that is missing or stopped before its work was done."""


@dataclass(frozen=True)
class VideoFacts:
    """What was written."""

    frames: int
    seconds: float
    bytes: int
    sha256: str


def find_ffmpeg() -> str:
    """The ffmpeg to use: the one that ``IMAGEIO_FFMPEG_EXE`` names, else that of the imageio-ffmpeg wheel.

    Raises
    ------
    EncoderError
        Naming the extra to install, or the file that does not exist.
    """
    named = os.environ.get("IMAGEIO_FFMPEG_EXE")
    if named:
        from shutil import which

        if which(named) is None:
            raise EncoderError(f"IMAGEIO_FFMPEG_EXE names {named}, which is no program: name an ffmpeg, or unset it")
        return named
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise EncoderError(
            "videos need ffmpeg: pip install -c constraints.txt -e '.[video]', or name an ffmpeg by IMAGEIO_FFMPEG_EXE"
        ) from error


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """The size, if it can be encoded; a :class:`~benchmark.errors.ConfigError` says what can."""
    width, height = size
    if width % 2 or height % 2 or not (96 <= width <= 4096 and 96 <= height <= 4096):
        raise ConfigError(f"a video must be 96 to 4096 pixels wide and high, both even, not {width} x {height}")
    return width, height


def encode(
    frames: Iterable[Canvas],
    total: int,
    path: Path,
    *,
    size: tuple[int, int],
    fps: float,
    metadata: Mapping[str, str] | None = None,
    report: Callable[[float], None] | None = None,
) -> VideoFacts:
    """Encode frames to ``path``, whole or not at all.

    The same frames give the same bytes with the same ffmpeg: one thread, no date, and nothing said of the encoder outside of
    the stream.

    Parameters
    ----------
    frames, total
        The frames, and how many there will be.
    metadata
        Tags of the file, for example ``title`` and ``comment``.
    report
        Called with the share done, 0 to 1.

    Raises
    ------
    EncoderError
        With what ffmpeg said, if it stopped.
    """
    width, height = check_size(size)
    program = find_ffmpeg()
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise ConfigError(f"{path} is a folder: name a file to write")
    target.parent.mkdir(parents=True, exist_ok=True)
    aside = target.with_name(f".{target.name[:200]}.{secrets.token_hex(6)}")
    command = [
        *(program, "-hide_banner", "-loglevel", "error", "-nostdin", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "yuv420p", "-video_size", f"{width}x{height}", "-framerate", f"{fps:g}"),
        *("-i", "pipe:0", "-an", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"),
        *("-c:v", "libx264", "-preset", _PRESET, "-crf", _CRF, "-threads", "1"),
        # Said in the stream alone: as options of the output they would make ffmpeg convert every frame.
        *("-x264-params", "colorprim=bt709:transfer=bt709:colormatrix=bt709:range=tv"),
        *("-g", str(max(round(_KEY_SECONDS * fps), 1)), "-movflags", "+faststart"),
        *(part for key, value in (metadata or {}).items() for part in ("-metadata", f"{key}={value}")),
        *("-f", "mp4", str(aside)),
    ]
    count = 0
    try:
        with tempfile.TemporaryFile() as said:
            try:
                process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)
            except OSError as error:
                raise EncoderError(f"{program} cannot be started: {error.strerror or error}") from error
            pipe = process.stdin
            assert pipe is not None
            _widen(pipe.fileno())
            try:
                with contextlib.suppress(BrokenPipeError):
                    for frame in frames:
                        for plane in (frame.luma, frame.cb, frame.cr):
                            pipe.write(plane.data)
                        count += 1
                        if report is not None:
                            report(count / max(total, 1))
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
                process.wait()
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
            if process.returncode != 0 or count != total:
                said.seek(0)
                words = said.read().decode(errors="replace").strip().splitlines()
                raise EncoderError(
                    f"ffmpeg stopped after {count} of {total} frames ({' '.join(words[-1:]) or 'it said nothing'}); "
                    f"{program} must know libx264"
                )
        digest = hashlib.sha256(aside.read_bytes()).hexdigest()
        written = aside.stat().st_size
        aside.replace(target)
    finally:
        with contextlib.suppress(FileNotFoundError):
            aside.unlink()
    return VideoFacts(count, count / fps, written, digest)


def _widen(descriptor: int) -> None:
    """Let a whole frame into the pipe, where the system can: fewer changes between drawing and encoding."""
    with contextlib.suppress(ImportError, AttributeError, OSError):
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, 1 << 20)  # type: ignore[attr-defined, unused-ignore]

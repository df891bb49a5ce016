"""Data sets made for the tests: records without files, folders of BVH, archives, and a server with faults."""

from __future__ import annotations

import contextlib
import hashlib
import io
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from benchmark.data.base import ClipRecord, Dataset
from benchmark.data.cards import Card, Layout, Source, load_card
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache for every test, and no real data unless a test asks for it."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("BENCHMARK_CACHE", str(folder))
    monkeypatch.delenv("BENCHMARK_DATA", raising=False)
    return folder


JOINTS = (
    ("Hips", -1, (0.0, 0.9, 0.0)),
    ("Spine", 0, (0.0, 0.25, 0.0)),
    ("Neck", 1, (0.0, 0.25, 0.0)),
    ("Head", 2, (0.0, 0.12, 0.0)),
    ("LeftArm", 1, (0.18, 0.22, 0.0)),
    ("LeftForeArm", 4, (0.28, 0.0, 0.0)),
    ("LeftHand", 5, (0.25, 0.0, 0.0)),
    ("RightArm", 1, (-0.18, 0.22, 0.0)),
    ("RightForeArm", 7, (-0.28, 0.0, 0.0)),
    ("RightHand", 8, (-0.25, 0.0, 0.0)),
    ("LeftUpLeg", 0, (0.1, 0.0, 0.0)),
    ("LeftLeg", 10, (0.0, -0.43, 0.0)),
    ("LeftFoot", 11, (0.0, -0.43, 0.0)),
    ("LeftToeBase", 12, (0.0, -0.04, 0.15)),
    ("RightUpLeg", 0, (-0.1, 0.0, 0.0)),
    ("RightLeg", 14, (0.0, -0.43, 0.0)),
    ("RightFoot", 15, (0.0, -0.43, 0.0)),
    ("RightToeBase", 16, (0.0, -0.04, 0.15)),
)


@pytest.fixture
def make_clip() -> Callable[..., MotionClip]:
    """``make_clip(scale=1.0, frames=20, fps=30.0, seed=0)``: arms down and waving a little, on a Mixamo-like figure."""
    from benchmark.motion import quat
    from benchmark.motion.roles import find_roles

    def make(
        scale: float = 1.0, frames: int = 20, fps: float = 30.0, seed: int = 0, rename: Mapping[str, str] = {}
    ) -> MotionClip:
        names = tuple(rename.get(name, name) for name, _, _ in JOINTS)
        parents = np.array([parent for _, parent, _ in JOINTS])
        offsets = np.array([offset for _, _, offset in JOINTS]) * scale
        skeleton = Skeleton(names, parents, offsets, roles=find_roles(names, parents.tolist()))
        rng = np.random.default_rng(seed)
        rotations = np.zeros((frames, len(names), 4))
        rotations[..., 0] = 1.0
        swing = 0.3 * np.sin(np.arange(frames) / fps * 2 * np.pi * rng.uniform(0.5, 1.5))
        for joint, sign in ((4, -1.0), (7, 1.0)):
            rotations[:, joint] = quat.from_axis_angle([0.0, 0.0, 1.0], sign * (1.2 + swing))
        root = np.tile([0.0, 0.94 * scale, 0.0], (frames, 1))
        root[:, 2] = np.linspace(0.0, rng.uniform(0.1, 0.5), frames)
        return MotionClip(skeleton, rotations, root, fps)

    return make


@pytest.fixture
def write_folder(tmp_path: Path, make_clip: Callable[..., MotionClip]) -> Callable[..., Path]:
    """``write_folder({"adult/a1/walk_1.bvh": {"scale": 1.0}, …})``: a folder of BVH files, each different."""
    from benchmark.motion import bvh

    def write(files: Mapping[str, Mapping] | list[str], name: str = "captures") -> Path:
        folder = tmp_path / name
        settings = files if isinstance(files, Mapping) else {path: {} for path in files}
        for number, (path, options) in enumerate(settings.items()):
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            bvh.save(make_clip(**{"seed": number, **options}), target)
        return folder

    return write


class ListedDataset(Dataset):
    """A data set of records without files."""

    def __init__(
        self, records: list[ClipRecord], clip: Callable[[ClipRecord], MotionClip] | None = None, card: str = "folder"
    ) -> None:
        self._records = tuple(sorted(records, key=lambda record: record.clip_id))
        self._clip, self._card = clip, card
        self.loads: list[str] = []

    @property
    def id(self) -> str:
        return "listed"

    @property
    def card(self) -> Card:
        return load_card(self._card)

    @property
    def fps(self) -> float:
        return 30.0

    @property
    def records(self) -> tuple[ClipRecord, ...]:
        return self._records

    def load(self, clip_id: str) -> MotionClip:
        self.loads.append(clip_id)
        assert self._clip is not None
        return self._clip(self.record(clip_id)).replace(meta=self.record(clip_id).meta)


@pytest.fixture
def listed() -> Callable[..., ListedDataset]:
    """``listed(records, clip=…)``: a data set of exactly these records."""
    return ListedDataset


def make_record(style: str, actor: str, action: str, take: str) -> ClipRecord:
    content = hashlib.sha256(f"{style}/{actor}/{action}/{take}".encode()).hexdigest()
    return ClipRecord.of(actor=actor, style=style, action=action, take=take, path=None, sha256=content)


@pytest.fixture
def record() -> Callable[..., ClipRecord]:
    """``record(style, actor, action, take)``: a record whose digest is its own."""
    return make_record


@pytest.fixture
def grid() -> Callable[..., ListedDataset]:
    """``grid(n_adults, n_children, actions, takes)``: every performer does every action."""

    def make(adults: int, children: int, actions: int, takes: int, clip: Callable | None = None) -> ListedDataset:
        return ListedDataset(
            [
                make_record(style, f"{style[0]}{actor}", f"action{action}", str(take))
                for style, count in (("adult", adults), ("child", children))
                for actor in range(count)
                for action in range(actions)
                for take in range(takes)
            ],
            clip,
        )

    return make


class TinyCard(Card):
    """A card with its table of digests inside."""

    contents: dict[str, str]

    def digests(self) -> dict[str, str]:
        return dict(self.contents)


TOP = "captures-" + "ab" * 20


@dataclass
class Tiny:
    """A public data set of a few small files, and archives of it."""

    files: dict[str, bytes]
    card: TinyCard

    def archive(self, path: Path, *, only: list[str] | None = None, add: Mapping[str, bytes] | None = None) -> Path:
        """Write an archive of all files, or ``only`` some, with others added or changed."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.packed(only=only, add=add))
        return path

    def packed(self, *, only: list[str] | None = None, add: Mapping[str, bytes] | None = None) -> bytes:
        """The bytes of such an archive."""
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
            packed.writestr(f"{TOP}/", b"")
            for name, content in {
                **{n: c for n, c in self.files.items() if only is None or n in only},
                **(add or {}),
            }.items():
                packed.writestr(f"{TOP}/{name}", content)
        return buffer.getvalue()


@pytest.fixture
def tiny() -> Tiny:
    """Six data files of random bytes, a README, and a card that knows their digests."""
    rng = np.random.default_rng(7)
    files = {f"clips/c{i}.bvh": rng.bytes(40_000) for i in range(6)} | {"README.md": b"about", "movie.mp4": b"large"}
    card = TinyCard(
        id="tiny",
        title="Tiny",
        version="abababababab",
        summary="for tests",
        kind="download",
        licence=load_card("bandai-namco").licence,
        citation=load_card("bandai-namco").citation,
        source=Source(repository="owner/captures", commit="ab" * 20),
        layout=Layout(data=("clips/*.bvh",), keep=("README*",), table="none", marker="clips"),
        how_to_get="python -m benchmark data fetch tiny",
        contents={
            name: hashlib.sha256(content).hexdigest() for name, content in files.items() if name.endswith(".bvh")
        },
    )
    return Tiny(files, card)


@dataclass
class Server:
    """A real HTTP server on loopback. ``faults`` are taken in turn, one a request, ``""`` for none.

    ``drop:N`` closes the connection after N bytes of the body; ``status:N`` answers with that code; ``wrong`` sends other
    bytes of the same length; ``page`` answers with a web page, as portals do; ``stray`` answers a range that starts ten bytes
    later. ``stall:N`` sends N bytes and then nothing more until the client goes away; ``silent`` does not even answer.
    ``longer:N`` announces N bytes more than it sends, ``shorter:N`` N fewer, ``length:X`` the text X. ``to:URL`` redirects.
    ``ranges``, ``lengths`` and ``etag`` say what the server can do.
    """

    url: str = ""
    content: dict[str, bytes] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    ranges: bool = True
    lengths: bool = True
    etag: str | None = '"one"'
    requests: list[dict[str, str]] = field(default_factory=list)


@pytest.fixture
def server() -> Iterator[Server]:
    """The server, empty and sound until a test says otherwise."""
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *args: object) -> None:
            pass

        def do_GET(self) -> None:
            self.close_connection = True
            state.requests.append(dict(self.headers))
            fault = state.faults.pop(0) if state.faults else ""
            kind, _, amount = fault.partition(":")
            body = state.content.get(self.path)
            if kind == "silent":
                self.wait()
                return
            if kind == "to":
                self.send_response(302)
                self.send_header("Location", amount)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            if kind == "page":
                body = b"<!doctype html><title>Please log in</title>"
            if kind == "status" or body is None:
                self.send_response(int(amount or 404))
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            start = 0
            asked = self.headers.get("Range")
            if asked and state.ranges and self.headers.get("If-Range") in (None, state.etag):
                start = int(asked.removeprefix("bytes=").rstrip("-"))
                if start >= len(body):
                    self.send_response(416)
                    self.send_header("Content-Range", f"bytes */{len(body)}")
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                if kind == "stray":
                    start += 10
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {start}-{len(body) - 1}/{len(body)}")
            else:
                self.send_response(200)
            if state.etag is not None:
                self.send_header("ETag", state.etag)
            if state.lengths:
                length = len(body) - start
                length += {"longer": 1, "shorter": -1}.get(kind, 0) * int(
                    amount if kind in ("longer", "shorter") else 0
                )
                self.send_header("Content-Length", amount if kind == "length" else str(length))
            self.send_header("Connection", "close")
            self.end_headers()
            sent = body[start:]
            if kind == "wrong":
                sent = bytes(len(sent))
            if kind in ("drop", "stall"):
                sent = sent[: int(amount)]
            with contextlib.suppress(ConnectionError):  # a client that was told of fewer bytes has gone
                self.wfile.write(sent)
            if kind == "stall":
                self.wait()

        def wait(self) -> None:
            """Until the client closes the connection."""
            self.wfile.flush()
            with contextlib.suppress(OSError):
                self.connection.recv(1)

    httpd = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.url = f"http://127.0.0.1:{httpd.server_port}"
    thread = threading.Thread(target=httpd.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    yield state
    httpd.shutdown()
    httpd.server_close()
    thread.join()

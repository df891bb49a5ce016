"""Parcels hold plain files, and nothing else is taken out of one."""

from __future__ import annotations

import io
import stat
import zipfile

import pytest

from benchmark.errors import StoreError
from benchmark.runner import parcel


def zipped(*entries: tuple[str, bytes], kind: int = stat.S_IFREG) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in entries:
            info = zipfile.ZipInfo(name)
            info.external_attr = (kind | 0o644) << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            packed.writestr(info, data)
    return buffer.getvalue()


def test_a_folder_comes_back_as_it_was(tmp_path):
    source = tmp_path / "a"
    (source / "outputs" / "deep").mkdir(parents=True)
    (source / "outputs" / "deep" / "clip.npz").write_bytes(bytes(range(256)) * 40)
    (source / "empty").write_bytes(b"")
    (source / ".hidden").write_bytes(b"left")
    parcel.unpack(parcel.pack(source), tmp_path / "b")
    found = {path.relative_to(tmp_path / "b").as_posix(): path.read_bytes() for path in tmp_path.rglob("b/**/*.*")}
    assert found == {"outputs/deep/clip.npz": bytes(range(256)) * 40}
    assert (tmp_path / "b" / "empty").read_bytes() == b""


@pytest.mark.parametrize(
    "data",
    [
        b"no zip",
        zipped(("a", b"x"))[:-10],
        zipped(("../a", b"x")),
        zipped(("/a", b"x")),
        zipped(("a/../../b", b"x")),
        zipped(("a\\b", b"x")),
        zipped(("c:a", b"x")),
        zipped(("a", b"/etc"), kind=stat.S_IFLNK),
        zipped(("ok", b"x"), ("../a", b"x")),
    ],
    ids=["garbage", "cut", "up", "absolute", "inside", "backslash", "drive", "link", "second"],
)
def test_what_is_unsafe_or_damaged_is_refused_and_leaves_nothing(tmp_path, data):
    with pytest.raises(StoreError):
        parcel.unpack(data, tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []


def test_sizes_are_bounded_both_ways(tmp_path, monkeypatch):
    bomb = zipped(("a", bytes(1 << 20)))
    assert len(bomb) < 1 << 12
    with pytest.raises(StoreError, match=r"more than the .* allowed"):
        parcel.unpack(bomb, tmp_path / "folder", max_bytes=1 << 19)
    with pytest.raises(StoreError, match="more than the"):
        parcel.unpack(zipped(("a", b""), ("b", b"")), tmp_path / "folder", max_files=1)
    # A header that understates a size does not get more through.
    lying = bomb.replace((1 << 20).to_bytes(4, "little"), (100).to_bytes(4, "little"))
    with pytest.raises(StoreError):
        parcel.unpack(lying, tmp_path / "folder")
    monkeypatch.setattr(parcel, "MAX_BYTES", 10)
    (tmp_path / "big").mkdir()
    (tmp_path / "big" / "file").write_bytes(bytes(11))
    with pytest.raises(StoreError, match="on a disk that all workers share"):
        parcel.pack(tmp_path / "big")

from __future__ import annotations

import multiprocessing
import os
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmark.data import cache as cache_module
from benchmark.data.cache import (
    atomic_path,
    cache_root,
    cached_clip,
    cached_skeleton,
    canonical_version,
    file_digests,
    locked,
)
from benchmark.digest import file_digest
from benchmark.errors import DataError
from benchmark.motion.clip import ClipMeta

META = ClipMeta(actor="a", style="adult", action="walk", take="1")


def stored(cache):
    return list((cache / "clips").rglob("*.npz"))


def same(a, b):
    return (
        a.skeleton == b.skeleton
        and np.array_equal(a.rotations, b.rotations)
        and np.array_equal(a.root, b.root)
        and (a.fps, a.meta) == (b.fps, b.meta)
    )


def test_where_the_cache_is(monkeypatch, tmp_path):
    monkeypatch.setenv("BENCHMARK_CACHE", str(tmp_path / "here"))
    assert cache_root() == tmp_path / "here"
    monkeypatch.delenv("BENCHMARK_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_root().name == "motion-style-benchmark"


def test_a_clip_is_made_once_and_comes_back_bit_for_bit(cache, make_clip):
    made = []

    def make():
        made.append(1)
        return make_clip(seed=3)

    first, second = (cached_clip("k" * 64, make, META) for _ in range(2))
    assert len(made) == 1 and same(first, second) and second.meta == META
    other = cached_clip("k" * 64, make, ClipMeta(actor="b"))
    assert len(made) == 1 and other.meta.actor == "b", "one file under two names keeps both names"


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_entry_is_made_again_and_never_believed(cache, make_clip, data):
    key = "d" * 64
    clip = make_clip(seed=1, frames=2)
    cached_clip(key, lambda: clip, META)
    (path,) = stored(cache)
    content = bytearray(path.read_bytes())
    kind = data.draw(st.sampled_from(["flip", "cut", "zero"]))
    at = data.draw(st.integers(0, len(content) - 1))
    if kind == "flip":
        content[at] ^= data.draw(st.integers(1, 255))
    elif kind == "cut":
        del content[at:]
    else:
        content[at : at + 64] = bytes(len(content[at : at + 64]))
    path.write_bytes(content)
    assert same(cached_clip(key, lambda: clip, META), clip.replace(meta=META))


@pytest.mark.parametrize("offset", [8, 10], ids=["marked as encrypted", "packed in an unknown way"])
def test_an_entry_that_the_zip_reader_cannot_handle_is_made_again(cache, make_clip, offset):
    clip = make_clip(frames=2)
    cached_clip("z" * 64, lambda: clip, META)
    (path,) = stored(cache)
    content = bytearray(path.read_bytes())
    directory = content.find(b"PK\x01\x02")
    content[directory + offset] |= 1 if offset == 8 else 99
    path.write_bytes(content)
    assert same(cached_clip("z" * 64, lambda: clip, META), clip.replace(meta=META))
    assert same(cached_clip("z" * 64, lambda: pytest.fail("not stored again"), META), clip.replace(meta=META))


def test_without_a_writable_cache_clips_are_made_each_time(monkeypatch, tmp_path, make_clip, caplog):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BENCHMARK_CACHE", str(tmp_path / "file" / "cache"))
    clip = cached_clip("k" * 64, make_clip, META)
    assert len(clip) == 20 and "cannot write to the cache" in caplog.text


def test_a_skeleton_survives_the_cache(make_clip):
    skeleton = make_clip(0.7).skeleton
    for _ in range(2):
        assert cached_skeleton("s" * 64, lambda: skeleton) == skeleton


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "deep" / "x.txt"
    with atomic_path(path) as temporary:
        temporary.write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old" and list(path.parent.iterdir()) == [path]


def test_digests_are_remembered_but_never_stale(tmp_path, monkeypatch):
    path = tmp_path / "x.bvh"
    path.write_text("one")
    old = time.time_ns() - 10**10
    os.utime(path, ns=(old, old))
    reads = []
    monkeypatch.setattr(cache_module, "file_digest", lambda p: reads.append(p) or file_digest(p))
    first = file_digests([path], memo="m")[path]
    assert file_digests([path], memo="m")[path] == first == file_digest(path) and len(reads) == 1
    path.write_text("two")
    assert file_digests([path], memo="m")[path] == file_digest(path) != first
    # Just written: another write within the clock's tick would not show, so it is read again.
    file_digests([path], memo="m")
    assert len(reads) == 3
    (cache_root() / "digests" / "m.json").write_text('{"' + str(path) + '": [1, 2]}')
    assert file_digests([path], memo="m")[path] == file_digest(path)
    with pytest.raises(DataError, match=r"gone\.bvh"):
        file_digests([tmp_path / "gone.bvh"], memo="m")


def _hold(path, log, name):
    with locked(path):
        with log.open("a") as file:
            file.write(f"{name} in\n")
        time.sleep(0.15)
        with log.open("a") as file:
            file.write(f"{name} out\n")


def test_one_process_at_a_time_holds_a_lock(tmp_path):
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_hold, args=(tmp_path / "lock", tmp_path / "log", name)) for name in "abc"]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    lines = (tmp_path / "log").read_text().split("\n")[:-1]
    assert len(lines) == 6
    assert all(lines[i].split()[0] == lines[i + 1].split()[0] and lines[i].endswith("in") for i in (0, 2, 4))


def test_the_version_is_that_of_the_code():
    assert len(canonical_version()) == 64 and canonical_version() == canonical_version()

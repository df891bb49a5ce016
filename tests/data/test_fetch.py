from __future__ import annotations

import errno
import json
import multiprocessing
import os
import shutil
import stat
import zipfile
from pathlib import Path

import pytest

from benchmark.data import archive as archive_module
from benchmark.data import fetch as fetch_module
from benchmark.data.archive import MAX_ENTRIES, store, unpack
from benchmark.data.cards import load_card
from benchmark.data.fetch import download, fetch
from benchmark.data.locate import fetched, locate
from benchmark.errors import DataError

TOP = "captures-" + "ab" * 20


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def expected(tiny) -> dict[str, bytes]:
    return {name: content for name, content in tiny.files.items() if name != "movie.mp4"}


def leftovers(cache: Path) -> list[str]:
    """Anything but notes and locks."""
    return [
        p.name for p in cache.rglob("*") if p.is_file() and p.suffix not in (".json", ".lock") and p.name != ".lock"
    ]


def quick(tiny, server, **kwargs):
    waits: list[float] = []
    result = fetch(tiny.card, url=f"{server.url}/a.zip", sleep=waits.append, timeout=5.0, **kwargs)
    return result, waits


@pytest.fixture
def serving(tiny, server):
    server.content["/a.zip"] = tiny.packed()
    return server


def test_a_fetched_set_is_whole_verified_and_noted(tiny, serving, cache):
    seen = []
    result, waits = quick(tiny, serving, report=lambda done, total, what: seen.append((done, total, what)))
    assert contents(result.folder) == expected(tiny)
    assert result.missing == 0 and result.receipt.files == 6 and waits == []
    assert locate(tiny.card) == result.folder
    note = json.loads((store(tiny.card) / "current.json").read_text())
    assert note["licence"] == "CC BY-NC 4.0" and note["licence_accepted"].startswith("20")
    assert not (cache / "downloads" / f"{TOP}.zip").exists()
    size = len(serving.content["/a.zip"])
    assert (size, size, "downloading") in seen
    assert seen[-1] == (sum(map(len, expected(tiny).values())),) * 2 + ("unpacking and verifying",)


def test_fetching_again_does_not_download(tiny, serving, monkeypatch):
    quick(tiny, serving)
    asked = len(serving.requests)
    monkeypatch.setattr(fetch_module, "download", lambda *a, **k: pytest.fail("downloaded"))
    assert fetch(tiny.card).receipt.files == 6
    assert len(serving.requests) == asked


def test_dropped_connections_resume_where_they_stopped(tiny, serving):
    serving.faults = ["drop:50000", "drop:60000", ""]
    result, waits = quick(tiny, serving)
    assert contents(result.folder) == expected(tiny)
    assert [request.get("Range") for request in serving.requests] == [None, "bytes=50000-", "bytes=110000-"]
    assert all(request["If-Range"] == '"one"' for request in serving.requests[1:])
    assert len(waits) == 2


def test_a_server_that_stalls_is_left_and_asked_for_the_rest(tiny, serving):
    serving.faults = ["silent", "stall:50000", "stall:10000", ""]
    result = fetch(tiny.card, url=f"{serving.url}/a.zip", sleep=lambda s: None, timeout=0.3)
    assert contents(result.folder) == expected(tiny)
    assert [request.get("Range") for request in serving.requests] == [None, None, "bytes=50000-", "bytes=60000-"]


def test_a_server_that_only_stalls_is_given_up(tiny, serving, cache):
    serving.faults = ["stall:0"] * 9
    with pytest.raises(DataError, match=r"broke after 0 bytes \(TimeoutError\).*--from FILE"):
        fetch(tiny.card, url=f"{serving.url}/a.zip", sleep=lambda s: None, timeout=0.2)
    assert len(serving.requests) == 5 and leftovers(cache) == []


def test_a_server_that_announces_too_much_owns_up_when_asked_for_the_rest(tiny, serving):
    serving.faults = ["longer:1000"] * 20
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)
    assert len(serving.requests) == 2 and serving.requests[1]["Range"] == f"bytes={len(serving.content['/a.zip'])}-"


def test_a_server_that_keeps_announcing_too_much_is_given_up(tiny, serving, cache):
    serving.ranges = False
    serving.faults = ["longer:1000"] * 20
    with pytest.raises(DataError, match=r"closed after \d+ of \d+ bytes.*--from FILE"):
        quick(tiny, serving)
    assert fetched(tiny.card) is None and len(serving.requests) <= 12
    serving.faults = []
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)
    assert leftovers(cache / "downloads") == []


def test_a_server_that_announces_too_little_does_not_pass(tiny, serving, cache):
    serving.faults = ["shorter:1000"]
    with pytest.raises(DataError, match=r"cut short.*get it again"):
        quick(tiny, serving)
    assert fetched(tiny.card) is None and leftovers(cache) == []
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)


@pytest.mark.parametrize("length", ["-5", "many", "1e3", "0x10", "9" * 30])
def test_lengths_that_are_none(tiny, serving, cache, length):
    """Judged by the files where it is no number; one that no disk can hold is refused before anything is written."""
    serving.faults = [f"length:{length}"]
    if length.isdecimal():
        with pytest.raises(DataError, match=r"needs \d+ MB"):
            quick(tiny, serving)
        assert leftovers(cache) == []
    else:
        assert contents(quick(tiny, serving)[0].folder) == expected(tiny)


def test_a_web_page_in_place_of_the_archive_is_named(tiny, serving, cache):
    serving.faults = ["page"]
    with pytest.raises(DataError, match="not a zip archive"):
        quick(tiny, serving)
    assert leftovers(cache) == [] and fetched(tiny.card) is None


def test_redirects_are_followed_to_web_addresses_only(tiny, serving, cache, tmp_path):
    tiny.archive(tmp_path / "secret.zip")
    serving.content["/moved.zip"] = serving.content["/a.zip"]
    serving.faults = ["to:/moved.zip", "drop:50000"]
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)
    for target in ((tmp_path / "secret.zip").as_uri(), "ftp://127.0.0.1:9/a.zip", "/a.zip"):
        serving.faults = [f"to:{target}"] * 99
        with pytest.raises(DataError, match=r"cannot download .*a\.zip"):
            quick(tiny, serving, again=True)
        assert leftovers(cache / "downloads") == []


def test_a_later_call_resumes_what_an_earlier_one_left(tiny, serving, cache):
    serving.faults = ["drop:50000"] + ["status:503"] * 9
    with pytest.raises(DataError, match=r"503.*go on from byte 50000.*--from FILE"):
        quick(tiny, serving)
    serving.faults = []
    result, _ = quick(tiny, serving)
    assert serving.requests[-1]["Range"] == "bytes=50000-"
    assert contents(result.folder) == expected(tiny)
    assert leftovers(cache / "downloads") == []


@pytest.mark.parametrize("change", ["no ranges", "weak etag", "no etag", "new file", "stray range"])
def test_without_a_safe_resume_the_download_starts_over(tiny, serving, change):
    serving.faults = ["drop:50000"]
    serving.ranges = change != "no ranges"
    serving.etag = {"weak etag": 'W/"one"', "no etag": None}.get(change, '"one"')

    def between(seconds: float) -> None:
        if change == "new file" and len(serving.requests) == 1:
            serving.etag = '"two"'
            serving.content["/a.zip"] = tiny.packed(add={"README.md": b"another text altogether"})
        if change == "stray range" and len(serving.requests) == 1:
            serving.faults = ["stray"]

    result = fetch(tiny.card, url=f"{serving.url}/a.zip", sleep=between, timeout=5.0)
    changed = {"README.md": b"another text altogether"} if change == "new file" else {}
    assert contents(result.folder) == expected(tiny) | changed
    asked = [request.get("Range") for request in serving.requests]
    assert asked[:2] == [None, None if change in ("weak etag", "no etag") else "bytes=50000-"]


def test_a_chunkless_answer_without_length_is_judged_by_its_files(tiny, serving):
    serving.lengths = False
    result, _ = quick(tiny, serving)
    assert contents(result.folder) == expected(tiny)


def test_a_part_that_is_already_whole_is_used(tiny, serving, cache):
    whole = serving.content["/a.zip"]
    downloads = cache / "downloads"
    downloads.mkdir(parents=True)
    (downloads / f"{TOP}.zip.part").write_bytes(whole)
    note = {"url": f"{serving.url}/a.zip", "validator": '"one"', "total": len(whole)}
    (downloads / f"{TOP}.zip.part.json").write_text(json.dumps(note))
    result, waits = quick(tiny, serving)
    assert contents(result.folder) == expected(tiny) and waits == []
    assert len(serving.requests) == 1


def test_a_damaged_resume_note_is_no_obstacle(tiny, serving, cache):
    (cache / "downloads").mkdir(parents=True)
    (cache / "downloads" / f"{TOP}.zip.part").write_bytes(b"junk")
    (cache / "downloads" / f"{TOP}.zip.part.json").write_text("{")
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)


@pytest.mark.parametrize(("code", "tries"), [(404, 1), (403, 1), (503, 5), (429, 5)])
def test_refusals_name_the_address_and_the_way_out(tiny, serving, cache, code, tries):
    serving.faults = [f"status:{code}"] * 20
    with pytest.raises(DataError, match=rf"a\.zip.*{code}.*--from FILE"):
        quick(tiny, serving)
    assert len(serving.requests) == tries
    assert leftovers(cache) == [] and fetched(tiny.card) is None


def test_no_server_at_all(tiny, cache):
    with pytest.raises(DataError, match=r"127\.0\.0\.1:9.*--from FILE"):
        fetch(tiny.card, url="http://127.0.0.1:9/a.zip", sleep=lambda s: None, timeout=2.0)
    assert leftovers(cache) == []


def test_only_http_addresses(tiny, tmp_path):
    tiny.archive(tmp_path / "a.zip")
    with pytest.raises(DataError, match="not an http"):
        fetch(tiny.card, url=(tmp_path / "a.zip").as_uri())


def test_wrong_bytes_leave_nothing_behind(tiny, serving, cache):
    serving.faults = ["wrong"]
    with pytest.raises(DataError, match="not a zip archive"):
        quick(tiny, serving)
    assert leftovers(cache) == [] and fetched(tiny.card) is None
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)


def test_an_altered_file_is_named(tiny, server, cache):
    server.content["/a.zip"] = tiny.packed(add={"clips/c3.bvh": b"altered"})
    with pytest.raises(DataError, match=r"clips/c3\.bvh in .* was altered.*fresh archive"):
        quick(tiny, server)
    assert leftovers(cache) == [] and fetched(tiny.card) is None


def test_a_damaged_member_is_named(tiny, tmp_path, cache):
    path = tiny.archive(tmp_path / "a.zip")
    packed = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        info = file.getinfo(f"{TOP}/clips/c2.bvh")
    packed[info.header_offset + 200] ^= 0xFF
    path.write_bytes(packed)
    with pytest.raises(DataError, match=r"clips/c2\.bvh in .* (is damaged|was altered)"):
        fetch(tiny.card, archive=path)
    assert leftovers(cache) == []


@pytest.mark.parametrize("keep", [0, 10, 1000, -30])
def test_a_truncated_archive(tiny, tmp_path, cache, keep):
    path = tmp_path / "a.zip"
    path.write_bytes(tiny.packed()[:keep])
    with pytest.raises(DataError, match=r"a\.zip"):
        fetch(tiny.card, archive=path)
    assert leftovers(cache) == []


def test_a_local_subset_says_how_much_is_missing(tiny, tmp_path):
    path = tiny.archive(tmp_path / "part.zip", only=["clips/c1.bvh", "clips/c4.bvh"])
    result = fetch(tiny.card, archive=path)
    assert (result.receipt.files, result.missing) == (2, 4)
    assert sorted(contents(result.folder)) == ["clips/c1.bvh", "clips/c4.bvh"]
    assert fetch(tiny.card, archive=tmp_path / "part.zip").folder == result.folder


def test_a_file_without_a_known_digest_stays_packed(tiny, tmp_path):
    path = tiny.archive(tmp_path / "a.zip", add={"clips/new.bvh": b"unknown"})
    result = fetch(tiny.card, archive=path)
    assert result.receipt.left_packed == ("clips/new.bvh",)
    assert contents(result.folder) == expected(tiny)


def test_an_archive_in_benchmark_data_needs_no_network(tiny, tmp_path, monkeypatch):
    tiny.archive(tmp_path / "data" / "tiny-subset.zip", only=["clips/c0.bvh"])
    monkeypatch.setenv("BENCHMARK_DATA", str(tmp_path / "data"))
    assert fetch(tiny.card).receipt.files == 1
    assert locate(tiny.card).is_relative_to(tmp_path / "cache")


@pytest.mark.parametrize("name", [f"{TOP}.zip", "ab" * 20 + ".zip", "tiny.zip", "tiny-mine.zip"])
def test_locate_knows_the_names_of_archives(tiny, tmp_path, name):
    tiny.archive(tmp_path / "data" / name)
    folder = locate(tiny.card, tmp_path / "data")
    assert contents(folder) == expected(tiny)
    before = (folder / "clips" / "c0.bvh").stat().st_mtime_ns
    assert locate(tiny.card, tmp_path / "data") == folder
    assert (folder / "clips" / "c0.bvh").stat().st_mtime_ns == before, "unpacked twice"


def test_locate_mends_an_unpacked_copy_that_lost_a_file(tiny, tmp_path):
    tiny.archive(tmp_path / "data" / "tiny.zip")
    folder = locate(tiny.card, tmp_path / "data")
    (folder / "clips" / "c0.bvh").unlink()
    assert contents(locate(tiny.card, tmp_path / "data")) == expected(tiny)


def test_a_fetched_copy_that_lost_a_file_says_so(tiny, serving):
    folder = quick(tiny, serving)[0].folder
    (folder / "clips" / "c0.bvh").unlink()
    with pytest.raises(DataError, match=r"5 of the 6 files.*data fetch tiny"):
        locate(tiny.card)
    assert contents(quick(tiny, serving)[0].folder) == expected(tiny)


@pytest.mark.parametrize("place", ["", TOP, "tiny"])
def test_locate_uses_unpacked_folders_as_they_are(tiny, tmp_path, place):
    for name, content in tiny.files.items():
        target = tmp_path / "data" / place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    assert locate(tiny.card, tmp_path / "data") == tmp_path / "data" / place


def test_locate_says_how_to_get_what_is_not_there(tiny, tmp_path, monkeypatch):
    with pytest.raises(
        DataError, match="BENCHMARK_DATA is not set; fetch it with `python -m benchmark data fetch tiny`"
    ):
        locate(tiny.card)
    with pytest.raises(DataError, match=str(tmp_path)):
        locate(tiny.card, tmp_path)
    monkeypatch.setenv("BENCHMARK_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(DataError, match="nowhere, which does not exist"):
        locate(tiny.card)


UNSAFE = [
    f"{TOP}/../outside.bvh",
    "../outside.bvh",
    "/outside.bvh",
    f"{TOP}/clips/..\\outside.bvh",
    "C:/outside.bvh",
    f"{TOP}/clips//x.bvh",
    f"{TOP}/./clips/x.bvh",
]


@pytest.mark.parametrize("name", UNSAFE)
def test_unsafe_names_are_refused_before_anything_is_written(tiny, tmp_path, cache, name):
    path = tiny.archive(tmp_path / "in" / "a.zip")
    with zipfile.ZipFile(path, "a") as file:
        info = zipfile.ZipInfo("x")
        info.filename = name
        file.writestr(info, b"evil")
    before = sorted(p for p in tmp_path.rglob("*") if cache not in p.parents and p != cache)
    with pytest.raises(DataError, match="unsafe name"):
        fetch(tiny.card, archive=path)
    assert sorted(p for p in tmp_path.rglob("*") if cache not in p.parents and p != cache) == before
    assert leftovers(cache) == []


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO])
def test_links_and_devices_are_refused(tiny, tmp_path, kind):
    path = tiny.archive(tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as file:
        info = zipfile.ZipInfo(f"{TOP}/clips/link.bvh")
        info.external_attr = (kind | 0o777) << 16
        file.writestr(info, b"/etc/passwd")
    with pytest.raises(DataError, match=r"link\.bvh'?, which is a link or a device"):
        fetch(tiny.card, archive=path)


def test_bombs_are_refused(tiny, tmp_path, cache):
    path = tiny.archive(tmp_path / "ratio.zip", add={"clips/big.bvh": bytes(30_000_000)})
    with pytest.raises(DataError, match=r"clips/big\.bvh would grow \d+-fold"):
        fetch(tiny.card, archive=path)
    small = tiny.card.model_copy(update={"layout": tiny.card.layout.model_copy(update={"max_bytes": 100_000})})
    with pytest.raises(DataError, match="more than the 100000 allowed"):
        fetch(small, archive=tiny.archive(tmp_path / "size.zip"))
    many = tmp_path / "many.zip"
    with zipfile.ZipFile(many, "w") as file:
        for number in range(MAX_ENTRIES + 1):
            file.writestr(f"{TOP}/{number}", b"")
    with pytest.raises(DataError, match="entries"):
        fetch(tiny.card, archive=many)
    assert leftovers(cache) == []


def test_duplicates_and_strangers_are_refused(tiny, tmp_path):
    twice = tiny.archive(tmp_path / "twice.zip")
    with zipfile.ZipFile(twice, "a") as file:
        file.writestr(f"{TOP}/clips/C1.BVH", b"again")
    with pytest.raises(DataError, match="twice"):
        fetch(tiny.card, archive=twice)
    other = tmp_path / "other.zip"
    with zipfile.ZipFile(other, "w") as file:
        file.writestr("captures-main/clips/c1.bvh", b"x")
    with pytest.raises(DataError, match=rf"lies in {TOP}/.*{'ab' * 20}\.zip"):
        fetch(tiny.card, archive=other)
    empty = tmp_path / "empty.zip"
    with zipfile.ZipFile(empty, "w") as file:
        file.writestr(f"{TOP}/README.md", b"x")
    with pytest.raises(DataError, match="no motion file"):
        fetch(tiny.card, archive=empty)
    with pytest.raises(DataError, match="no archive"):
        fetch(tiny.card, archive=tmp_path / "absent.zip")


def test_a_full_disk_is_told_before_and_during(tiny, serving, cache, monkeypatch):
    usage = shutil.disk_usage(cache.parent)
    with monkeypatch.context() as patch:
        patch.setattr(fetch_module.shutil, "disk_usage", lambda path: usage._replace(free=1000))
        with pytest.raises(DataError, match=r"needs 0 MB.*BENCHMARK_CACHE"):
            quick(tiny, serving)
    assert leftovers(cache) == []

    def full(*args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(archive_module, "_extract", full)
        with pytest.raises(DataError, match="disk is full"):
            quick(tiny, serving)
    assert leftovers(cache) == [] and fetched(tiny.card) is None
    assert not [p for p in store(tiny.card).iterdir() if p.is_dir()]


def test_a_full_disk_while_downloading(serving, tmp_path):
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    (tmp_path / "x.zip.part").symlink_to("/dev/full")
    with pytest.raises(DataError, match="disk is full"):
        download(f"{serving.url}/a.zip", tmp_path / "x.zip", sleep=lambda s: None)
    assert not (tmp_path / "x.zip").exists() and not os.path.lexists(tmp_path / "x.zip.part")


def test_a_cache_that_cannot_be_written(tiny, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("BENCHMARK_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(DataError, match="BENCHMARK_CACHE"):
        fetch(tiny.card, archive=tiny.archive(tmp_path / "a.zip"))


def test_unpacking_needs_a_card_with_an_archive(tmp_path):
    with pytest.raises(DataError, match="has no public archive"):
        fetch(load_card("synthetic"))


def _fetch_in_process(card, url, cache, queue):
    os.environ["BENCHMARK_CACHE"] = cache
    try:
        queue.put(contents(fetch(card, url=url).folder))
    except Exception as error:
        queue.put(repr(error))


def test_processes_that_fetch_at_once_do_not_disturb_each_other(tiny, serving, cache):
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    workers = [
        context.Process(target=_fetch_in_process, args=(tiny.card, f"{serving.url}/a.zip", str(cache), queue))
        for _ in range(3)
    ]
    for worker in workers:
        worker.start()
    results = [queue.get(timeout=30) for _ in workers]
    for worker in workers:
        worker.join()
    assert results == [expected(tiny)] * 3
    assert len([p for p in store(tiny.card).iterdir() if p.is_dir()]) == 1


def test_unpack_reports_progress_and_never_overwrites(tiny, tmp_path):
    path = tiny.archive(tmp_path / "a.zip")
    files, left = unpack(tiny.card, path, tmp_path / "out")
    assert (files, left) == (6, ())
    with pytest.raises(DataError, match="cannot write"):
        unpack(tiny.card, path, tmp_path / "out")
    assert contents(tmp_path / "out") == expected(tiny)


@pytest.mark.real_data
@pytest.mark.parametrize(("card_id", "files", "missing"), [("kinder-gator", 335, 824), ("bandai-namco", 144, 2932)])
def test_the_real_archives_over_http(real_data, server, card_id, files, missing):
    card = load_card(card_id)
    packed = (real_data / f"{card_id}-subset.zip").read_bytes()
    server.content["/a.zip"] = packed
    server.faults = [f"drop:{len(packed) // 3}", f"drop:{len(packed) // 3}"]
    result = fetch(card, url=f"{server.url}/a.zip", sleep=lambda s: None)
    assert len(server.requests) == 3 and "Range" in server.requests[-1]
    assert (result.receipt.files, result.missing, result.receipt.left_packed) == (files, missing, ())
    assert locate(card) == result.folder

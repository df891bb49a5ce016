from __future__ import annotations

import pytest

from benchmark.data.verify import verify


@pytest.fixture
def copy(tiny, tmp_path):
    for name, content in tiny.files.items():
        target = tmp_path / "copy" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
    return tmp_path / "copy"


def test_a_whole_copy_is_sound(tiny, copy):
    steps = []
    result = verify(tiny.card, copy, report=lambda done, total: steps.append((done, total)))
    assert result.ok(complete=True) and len(result.sound) == 6
    assert (result.missing, result.altered, result.extra) == ((), (), ())
    assert steps[-1] == (6, 6)


def test_a_subset_is_sound_but_not_complete(tiny, copy):
    (copy / "clips/c2.bvh").unlink()
    (copy / "clips/c5.bvh").unlink()
    result = verify(tiny.card, copy)
    assert result.missing == ("clips/c2.bvh", "clips/c5.bvh")
    assert result.ok() and not result.ok(complete=True)


def test_altered_and_extra_files_are_named(tiny, copy):
    content = bytearray((copy / "clips/c1.bvh").read_bytes())
    content[1234] ^= 1
    (copy / "clips/c1.bvh").write_bytes(content)
    (copy / "clips/own.bvh").write_bytes(b"mine")
    (copy / "notes.txt").write_text("not a motion file")
    (copy / "clips/.DS_Store.bvh").write_text("hidden")
    result = verify(tiny.card, copy)
    assert (result.altered, result.extra, result.missing) == (("clips/c1.bvh",), ("clips/own.bvh",), ())
    assert not result.ok()


def test_a_file_that_changed_without_changing_its_date_is_found(tiny, copy):
    """Verification reads every byte; it does not trust what is remembered of unchanged files."""
    import os

    from benchmark.data.cache import file_digests

    path = copy / "clips/c1.bvh"
    os.utime(path, ns=(10**18, 10**18))
    file_digests([path], memo="m")
    path.write_bytes(bytes(len(path.read_bytes())))
    os.utime(path, ns=(10**18, 10**18))
    assert verify(tiny.card, copy).altered == ("clips/c1.bvh",)

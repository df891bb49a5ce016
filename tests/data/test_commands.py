from __future__ import annotations

import csv

import pytest
from click.testing import CliRunner

from benchmark.commands.data import data
from benchmark.errors import DataError


@pytest.fixture
def run(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")

    def invoke(*arguments, **kwargs):
        return CliRunner().invoke(data, [str(argument) for argument in arguments], **kwargs)

    return invoke


@pytest.fixture
def known(tiny, monkeypatch):
    """The tiny set under the name of a known one."""
    monkeypatch.setattr("benchmark.data.cards.load_card", lambda name: tiny.card)
    return tiny


def test_the_licence_comes_before_anything_else(run, known, server):
    server.content["/a.zip"] = known.packed()
    refused = run("fetch", "tiny", "--url", f"{server.url}/a.zip", input="n\n")
    assert isinstance(refused.exception, DataError) and "not accepted" in str(refused.exception)
    assert "CC BY-NC 4.0" in refused.output and "commercial use: no" in refused.output
    assert server.requests == []
    nobody = run("fetch", "tiny", "--url", f"{server.url}/a.zip", input="")
    assert isinstance(nobody.exception, DataError) and server.requests == []
    accepted = run("fetch", "tiny", "--url", f"{server.url}/a.zip", input="y\n")
    assert accepted.exit_code == 0 and "6 files of Tiny, each as upstream has it" in accepted.output
    assert accepted.output.index("CC BY-NC") < accepted.output.index("6 files")


def test_fetch_from_a_file_and_verify(run, known, tmp_path):
    part = known.archive(tmp_path / "part.zip", only=["clips/c0.bvh", "clips/c1.bvh"], add={"clips/new.bvh": b"x"})
    done = run("fetch", "tiny", "--from", part, "--accept-licence")
    assert done.exit_code == 0 and "A subset: 4 files" in done.output and "clips/new.bvh" in done.output
    checked = run("verify", "tiny")
    assert checked.exit_code == 0
    assert "missing (upstream has it): clips/c2.bvh" in checked.output
    assert "2 sound, 4 missing, 0 altered, 0 extra" in checked.output
    assert run("verify", "tiny", "--complete").exit_code == 1


def test_verify_fails_on_altered_and_extra_files(run, known, tmp_path):
    folder = tmp_path / "copy"
    for name, content in known.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    assert run("verify", "tiny", "--root", folder, "--complete").exit_code == 0
    (folder / "clips/own.bvh").write_bytes(b"x")
    extra = run("verify", "tiny", "--root", folder)
    assert extra.exit_code == 1 and "extra (upstream does not have it): clips/own.bvh" in extra.output
    (folder / "clips/own.bvh").unlink()
    (folder / "clips/c3.bvh").write_bytes(b"x")
    altered = run("verify", "tiny", "--root", folder)
    assert altered.exit_code == 1 and "altered: clips/c3.bvh" in altered.output


def test_verify_shortens_long_lists_unless_asked(run, tmp_path, make_clip, known, monkeypatch):
    many = {f"clips/m{i:03d}.bvh": "0" * 64 for i in range(60)}
    card = known.card.model_copy(update={"contents": {**known.card.contents, **many}})
    monkeypatch.setattr("benchmark.data.cards.load_card", lambda name: card)
    folder = tmp_path / "copy"
    (folder / "clips").mkdir(parents=True)
    (folder / "clips/c0.bvh").write_bytes(known.files["clips/c0.bvh"])
    short = run("verify", "tiny", "--root", folder).output
    assert short.count("missing (upstream has it)") == 21 and "and 45 more" in short
    assert run("verify", "tiny", "--root", folder, "--all").output.count("missing (upstream has it)") == 65


def test_info(run):
    everything = run("info")
    assert everything.exit_code == 0
    for name in ("kinder-gator", "bandai-namco", "adult2child", "synthetic", "folder:PATH"):
        assert name in everything.output
    one = run("info", "kinder-gator").output
    assert one.index("never: the repository has no licence file") < one.index("58:")
    for text in (
        "Aloba",
        "@inproceedings{aloba2018kindergator",
        "actor 723",
        "Not usable here",
        "data fetch kinder-gator",
    ):
        assert text in one
    assert "0.1.0" not in one


def test_index_lists_and_writes_a_folders_clips(run, write_folder, tmp_path):
    folder = write_folder(["adult/a/walk_1.bvh", "child/c/walk_1.bvh", "stray.bvh"])
    (folder / "child/c/walk_2.bvh").write_bytes((folder / "child/c/walk_1.bvh").read_bytes())
    listed = run("index", f"folder:{folder}")
    assert listed.exit_code == 0
    assert "adult/a/walk_1" in listed.output and "1 files do not fit the pattern: stray.bvh" in listed.output
    assert "the same file under 2 names: child/c/walk_1, child/c/walk_2" in listed.output
    assert "child: 2 clips, 1 performers, 1 actions" in listed.output
    table = tmp_path / "clips.csv"
    assert run("index", f"folder:{folder}", "--csv", table).exit_code == 0
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0] == {"path": "adult/a/walk_1.bvh", "style": "adult", "actor": "a", "action": "walk", "take": "1"}
    (folder / "clips.csv").write_bytes(table.read_bytes())
    assert "3 clips" in run("index", f"folder:{folder}", "--index", "clips.csv", "--csv", tmp_path / "again.csv").output
    assert (tmp_path / "again.csv").read_bytes() == table.read_bytes(), "an index reads back as itself"
    missing = run("index", f"folder:{tmp_path / 'absent'}")
    assert isinstance(missing.exception, DataError)


def test_synthesize_writes_a_folder_that_opens(run, tmp_path, monkeypatch):
    from benchmark.data.catalog import open_dataset
    from benchmark.data.synthetic import SyntheticDataset

    small = SyntheticDataset(seed=4, adults=1, children=1, takes=1, actions=["walk", "jump"])
    seeds = []
    monkeypatch.setattr("benchmark.data.synthetic.SyntheticDataset", lambda seed: seeds.append(seed) or small)
    done = run("synthesize", tmp_path / "out", "--seed", "4")
    assert done.exit_code == 0 and seeds == [4] and "4 synthetic clips" in done.output
    monkeypatch.undo()
    monkeypatch.setenv("BENCHMARK_CACHE", str(tmp_path / "cache"))
    again = open_dataset(f"folder:{tmp_path / 'out'}", fps=small.fps)
    assert [r.clip_id for r in again.records] == [r.clip_id for r in small.records]
    for record in small.records:
        assert abs(len(again.load(record.clip_id)) - len(small.load(record.clip_id))) <= 1


@pytest.mark.real_data
def test_the_real_sets_from_the_command_line(run, real_data, monkeypatch):
    monkeypatch.setenv("BENCHMARK_DATA", str(real_data))
    checked = run("verify", "kinder-gator")
    assert checked.exit_code == 0 and "335 sound, 824 missing, 0 altered, 0 extra" in checked.output
    assert "child: 168 clips, 7 performers, 24 actions" in run("info", "kinder-gator").output
    assert "childish/bow_1-001" in run("index", "bandai-namco").output

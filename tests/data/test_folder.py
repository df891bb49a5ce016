from __future__ import annotations

import os
import shutil

import pytest

from benchmark.data import folder as folder_module
from benchmark.data.catalog import open_dataset
from benchmark.data.index import compile_pattern, read_index, scan
from benchmark.data.splits import make_split
from benchmark.errors import BenchmarkError, ConfigError, DataError, UnknownNameError

LAYOUT = [
    f"{style}/{actor}/{action}_{take}.bvh"
    for style, actors in (("adult", ("a1", "a2")), ("child", ("c1", "c2")))
    for actor in actors
    for action in ("walk", "jump_high")
    for take in (1, 2)
]


def ids(dataset):
    return [record.clip_id for record in dataset.records]


def test_the_usual_layout(write_folder):
    folder = write_folder(LAYOUT)
    dataset = open_dataset(f"folder:{folder}")
    assert ids(dataset) == sorted(name.removesuffix(".bvh") for name in LAYOUT)
    assert dataset.id == "folder:captures" and dataset.fps == 30.0
    record = dataset.record("child/c1/jump_high_2")
    assert (record.style, record.actor, record.action, record.take) == ("child", "c1", "jump_high", "2")
    clip = dataset.load("child/c1/jump_high_2")
    assert clip.meta == record.meta and clip.fps == 30.0
    assert clip.root[0, 0] == pytest.approx(0.0, abs=1e-9) and clip.positions[..., 1].min() == pytest.approx(
        0.0, abs=0.05
    )
    split = make_split(dataset, "adult", "child")
    assert split.protocol == "paper" and split.parameters["n_train"] == 1


@pytest.mark.parametrize(
    ("pattern", "name", "found"),
    [
        ("{style}/{actor}/{action}_{take}.bvh", "adult/a/walk_fast_01.bvh", ("adult", "a", "walk_fast", "01")),
        ("{style}_{actor}_{action}_{take}.bvh", "adult_a1_walk_fast_01.bvh", ("adult", "a1", "walk_fast", "01")),
        ("{style}_{actor}_{action}_{take}.bvh", "ADULT_a1_walk_01.BVH", ("ADULT", "a1", "walk", "01")),
        ("{actor}-{style}/**/{action}.bvh", "s3-old/x/y/run.bvh", ("old", "s3", "run", "")),
        ("{actor}-{style}/**/{action}.bvh", "s3-old/run.bvh", ("old", "s3", "run", "")),
        ("*_{style}_{action}.bvh", "set1_old_run fast.bvh", ("old", "", "run fast", "")),
        ("./{style}\\{action}{take}.csv", "old/run3.csv", ("old", "", "run", "3")),
        ("{style}/{action}_{take}.bvh", "old/run.bvh", None),
        ("{style}/{action}.bvh", "old/deep/run.bvh", None),
        ("{style}/{action}.b+h", "old/run.bbh", None),
    ],
)
def test_patterns(pattern, name, found):
    match = compile_pattern(pattern).fullmatch(name)
    if found is None:
        assert match is None
        return
    groups = match.groupdict(default="")
    assert tuple(groups.get(field, "") for field in ("style", "actor", "action", "take")) == found


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("{style}/{motion}.bvh", "{motion}"),
        ("{action}.bvh", "{style}"),
        ("{style}/{style}_{action}.bvh", "twice"),
        ("{style}", "{action}"),
    ],
)
def test_bad_patterns(pattern, message):
    with pytest.raises(ConfigError, match=message):
        compile_pattern(pattern)


def test_nothing_fits(write_folder, tmp_path):
    folder = write_folder(["adult/walk.bvh", "child/walk.bvh"])
    with pytest.raises(DataError, match=r"no file in .*captures fits .*adult/walk\.bvh.*dataset\.toml.*CSV index"):
        open_dataset(f"folder:{folder}")
    assert ids(open_dataset(f"folder:{folder}", pattern="{style}/{action}.bvh")) == ["adult/walk", "child/walk"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="it is empty"):
        open_dataset(f"folder:{tmp_path / 'empty'}")
    for name in (tmp_path / "absent", folder / "adult" / "walk.bvh"):
        with pytest.raises(DataError, match="no folder"):
            open_dataset(f"folder:{name}")
    with pytest.raises(ConfigError, match="which folder"):
        open_dataset("folder:")


def test_hidden_files_links_and_loops(write_folder, tmp_path):
    folder = write_folder(LAYOUT)
    (folder / "adult" / "a1" / "._walk_1.bvh").write_bytes(b"resource fork")
    (folder / "__MACOSX" / "adult").mkdir(parents=True)
    (folder / "__MACOSX" / "adult" / "walk_1.bvh").write_bytes(b"")
    (folder / "adult" / "loop").symlink_to(folder, target_is_directory=True)
    elsewhere = tmp_path / "elsewhere"
    shutil.move(folder / "child" / "c2", elsewhere)
    (folder / "child" / "c2").symlink_to(elsewhere, target_is_directory=True)
    for pattern in ("{style}/{actor}/{action}_{take}.bvh", "**/{style}/{actor}/{action}_{take}.bvh"):
        assert ids(open_dataset(f"folder:{folder}", pattern=pattern)) == sorted(n.removesuffix(".bvh") for n in LAYOUT)


def test_a_broken_link_is_named(write_folder):
    folder = write_folder(LAYOUT)
    (folder / "adult" / "a1" / "run_1.bvh").symlink_to(folder / "gone.bvh")
    with pytest.raises(DataError, match=r"run_1\.bvh"):
        open_dataset(f"folder:{folder}")


def test_two_files_that_are_one_clip(write_folder):
    folder = write_folder(["adult/a/walk_1.bvh", "Adult/a/Walk_1.bvh"])
    if len(list(folder.iterdir())) == 1:
        pytest.skip("this file system does not tell Adult from adult")
    with pytest.raises(DataError, match=r"adult/a/walk_1.*Adult/a/Walk_1\.bvh.*adult/a/walk_1\.bvh"):
        open_dataset(f"folder:{folder}")


def test_an_index_lists_clips(write_folder):
    folder = write_folder(["x/1.bvh", "x/2.bvh", "x/3.bvh"])
    index = folder / "clips.csv"
    index.write_text(
        "\ufeffPath,Style,Actor,Action,Take\nx/1.bvh,adult,a,walk,1\nx\\2.bvh,child,c,walk,1\n", encoding="utf-8"
    )
    dataset = open_dataset(f"folder:{folder}", index="clips.csv")
    assert ids(dataset) == ["adult/a/walk_1", "child/c/walk_1"]
    (folder / "dataset.toml").write_text('index = "clips.csv"\n')
    assert ids(open_dataset(f"folder:{folder}")) == ids(dataset)
    assert len(ids(open_dataset(f"folder:{folder}", pattern="{style}/{action}.bvh"))) == 3
    index.write_text("path,style,action\nx/1.bvh,adult,walk\n")
    assert ids(open_dataset(f"folder:{folder}")) == ["adult/walk"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("path,style\nx/1.bvh,adult\n", "no column 'action'"),
        ("path,style,action\nx/1.bvh,,walk\n", "line 2: the column 'style' is empty"),
        ("path,style,action\nx/1.bvh,adult\n", "line 2: the column 'action' is empty"),
        ("path,style,action\nx/9.bvh,adult,walk\n", r"line 2: there is no file .*9\.bvh"),
        ("path,style,action\n../secret.bvh,adult,walk\n", "outside"),
        ("path,style,action\n/etc/hostname,adult,walk\n", "outside"),
        ("path,style,action\n", "lists no clip"),
        ("", "no column 'path'"),
    ],
)
def test_bad_indexes(write_folder, text, message):
    folder = write_folder(["x/1.bvh"])
    (folder.parent / "secret.bvh").write_text("")
    index = folder / "clips.csv"
    index.write_text(text)
    with pytest.raises(DataError, match=message):
        read_index(index, folder)
    with pytest.raises(DataError, match="cannot read the index"):
        read_index(folder / "absent.csv", folder)


def test_settings_in_the_folder(write_folder):
    folder = write_folder(
        {"Neutral/s1/walk.bvh": {"fps": 60.0, "frames": 61}, "Aged/s1/walk.bvh": {"fps": 120.0, "frames": 121}}
    )
    (folder / "dataset.toml").write_text(
        'pattern = "{style}/{actor}/{action}.bvh"\nfps = 30\nunit = "m"\n[styles]\nneutral = "normal"\naged = "old"\n'
    )
    dataset = open_dataset(f"folder:{folder}", unit="cm")
    assert dataset.styles == ("normal", "old") and dataset.fps == 30.0
    assert dataset.settings.unit == "cm", "an option comes before the file"
    assert [len(dataset.load(i)) for i in ids(dataset)] == [31, 31]


def test_the_lowest_rate_is_the_working_rate(write_folder):
    folder = write_folder(
        {"adult/a/walk_1.bvh": {"fps": 60.0, "frames": 61}, "child/c/walk_1.bvh": {"fps": 120.0, "frames": 121}}
    )
    dataset = open_dataset(f"folder:{folder}")
    assert dataset.fps == 60.0
    assert {dataset.load(i).fps for i in ids(dataset)} == {60.0}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("patern = 'x'", "did you mean 'pattern'"),
        ("fps = -1", "fps"),
        ("fps = 'fast'", "fps"),
        ("unit = 'inch'", "unit"),
        ("unit = 0.0", "unit"),
        ("[roles]\nleft_knee = 3", "roles"),
        ("= 3", "not TOML"),
        ("role_map = 'absent.toml'", "absent"),
        ("[roles]\nleft_kne = 'LeftLeg'", "left_kne"),
    ],
)
def test_bad_settings_are_named(write_folder, text, message):
    folder = write_folder(LAYOUT)
    (folder / "dataset.toml").write_text(text)
    with pytest.raises(BenchmarkError, match=message):
        dataset = open_dataset(f"folder:{folder}")
        dataset.load(dataset.records[0].clip_id)


def test_unknown_options_are_refused(write_folder):
    with pytest.raises(UnknownNameError, match="did you mean 'pattern'"):
        open_dataset(f"folder:{write_folder(LAYOUT)}", patern="x")


STRANGE = {"LeftLeg": "Gauche2", "LeftFoot": "Gauche3", "LeftUpLeg": "Gauche1", "LeftToeBase": "Gauche4"}


def test_joints_without_roles_are_asked_for(write_folder):
    folder = write_folder({"adult/a/walk_1.bvh": {"rename": STRANGE}, "child/c/walk_1.bvh": {"rename": STRANGE}})
    with pytest.raises(
        DataError, match=r"walk_1\.bvh: no joint is known to be the .*left_hip, left_knee, left_ankle.*\[roles\]"
    ):
        open_dataset(f"folder:{folder}")
    legs = {"left_hip": "Gauche1", "left_knee": "Gauche2", "left_ankle": "Gauche3", "hips": "Hips", "head": "Head"}
    legs |= {"right_hip": "RightUpLeg", "right_knee": "RightLeg", "right_ankle": "RightFoot"}
    roles = "[roles]\n" + "".join(f'{role} = "{joint}"\n' for role, joint in legs.items())
    (folder / "dataset.toml").write_text(roles)
    clip = open_dataset(f"folder:{folder}").load("adult/a/walk_1")
    assert clip.skeleton.names[clip.skeleton.joint("left_knee")] == "Gauche2"
    (folder / "dataset.toml").write_text('role_map = "map.toml"\n')
    (folder / "map.toml").write_text(roles)
    assert open_dataset(f"folder:{folder}").load("child/c/walk_1").skeleton.has("left_hip")


def test_other_joints_are_refused_or_brought_over(write_folder):
    folder = write_folder(
        {"adult/a/walk_1.bvh": {}, "child/c/walk_1.bvh": {"scale": 0.6, "rename": {"Spine": "Spine1", "Neck": "Neck1"}}}
    )
    with pytest.raises(
        DataError, match=r"child/c/walk_1\.bvh and .*adult/a/walk_1\.bvh differ in joints Neck, Neck1.*retarget = true"
    ):
        open_dataset(f"folder:{folder}")
    dataset = open_dataset(f"folder:{folder}", retarget=True)
    adult, child = dataset.load("adult/a/walk_1"), dataset.load("child/c/walk_1")
    assert child.skeleton.same_topology(adult.skeleton)
    assert child.skeleton.leg_length == pytest.approx(0.6 * adult.skeleton.leg_length, rel=1e-3)


def test_outlines_agree_with_the_reader(write_folder):
    from benchmark.motion import bvh

    path = write_folder(["adult/a/walk_1.bvh"]) / "adult/a/walk_1.bvh"
    outline = folder_module.outline(path)
    clip = bvh.load(path)
    assert outline.names == clip.skeleton.names and outline.parents == tuple(clip.skeleton.parents.tolist())
    assert outline.fps == 30.0
    path.write_text("HIERARCHY\nnothing more")
    assert folder_module.outline(path) is None


def test_a_file_that_is_no_bvh_is_named_when_read(write_folder):
    folder = write_folder(LAYOUT)
    (folder / "adult/a1/walk_1.bvh").write_text("not a motion file")
    dataset = open_dataset(f"folder:{folder}")
    with pytest.raises(BenchmarkError, match=r"walk_1\.bvh"):
        dataset.load("adult/a1/walk_1")


def test_the_digest_is_of_contents_and_settings_not_of_place(write_folder, tmp_path):
    folder = write_folder(LAYOUT)
    dataset = open_dataset(f"folder:{folder}")
    moved = tmp_path / "moved"
    shutil.copytree(folder, moved)
    assert open_dataset(f"folder:{moved}").digest == dataset.digest
    assert open_dataset(f"folder:{folder}", trim=False).digest != dataset.digest
    path = folder / "adult/a1/walk_1.bvh"
    os.utime(path, ns=(10**18, 10**18))
    assert open_dataset(f"folder:{folder}").digest == dataset.digest
    text = path.read_text()
    path.write_text(text.replace("1", "2", 1) if "1" in text else text + " ")
    assert open_dataset(f"folder:{folder}").digest != dataset.digest


def test_a_clip_read_with_other_settings_is_another_clip(write_folder):
    folder = write_folder(LAYOUT)
    legs = [
        open_dataset(f"folder:{folder}", unit=unit).load("adult/a1/walk_1").skeleton.leg_length for unit in (0.01, 0.02)
    ]
    assert legs[1] == pytest.approx(2 * legs[0])


def test_adult2child_is_a_folder_of_ones_own(write_folder, tmp_path, monkeypatch):
    folder = write_folder(
        {name.replace("adult/", "Adults/").replace("child/", "Children/"): {"fps": 120.0} for name in LAYOUT},
        "adult2child",
    )
    with pytest.raises(DataError, match="Ask the authors"):
        open_dataset("adult2child")
    dataset = open_dataset("adult2child", root=folder)
    assert dataset.styles == ("adult", "child") and dataset.fps == 60.0 and dataset.card.id == "adult2child"
    monkeypatch.setenv("BENCHMARK_DATA", str(tmp_path))
    again = open_dataset("adult2child")
    assert again.digest == dataset.digest == open_dataset("adult2child", root=tmp_path).digest
    assert again.load(again.records[0].clip_id).fps == 60.0
    assert make_split(again, "adult", "child").dataset == "adult2child"


def test_scan_counts_what_it_passes_over(write_folder):
    folder = write_folder([*LAYOUT, "adult/stray.bvh"])
    (folder / "notes.txt").write_text("x")
    found = scan(folder, "{style}/{actor}/{action}_{take}.bvh")
    assert [path.name for path in found.unmatched] == ["stray.bvh"] and len(found.entries) == len(LAYOUT)


@pytest.mark.real_data
def test_kinect_files_in_a_folder_share_their_actors_skeleton(kinder_gator, tmp_path):
    folder = tmp_path / "kinect"
    for source, target in (("Adults", "adult"), ("Children", "child")):
        for path in sorted((kinder_gator / source).glob("*.csv"))[:3]:
            actor, action = path.name[6:9], path.name[13:-18]
            place = folder / target / actor / f"{action}_1.csv"
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, place)
    dataset = open_dataset(f"folder:{folder}", pattern="{style}/{actor}/{action}_{take}.csv")
    assert len(dataset.records) == 6 and dataset.fps == 30.0
    clips = [dataset.load(i) for i in ids(dataset)]
    assert clips[0].skeleton == clips[1].skeleton and clips[0].skeleton != clips[-1].skeleton

"""The parts beside the training loop: windows, schedules, presets, random numbers, loss curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.errors import ConfigError, ContractError, StoreError, UnknownNameError
from benchmark.motion.windows import cut
from methods._torch.device import device_for, dropout, isolated_random, low_precision, torch_generator
from methods._torch.history import History
from methods._torch.presets import resolve
from methods._torch.schedule import constant, cosine, linear_decay, stepwise
from methods._torch.weights import all_finite, read_tensors, size, write_tensors
from methods._torch.word_bank import WordBank


def test_a_word_bank_holds_the_windows_that_cut_cuts() -> None:
    rng = np.random.default_rng(0)
    clips = [rng.normal(size=(frames, 3)) for frames in (100, 60, 7, 1, 61)]
    bank = WordBank(clips, 60, 20, dtype=torch.float64)
    cuts = [cut(clip, 60, 20) for clip in clips]
    everything = np.arange(len(bank))
    np.testing.assert_array_equal(bank.words(everything), np.concatenate([each.array for each in cuts]))
    np.testing.assert_array_equal(bank.mask(everything), np.concatenate([each.mask for each in cuts]))
    np.testing.assert_array_equal(bank.starts, np.concatenate([each.starts for each in cuts]))
    np.testing.assert_array_equal(bank.clip, np.repeat(np.arange(5), [len(each) for each in cuts]))
    chosen = [3, 0, 3]
    np.testing.assert_array_equal(bank.words(chosen), bank.words(everything)[chosen])


def test_a_word_bank_holds_every_frame_once() -> None:
    bank = WordBank([np.zeros((1000, 5))], 60, 1)
    assert len(bank) == 941
    assert bank.frames.numel() == 1000 * 5


def test_schedules() -> None:
    assert [constant()(epoch) for epoch in (0.0, 7.5)] == [1.0, 1.0]
    linear = linear_decay(start=100, length=100)
    np.testing.assert_allclose([linear(e) for e in (0, 100, 150, 200, 300)], [1, 1, 0.5, 0, 0])
    np.testing.assert_allclose(linear_decay(start=0, length=100)(1.0), 0.99)
    np.testing.assert_allclose(linear_decay(start=0, length=10, floor=0.2)(5.0), 0.6)
    np.testing.assert_allclose([stepwise(linear)(e) for e in (150.0, 150.9)], [0.5, 0.5])
    curve = cosine(epochs=11, warmup=1, floor=0.1)
    np.testing.assert_allclose([curve(e) for e in (0, 0.5, 1, 6, 11, 20)], [0, 0.5, 1, 0.55, 0.1, 0.1])


def _names() -> dict[str, None]:
    import inspect

    from methods.holden.method import Holden

    return dict.fromkeys(name for name in inspect.signature(Holden).parameters if name != "preset")


def test_a_preset_gives_what_was_not_given() -> None:
    plain = resolve("methods.holden", "paper", _names())
    assert (plain["filters"], plain["width"], plain["start"]) == (256, 25, "noise")
    changed = resolve("methods.holden", "paper", {**_names(), "width": 5, "lr": 1})
    assert changed == {**plain, "width": 5, "lr": 1.0}
    assert type(changed["lr"]) is float


def test_what_does_not_fit_a_preset_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'quick'"):
        resolve("methods.holden", "quik", _names())
    with pytest.raises(ConfigError, match=r"width must be a int such as \d+, not 2.5"):
        resolve("methods.holden", "quick", {**_names(), "width": 2.5})
    with pytest.raises(ConfigError, match="epochs must be a int"):
        resolve("methods.holden", "quick", {**_names(), "epochs": True})
    with pytest.raises(ContractError, match="do not name the same settings: widths"):
        resolve("methods.holden", "quick", {**_names(), "widths": None})


def test_dropout_keeps_the_mean_and_draws_from_its_generator_alone() -> None:
    ones = torch.ones(100_000)
    before = torch.get_rng_state()
    first = dropout(ones, 0.25, torch.Generator().manual_seed(1))
    again = dropout(ones, 0.25, torch.Generator().manual_seed(1))
    assert torch.equal(first, again)
    assert torch.equal(torch.get_rng_state(), before)
    assert float((first == 0).float().mean()) == pytest.approx(0.25, abs=0.01)
    assert float(first.max()) == pytest.approx(1 / 0.75)
    assert dropout(ones, 0.0, torch.Generator()) is ones


def test_isolated_random_leaves_the_global_generator_as_it_was() -> None:
    before = torch.get_rng_state()
    made = []
    for seed in (1, 1, 2):
        with isolated_random(np.random.default_rng(seed)):
            made.append(torch.nn.Linear(3, 3).weight)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(made[0], made[1]) and not torch.equal(made[0], made[2])


def test_generators_follow_the_numpy_one() -> None:
    def draw(seed: int) -> torch.Tensor:
        return torch.rand(4, generator=torch_generator(np.random.default_rng(seed)))

    assert torch.equal(draw(3), draw(3)) and not torch.equal(draw(3), draw(4))


def test_devices_and_precision() -> None:
    cpu = device_for("cpu")
    assert cpu.type == "cpu"
    assert not low_precision(cpu) and not low_precision(cpu, "float32") and low_precision(cpu, "bfloat16")
    with pytest.raises(ConfigError, match="precision must be one of"):
        low_precision(cpu, "float16")
    if not torch.cuda.is_available():
        with pytest.raises(ConfigError, match="torch sees no GPU here"):
            device_for("cuda")


def test_a_history_goes_to_parquet_with_gaps(tmp_path: Path) -> None:
    import pyarrow.parquet as parquet

    history = History()
    history.save(tmp_path / "none.parquet")
    assert not (tmp_path / "none.parquet").exists()
    history.add({"step": 1, "loss": 0.5})
    history.add({"step": 2, "held": np.float64(0.25)})
    history.save(tmp_path / "deep" / "train.parquet")
    table = parquet.read_table(tmp_path / "deep" / "train.parquet").to_pydict()
    assert table == {"step": [1.0, 2.0], "loss": [0.5, None], "held": [None, 0.25]}
    assert history.column("held") == [0.25]


def test_tensors_and_facts_share_a_file_that_is_whole_or_absent(tmp_path: Path) -> None:
    shared = torch.arange(6.0).reshape(2, 3)
    write_tensors(tmp_path / "t.safetensors", {"a": shared.T, "b": shared}, {"n": [1, None, "ä"]})
    tensors, facts = read_tensors(tmp_path / "t.safetensors")
    assert torch.equal(tensors["a"], shared.T) and torch.equal(tensors["b"], shared)
    assert facts == {"n": [1, None, "ä"]}
    with pytest.raises(ValueError, match="Out of range float"):
        write_tensors(tmp_path / "t.safetensors", {"a": shared}, {"n": float("nan")})
    assert read_tensors(tmp_path / "t.safetensors")[1] == facts
    assert [path.name for path in tmp_path.iterdir()] == ["t.safetensors"]
    cut_short = (tmp_path / "t.safetensors").read_bytes()[:-5]
    (tmp_path / "t.safetensors").write_bytes(cut_short)
    with pytest.raises(StoreError, match="holds no weights"):
        read_tensors(tmp_path / "t.safetensors")


def test_size_and_soundness_of_networks() -> None:
    network = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.BatchNorm1d(2))
    assert size(network) == {"parameters": 8 + 4, "bytes": 4 * (8 + 4 + 4) + 8}
    assert all_finite(network)
    with torch.no_grad():
        next(network.parameters())[1, 1] = float("nan")
    assert not all_finite(network)


def test_a_changed_preset_changes_the_digest_of_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmark.digest import source_digest

    package = tmp_path / "some_method_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "presets.toml").write_text("[quick]\nlr = 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    before = source_digest("some_method_package")
    assert source_digest("some_method_package") == before
    (package / "presets.toml").write_text("[quick]\nlr = 2.0\n")
    assert source_digest("some_method_package") != before

"""The training loop: one result for a seed, whatever interrupts it; and what it does when losses go wrong."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.errors import ConfigError, ContractError, StoreError
from methods._torch.device import dropout, isolated_random
from methods._torch.history import TENSORBOARD
from methods._torch.schedule import linear_decay
from methods._torch.train import EVENTS, Batch, DivergedError, EarlyStop, Settings, train
from methods._torch.weights import load_weights, read_tensors, save_weights

CPU = torch.device("cpu")


class Pool:
    """What was last seen, of a size that changes: a stand-in for a replay pool."""

    def __init__(self) -> None:
        self.held = torch.zeros(0, 4)

    def push(self, rows: torch.Tensor) -> None:
        self.held = torch.cat([self.held, rows])[-11:]

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {"held": self.held}

    def load_state_dict(self, state_dict: dict[str, torch.Tensor]) -> None:
        self.held = state_dict["held"]


class Adversaries:
    """Two networks with an optimiser each, random noise and a pool: everything a checkpoint has to bring back."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.data = torch.from_numpy(self.rng.normal(size=(37, 4))).float()
        with isolated_random(self.rng):
            self.maker = torch.nn.Sequential(torch.nn.Linear(4, 8), torch.nn.Tanh(), torch.nn.Linear(8, 4))
            self.judge = torch.nn.Sequential(torch.nn.Linear(4, 8), torch.nn.ReLU(), torch.nn.Linear(8, 1))
        self.pool = Pool()
        self.adam = torch.optim.Adam(self.maker.parameters(), lr=1e-2, betas=(0.5, 0.999))
        self.sgd = torch.optim.SGD(self.judge.parameters(), lr=1e-2, momentum=0.9)
        self.seen: list[np.ndarray] = []

    def step(self, batch: Batch) -> dict[str, torch.Tensor]:
        self.seen.append(batch.index)
        real = dropout(self.data[batch.index], 0.2, batch.generator)
        noise = torch.randn(real.shape, generator=batch.generator)
        made = self.maker(noise)
        making = (self.judge(made) - 1).square().mean()
        self.adam.zero_grad()
        making.backward()
        self.adam.step()
        self.pool.push(made.detach())
        judging = (self.judge(real) - 1).square().mean() + self.judge(self.pool.held).square().mean()
        self.sgd.zero_grad()
        judging.backward()
        self.sgd.step()
        return {"making": making.detach(), "judging": judging.detach()}

    def train(
        self, folder: Path | None, *, step: Callable | None = None, settings: Settings | None = None, **more: object
    ) -> list[dict[str, float]]:
        """Train, and give the rows of the history without the clock."""
        history = train(
            step or self.step,
            items=len(self.data),
            states={"maker": self.maker, "judge": self.judge, "pool": self.pool},
            optimizers={"adam": self.adam, "sgd": self.sgd},
            schedules={"adam": linear_decay(start=1, length=10)},
            settings=settings or Settings(epochs=6, batch=4, checkpoint_steps=3, rows=20),
            rng=self.rng,
            device=CPU,
            folder=folder,
            **more,  # type: ignore[arg-type]
        )
        return [{name: value for name, value in row.items() if name != "seconds"} for row in history.rows]

    @property
    def weights(self) -> list[bytes]:
        """Every number learned, as bytes."""
        tensors = [*self.maker.state_dict().values(), *self.judge.state_dict().values(), self.pool.held]
        return [tensor.numpy().tobytes() for tensor in tensors]


@pytest.fixture
def undisturbed() -> tuple[list[bytes], list[dict[str, float]]]:
    """Weights and history of a training that nothing interrupts and no checkpoint touches."""
    pair = Adversaries()
    rows = pair.train(None)
    return pair.weights, rows


def test_a_seed_gives_the_same_bits_and_another_seed_does_not(
    undisturbed: tuple[list[bytes], list[dict[str, float]]],
) -> None:
    again, other = Adversaries(), Adversaries(1)
    assert again.train(None) == undisturbed[1]
    assert again.weights == undisturbed[0]
    other.train(None)
    assert other.weights != undisturbed[0]


def test_every_item_is_seen_once_an_epoch_in_an_order_that_changes() -> None:
    pair = Adversaries()
    pair.train(None)
    epochs = np.split(np.concatenate(pair.seen), 6)
    for epoch in epochs:
        assert sorted(epoch) == list(range(37))
    assert not np.array_equal(epochs[0], epochs[1])


def test_checkpoints_change_nothing(tmp_path: Path, undisturbed: tuple[list[bytes], list[dict[str, float]]]) -> None:
    pair = Adversaries()
    assert pair.train(tmp_path) == undisturbed[1]
    assert pair.weights == undisturbed[0]
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["training.safetensors"]


@pytest.mark.parametrize("stop", [1, 3, 9, 10, 11, 25, 58])
def test_an_interrupted_training_ends_in_the_same_bits(
    tmp_path: Path, stop: int, undisturbed: tuple[list[bytes], list[dict[str, float]]]
) -> None:
    first = Adversaries()

    def interrupted(batch: Batch) -> dict[str, torch.Tensor]:
        if batch.step == stop:
            raise KeyboardInterrupt
        return first.step(batch)

    with pytest.raises(KeyboardInterrupt):
        first.train(tmp_path, step=interrupted)
    second = Adversaries()
    assert second.train(tmp_path) == undisturbed[1]
    assert second.weights == undisturbed[0]
    # It went on where the last checkpoint was: not from the start, and not past the interruption.
    assert len(second.seen) == 60 - 3 * (stop // 3)


def test_a_finished_training_is_not_repeated(tmp_path: Path) -> None:
    first, second = Adversaries(), Adversaries()
    rows = first.train(tmp_path)
    assert second.train(tmp_path) == rows
    assert second.weights == first.weights
    assert second.seen == []


_KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_train import Adversaries
from methods._torch.train import Settings
import torch
torch.set_num_threads(1)
pair = Adversaries()
def slow(batch):
    time.sleep(0.01)
    return pair.step(batch)
print("ready", flush=True)
pair.train(Path(sys.argv[2]), step=slow, settings=Settings(epochs=6, batch=4, checkpoint_steps=1, rows=20))
"""


def test_a_process_killed_at_random_moments_ends_in_the_same_bits(tmp_path: Path) -> None:
    plain = Adversaries()
    settings = Settings(epochs=6, batch=4, checkpoint_steps=1, rows=20)
    rows = plain.train(None, settings=settings)
    chance = random.Random(7)
    here = str(Path(__file__).parent)
    checkpoint = tmp_path / "training.safetensors"
    steps = []
    for _ in range(3):
        command = [sys.executable, "-c", _KILLED, here, str(tmp_path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, "OMP_NUM_THREADS": "1"}) as process:
            assert process.stdout is not None and process.stdout.readline() == b"ready\n"
            while not checkpoint.exists() and process.poll() is None:
                time.sleep(0.001)
            time.sleep(chance.uniform(0.0, 0.1))
            process.kill()
            process.wait()
        steps.append(read_tensors(checkpoint)[1]["at"]["step"])
    assert 0 < steps[0] < 60, "the process was not killed in the middle"
    last = Adversaries()
    assert last.train(tmp_path, settings=settings) == rows
    assert last.weights == plain.weights
    assert len(last.seen) == 60 - steps[-1]


def test_a_loss_that_is_not_finite_is_an_error_and_the_last_checkpoint_stays(tmp_path: Path) -> None:
    pair = Adversaries()

    def failing(batch: Batch) -> dict[str, torch.Tensor]:
        losses = pair.step(batch)
        return losses if batch.step < 13 else {**losses, "making": torch.tensor(float("nan"))}

    with pytest.raises(DivergedError, match=r"step 14: the loss 'making' is nan.*checkpoint of step 12 is kept"):
        pair.train(tmp_path, step=failing)
    good = Adversaries()
    good.train(tmp_path)
    assert len(good.seen) == 60 - 12
    reference = Adversaries()
    reference.train(None)
    assert good.weights == reference.weights


def test_a_loss_out_of_all_proportion_is_an_error() -> None:
    pair = Adversaries()
    with pytest.raises(DivergedError, match="the loss 'a' is 60001"):
        pair.train(None, step=lambda batch: {"a": 6.0 if batch.step < 5 else 60001.0})


def test_a_weight_that_is_not_finite_is_an_error_even_where_losses_look_well(tmp_path: Path) -> None:
    pair = Adversaries()

    def spoiling(batch: Batch) -> dict[str, float]:
        if batch.step == 4:
            with torch.no_grad():
                next(pair.judge.parameters())[0, 0] = float("inf")
        return {"a": 1.0}

    with pytest.raises(DivergedError, match=r"'judge/0.weight' is not finite; the checkpoint of step 3 is kept"):
        pair.train(tmp_path, step=spoiling)


def test_the_rate_follows_its_schedule_and_is_on_record() -> None:
    pair = Adversaries()
    rates: list[float] = []

    def watching(batch: Batch) -> dict[str, torch.Tensor]:
        rates.append(pair.adam.param_groups[0]["lr"])
        assert pair.sgd.param_groups[0]["lr"] == 1e-2
        return pair.step(batch)

    rows = pair.train(None, step=watching)
    expected = [1e-2 * (1.0 - max(step / 10 - 1.0, 0.0) / 10.0) for step in range(60)]
    np.testing.assert_allclose(rates, expected, rtol=1e-12)
    assert rows[-1]["lr/adam"] == rates[-1]


def test_rows_are_means_over_the_steps_since_the_row_before() -> None:
    pair = Adversaries()
    rows = pair.train(None, step=lambda batch: {"a": float(batch.step)})
    # 60 steps in about 20 rows: every third step, and at each epoch's end (every tenth).
    ends = sorted({*range(3, 61, 3), *range(10, 61, 10)})
    assert [row["step"] for row in rows] == ends
    starts = [0, *ends[:-1]]
    assert [row["a"] for row in rows] == [np.mean(range(a, b)) for a, b in zip(starts, ends, strict=True)]


def test_stopping_early_follows_the_rule_and_no_other() -> None:
    falling = [5.0, 4.0, 3.9, 3.85, 3.9, 2.0]

    def run(rule: EarlyStop | None) -> int:
        pair = Adversaries()
        values = iter(falling)
        pair.train(None, validate=lambda: {"held": next(values)}, settings=Settings(epochs=6, batch=4, stop=rule))
        return len(pair.seen) // 10

    assert run(None) == 6
    assert run(EarlyStop("held", patience=1)) == 5
    assert run(EarlyStop("held", patience=2)) == 6
    assert run(EarlyStop("held", patience=2, least=0.05)) == 4


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    Adversaries().train(tmp_path)
    with pytest.raises(StoreError, match="another seed or other settings: remove it"):
        Adversaries(1).train(tmp_path)
    with pytest.raises(StoreError, match="another seed or other settings: remove it"):
        Adversaries().train(tmp_path, settings=Settings(epochs=7, batch=4))


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    (tmp_path / "training.safetensors").write_bytes(b"not weights")
    with pytest.raises(StoreError, match="holds no weights of this suite"):
        Adversaries().train(tmp_path)


def test_nothing_to_train_on_is_an_error() -> None:
    with pytest.raises(ContractError, match="nothing to train on"):
        Adversaries().train(None, settings=Settings(epochs=0, batch=4))


def test_the_last_small_batch_is_left_out_where_asked() -> None:
    pair = Adversaries()
    pair.train(None, settings=Settings(epochs=2, batch=4, drop_last=True))
    assert [len(index) for index in pair.seen] == [4] * 18


def test_progress_is_reported_with_loss_pace_and_time_left() -> None:
    lines: list[tuple[float, str]] = []
    Adversaries().train(None, report=lambda fraction, message: lines.append((fraction, message)))
    assert [fraction for fraction, _ in lines] == [pytest.approx((i + 1) / 60) for i in range(60)]
    assert lines[-1][1].startswith("epoch 6/6, making ")
    assert lines[-1][1].endswith(" words/s, 0 s left")


def test_weights_come_back_and_other_networks_are_refused(tmp_path: Path) -> None:
    one, two = Adversaries(0), Adversaries(1)
    save_weights(tmp_path / "w.safetensors", {"maker": one.maker, "judge": one.judge}, {"rate": 0.5})
    assert load_weights(tmp_path / "w.safetensors", {"maker": two.maker, "judge": two.judge}) == {"rate": 0.5}
    assert one.weights == two.weights
    with pytest.raises(StoreError, match="of another network"):
        load_weights(tmp_path / "w.safetensors", {"maker": torch.nn.Linear(4, 8)})


def curve(folder: Path) -> list[tuple[int, float]]:
    """What TensorBoard shows of the loss ``making``."""
    loading = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    events = loading.EventAccumulator(str(folder))
    events.Reload()
    return [(event.step, event.value) for event in events.Scalars("making")]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("stop", [10, 11, 25])
def test_tensorboard_shows_each_step_once_whatever_interrupts(
    tmp_path: Path, stop: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("tensorboard")
    monkeypatch.setenv(TENSORBOARD, "1")
    first = Adversaries()

    def interrupted(batch: Batch) -> dict[str, torch.Tensor]:
        if batch.step == stop:
            raise KeyboardInterrupt
        return first.step(batch)

    with pytest.raises(KeyboardInterrupt):
        first.train(tmp_path, step=interrupted)
    rows = Adversaries().train(tmp_path)
    found = curve(tmp_path / EVENTS / "training")
    assert [step for step, _ in found] == [row["step"] for row in rows]
    assert [value for _, value in found] == pytest.approx([row["making"] for row in rows])
    # Another stage has steps of its own.
    Adversaries().train(tmp_path, name="second")
    assert curve(tmp_path / EVENTS / "training") == found == curve(tmp_path / EVENTS / "second")


def test_tensorboard_is_written_only_if_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for value in ("", "0"):
        monkeypatch.setenv(TENSORBOARD, value)
        Adversaries().train(tmp_path / value)
        assert not (tmp_path / value / EVENTS).exists()
    monkeypatch.setenv(TENSORBOARD, "1")
    monkeypatch.setattr("methods._torch.history.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"tensorboard is not installed: install it by .*\[tensorboard\]"):
        Adversaries().train(tmp_path / "asked")

"""The autoencoder, its hidden space, the constraints, and the method as a whole."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, figure, perform, small_view
from benchmark.errors import ConfigError, UnknownNameError
from benchmark.motion import quat
from benchmark.motion.canonical import foot_points
from benchmark.motion.clip import MotionClip
from benchmark.motion.kinematics import fk
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from methods.holden.channels import Layout, Scaling
from methods.holden.corpus import choose_examples
from methods.holden.descent import Constraints, descend, gram, style_objective
from methods.holden.exemplars import content, nearest
from methods.holden.method import Holden
from methods.holden.network import Autoencoder, random_unpool, unpool


def _random(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@cache
def _fitted() -> Holden:
    method = Holden(preset="smoke", epochs=40)
    return method.fit(small_view(), _task(), rng=np.random.default_rng(1), ctx=FitContext())


def _task() -> StyleTask:
    return StyleTask(ADULT, CHILD, perform("walk", CHILD, 1).skeleton)


def _transfer(method: Holden, source: MotionClip) -> MotionClip:
    return method.transfer(source, _task(), rng=np.random.default_rng(2)).clip


# The network


def test_unpooling_shares_values_evenly_and_its_random_twin_does_on_average() -> None:
    hidden = _random(0, 2, 3, 5)
    even = unpool(hidden)
    assert even.shape == (2, 3, 10)
    torch.testing.assert_close(even[..., 0::2], hidden / 2)
    torch.testing.assert_close(even[..., 1::2], hidden / 2)
    drawn = [random_unpool(hidden, torch.Generator().manual_seed(seed)) for seed in range(2000)]
    for one in drawn[:20]:
        torch.testing.assert_close(one[..., 0::2] + one[..., 1::2], hidden)
        assert bool((one[..., 0::2] * one[..., 1::2] == 0).all())
    torch.testing.assert_close(torch.stack(drawn).mean(0), even, atol=0.15, rtol=0)


def test_the_encoder_halves_time_and_the_decoder_brings_it_back() -> None:
    network = Autoencoder(7, 5, 9).double()
    x = _random(1, 2, 7, 24)
    hidden = network.encode(x)
    assert hidden.shape == (2, 5, 12) and bool((hidden >= 0).all())
    assert network.decode(hidden).shape == x.shape
    # Against the definition: correlation, bias, rectification, the larger of each pair of frames.
    padded = torch.nn.functional.pad(x, (4, 4))
    frames = [torch.einsum("ncw,fcw->nf", padded[..., t : t + 9], network.encoder.weight) for t in range(24)]
    bias = network.encoder.bias
    assert bias is not None
    every = torch.stack(frames, dim=-1) + bias[:, None]
    expected = torch.clamp(every, min=0)
    torch.testing.assert_close(hidden, torch.maximum(expected[..., 0::2], expected[..., 1::2]))


def test_training_is_noisy_and_evaluation_is_not() -> None:
    network = Autoencoder(4, 6, 5).double()
    x, valid = _random(2, 3, 4, 20), torch.ones(3, 20, dtype=torch.bool)
    losses = [
        float(network.loss(x, valid, share=0.25, sparsity=0.0, generator=torch.Generator().manual_seed(seed)).detach())
        for seed in (1, 1, 2)
    ]
    assert losses[0] == losses[1] != losses[2]
    assert torch.equal(network.decode(network.encode(x)), network.decode(network.encode(x)))


def test_sparsity_is_the_mean_magnitude_of_the_weights_and_padding_does_not_count() -> None:
    network = Autoencoder(4, 6, 5).double()
    x, valid = _random(2, 3, 4, 24), torch.ones(3, 24, dtype=torch.bool)
    valid[:, 15:] = False

    def loss(sparsity: float, x: torch.Tensor = x) -> torch.Tensor:
        return network.loss(x, valid, share=0.0, sparsity=sparsity, generator=torch.Generator().manual_seed(0)).detach()

    weights = 0.5 * (network.encoder.weight.abs().mean() + network.decoder.weight.abs().mean())
    torch.testing.assert_close(loss(0.1) - loss(0.0), 0.1 * weights.detach())
    far = x.clone()
    far[..., 23] += 5.0  # out of the filters' reach of the frames that count
    torch.testing.assert_close(loss(0.0, far), loss(0.0))


def test_the_loss_falls_in_training() -> None:
    losses = _fitted().history_.column("loss")
    assert np.mean(losses[-5:]) < 0.7 * losses[0]


def test_the_autoencoder_gives_back_motion_better_than_the_mean_pose_does() -> None:
    method = _fitted()
    values = method.scaling_.apply(method.layout_.encode(retarget(perform("walk", ADULT, 3, fps=30.0), method.body_)))
    with torch.no_grad():
        back = method._cropped(method.network_.decode(method.network_.encode(method._padded(values))), len(values))
    positions = method.layout_.positions
    error = np.mean((back - values)[:, positions] ** 2)
    assert error < 0.5 * np.mean(values[:, positions] ** 2)


# The hidden space


def test_gram_matrices_are_means_over_time() -> None:
    hidden = _random(3, 2, 4, 9)
    expected = torch.stack([torch.stack([torch.outer(h, h) for h in one.T]).mean(0) for one in hidden])
    torch.testing.assert_close(gram(hidden), expected)
    torch.testing.assert_close(gram(torch.cat([hidden, hidden], dim=-1)), expected)
    torch.testing.assert_close(
        gram(hidden[..., torch.randperm(9, generator=torch.Generator().manual_seed(0))]), expected
    )


def test_the_objective_is_zero_where_style_and_content_are_met_and_its_gradient_is_right() -> None:
    content_, style = _random(4, 1, 3, 6), gram(_random(5, 1, 3, 8))
    weights: dict[str, Any] = {"style_weight": 2.0, "content_weight": 1.0}
    assert float(style_objective(content_, content_, gram(content_), **weights)) == 0.0
    by_hand = (2.0 * (gram(content_) - style).square().mean() + 0.0) / 3.0
    torch.testing.assert_close(style_objective(content_, content_, style, **weights), by_hand)
    hidden = _random(6, 1, 3, 6).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda h: style_objective(h, content_, style, inner=slice(1, 5), **weights), hidden)


def test_padding_has_no_say_in_the_style() -> None:
    hidden, style = _random(7, 1, 3, 10), gram(_random(5, 1, 3, 8))
    padded = torch.nn.functional.pad(hidden, (2, 2), value=9.0)
    weights: dict[str, Any] = {"style_weight": 1.0, "content_weight": 0.0}
    torch.testing.assert_close(
        style_objective(padded, padded, style, inner=slice(2, 12), **weights),
        style_objective(hidden, hidden, style, **weights),
    )


def test_a_descent_never_ends_above_where_it_began() -> None:
    start = torch.tensor([0.1])
    # Steps of 1 in a valley this narrow only jump over it.
    assert torch.equal(descend(lambda h: 100.0 * h.square().sum(), start, iterations=1, step=5.0), start)
    low = descend(lambda h: (h - 3.0).square().sum(), start, iterations=400, step=0.05)
    torch.testing.assert_close(low, torch.tensor([3.0]), atol=1e-2, rtol=0)
    assert torch.equal(start, torch.tensor([0.1]))


# Channels and constraints


def _constraints(clip: MotionClip, layout: Layout) -> tuple[Constraints, torch.Tensor]:
    values = torch.from_numpy(layout.encode(clip)).T[None]
    skeleton = clip.skeleton
    return (
        Constraints(
            parents=torch.as_tensor(np.array(skeleton.parents)),
            lengths=torch.as_tensor(skeleton.bone_lengths / skeleton.leg_length),
            feet=torch.as_tensor(layout.feet),
            contacts=values[:, layout.contacts],
            velocity=values[:, layout.velocity],
            fps=clip.fps,
        ),
        values,
    )


def _turning(clip: MotionClip, rate: float) -> MotionClip:
    """The clip carried along a circle, turning by ``rate`` radians per second."""
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], rate * clip.times)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root + [0.5, 0.0, 0.0]))


@pytest.mark.parametrize("rate", [0.0, 1.3, -2.0])
def test_foot_steps_are_what_forward_kinematics_says_also_in_a_turn(rate: float) -> None:
    clip = _turning(perform("walk", ADULT, 3), rate)
    layout = Layout.of(clip.skeleton)
    constraints, values = _constraints(clip, layout)
    steps = constraints.foot_steps(values)[0].permute(2, 0, 1).numpy()
    world = np.diff(clip.positions[:, layout.feet], axis=0) / clip.skeleton.leg_length
    np.testing.assert_allclose(np.linalg.norm(steps, axis=-1), np.linalg.norm(world, axis=-1), atol=1e-9)


def test_real_motion_meets_the_constraints_of_bones_and_trajectory() -> None:
    clip = perform("walk", ADULT, 3)
    constraints, values = _constraints(clip, Layout.of(clip.skeleton))
    assert float(constraints.bones(values)) < 1e-20
    assert float(constraints.trajectory(values)) == 0.0


def test_feet_that_stand_while_the_body_turns_over_them_do_not_slide() -> None:
    """A wrong sign of the turn would double the foot's motion in the heading frame instead of cancelling it."""
    still = perform("wave", ADULT, 3)
    frozen = still.replace(
        rotations=np.repeat(still.rotations[:1], 60, axis=0), root=np.repeat(still.root[:1], 60, axis=0)
    )
    layout = Layout.of(still.skeleton)
    angle = 1.5 * np.arange(60) / 60.0
    # The channels of a body that turns on the spot over feet that stay: positions turn the other way.
    positions = frozen.positions - frozen.root[:, None] * [1.0, 0.0, 1.0]
    local = (
        quat.inv_rotate(quat.from_axis_angle([0.0, 1.0, 0.0], angle)[:, None], positions) / still.skeleton.leg_length
    )
    values = layout.encode(frozen)
    values[:, layout.positions] = local.reshape(60, -1)
    values[:, layout.velocity] = [0.0, 0.0, 1.5]
    constraints, _ = _constraints(frozen, layout)
    turning = Constraints(
        constraints.parents,
        constraints.lengths,
        constraints.feet,
        torch.ones_like(constraints.contacts),
        torch.from_numpy(values[:, layout.velocity]).T[None],
        60.0,
    )
    there = torch.from_numpy(values).T[None]
    assert float(turning.foot_sliding(there)) < 1e-20
    wrong = Constraints(
        turning.parents, turning.lengths, turning.feet, turning.contacts, -turning.velocity, turning.fps
    )
    assert float(wrong.foot_sliding(there)) > 1e-6


def test_feet_below_the_floor_count() -> None:
    clip = perform("walk", ADULT, 3)
    layout = Layout.of(clip.skeleton)
    constraints, values = _constraints(clip, layout)
    sunk = values.clone()
    sunk[:, 1 : 3 * len(clip.skeleton) : 3] -= 1.0
    before, after = constraints.foot_sliding(values), constraints.foot_sliding(sunk)
    depth = torch.clamp(constraints.positions(sunk)[:, constraints.feet, 1], max=0.0).square().mean()
    torch.testing.assert_close(after - before, depth)
    assert float(depth) > 0.5


@pytest.mark.parametrize("term", ["bones", "trajectory", "foot_sliding"])
def test_descent_on_hidden_units_lowers_each_constraint(term: str) -> None:
    method = _fitted()
    clip = retarget(perform("walk", ADULT, 3, fps=30.0), method.body_).frames(0, 60)
    exact, values = _constraints(clip, method.layout_)
    constraints = replace(
        exact,
        lengths=exact.lengths.float(),
        contacts=exact.contacts.float(),
        velocity=exact.velocity.float(),
        weights=(float(term == "bones"), float(term == "trajectory"), float(term == "foot_sliding")),
    )
    scale, mean = (torch.from_numpy(part).float()[:, None] for part in (method.scaling_.scale, method.scaling_.offset))

    def objective(hidden: torch.Tensor) -> torch.Tensor:
        return constraints.objective(method.network_.decode(hidden) * scale + mean)

    start = method.network_.encode((values.float() - mean) / scale)
    end = descend(objective, start, iterations=80, step=0.01)
    assert float(objective(end)) < 0.8 * float(objective(start))


def test_results_meet_the_constraints_better_than_without_the_projection() -> None:
    method, source = _fitted(), perform("walk", ADULT, 3)
    free = copy(method)
    free.settings_ = {**method.settings_, "constraint_iterations": 0}
    values = method.scaling_.apply(method.layout_.encode(retarget(resample(source, 30.0), method.body_)))
    numbers, _ = choose_examples(method.examples_, source, method.settings_["exemplars"])
    examples = [method.examples_[number] for number in numbers]
    clip = retarget(perform("walk", ADULT, 3, fps=30.0), method.body_)
    constraints, _ = _constraints(clip, method.layout_)
    found = []
    for one in (free, method):
        drawn, ratio = one._stylised(values, examples)
        here = torch.from_numpy(method.scaling_.invert(drawn)).T[None]
        speed = constraints.velocity * torch.tensor([ratio, ratio, 1.0])[:, None]
        found.append(float(replace(constraints, velocity=speed).objective(here)))
    assert found[1] < 0.5 * found[0]


def test_channels_come_back_as_the_clip() -> None:
    clip = perform("walk", CHILD, 3)
    layout = Layout.of(clip.skeleton)
    values = layout.encode(clip)
    assert values.shape == (len(clip), layout.dim) == (len(clip), 3 * len(clip.skeleton) + 3 + 4)
    back = layout.decode(values, clip)
    np.testing.assert_allclose(back.positions, clip.positions, atol=1e-6)


def test_channels_know_nothing_of_place_direction_and_size() -> None:
    clip = perform("walk", CHILD, 3)
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 2.0)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [3.0, 0.0, -2.0])
    layout = Layout.of(clip.skeleton)
    np.testing.assert_allclose(layout.encode(moved), layout.encode(clip), atol=1e-9)
    small = figure(0.5, trunk=0.38, head=0.22, arm=0.36)
    half = MotionClip(small, quat.identity(5, len(small)), np.tile([0.0, 0.55, 0.0], (5, 1)), 60.0)
    rest = fk(small, half.rotations, half.root)[1][0] - [0.0, 0.0, 0.0]
    np.testing.assert_allclose(
        Layout.of(small).encode(half)[0, : 3 * len(small)], rest.ravel() / small.leg_length, atol=1e-12
    )


def test_scaling_is_one_deviation_for_all_positions_and_contacts_are_one_or_minus_one() -> None:
    clips = [perform("walk", CHILD, take) for take in (1, 2)]
    layout = Layout.of(clips[0].skeleton)
    arrays = [layout.encode(retarget(clip, clips[0].skeleton)) for clip in clips]
    scaling = Scaling.fit(layout, arrays)
    others = [j for j in range(len(layout.skeleton)) if j not in layout.feet]
    body = scaling.scale[layout.positions].reshape(-1, 3)
    assert len(np.unique(body[others])) == 1
    np.testing.assert_allclose(body[layout.feet], np.full((4, 3), 0.9 * body[others[0], 0]))
    values = scaling.apply(arrays[0])
    assert set(np.unique(values[:, layout.contacts])) <= {-1.0, 1.0}
    np.testing.assert_allclose(scaling.offset[layout.velocity], 0.0)
    np.testing.assert_allclose(scaling.invert(values), arrays[0], atol=1e-12)


# The method


def test_exemplars_are_the_nearest_in_content() -> None:
    candidates = [content(perform(action, CHILD, take)) for action in ("wave", "walk") for take in (1, 2)]
    found = nearest(content(perform("walk", ADULT, 3)), candidates, 3)
    assert {index for index, _ in found[:2]} == {2, 3}
    assert found[0][1] <= found[1][1] <= found[2][1]
    assert nearest(candidates[1], candidates, 1) == [(1, 0.0)]


def test_a_result_is_nearer_to_the_style_than_its_source() -> None:
    method = _fitted()
    source = perform("walk", ADULT, 3)
    before = retarget(source, method.body_)
    after = _transfer(method, source)
    layout = method.layout_
    goal = np.mean(
        [layout.encode(retarget(clip, method.body_)).std(axis=0) for clip in small_view().clips(CHILD, action="walk")],
        axis=0,
    )[layout.positions]

    def gap(clip: MotionClip) -> float:
        return float(np.linalg.norm(layout.encode(clip).std(axis=0)[layout.positions] - goal))

    assert gap(after) < 0.9 * gap(before)


def test_without_style_and_constraints_the_source_comes_back() -> None:
    method = Holden(preset="smoke", iterations=0, constraint_iterations=0)
    method.fit(small_view(), _task(), rng=np.random.default_rng(1), ctx=FitContext())
    source = perform("walk", ADULT, 3)
    expected = retarget(source, method.body_)
    result = method.transfer(source, _task(), rng=np.random.default_rng(2))
    assert result.diagnostics["speed_ratio"] == pytest.approx(1.0)
    np.testing.assert_allclose(result.clip.positions, expected.positions, atol=1e-4)


@pytest.mark.parametrize("frames", [2, 3, 31, 200])
@pytest.mark.parametrize("fps", [24.0, 60.0, 120.0])
def test_clips_of_any_length_and_rate_keep_both(frames: int, fps: float) -> None:
    whole = perform("walk", ADULT, 3, fps=fps)
    source = whole.frames(0, frames)
    result = _transfer(_fitted(), source)
    assert len(result) == len(source) and result.fps == fps


def test_the_rate_of_a_clip_hardly_matters() -> None:
    fast = _transfer(_fitted(), perform("walk", ADULT, 3, fps=120.0))
    slow = _transfer(_fitted(), resample(perform("walk", ADULT, 3, fps=120.0), 60.0))
    gap = np.linalg.norm(fast.positions[::2][: len(slow)] - slow.positions, axis=-1)
    assert gap.mean() < 0.02 * fast.skeleton.leg_length


def test_feet_stay_near_the_floor() -> None:
    result = _transfer(_fitted(), perform("walk", ADULT, 3))
    lowest = foot_points(result)[..., 1].min(axis=1)
    assert np.abs(lowest).max() < 0.05 * result.skeleton.leg_length


def test_an_action_without_examples_takes_the_style_of_another_and_says_so() -> None:
    result = _fitted().transfer(perform("jump", ADULT, 3), _task(), rng=np.random.default_rng(0))
    assert result.diagnostics["action_in_training"] is False
    known = _fitted().transfer(perform("walk", ADULT, 3), _task(), rng=np.random.default_rng(0))
    assert known.diagnostics["action_in_training"] is True


def test_a_saved_method_has_its_loss_curve_beside_it_and_its_settings_in_it(tmp_path: Path) -> None:
    import pyarrow.parquet as parquet

    method = _fitted()
    method.save(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"holden.safetensors", "body.npz", "train.parquet"}
    assert parquet.read_table(tmp_path / "train.parquet")["loss"].to_pylist() == method.history_.column("loss")
    loaded = Holden.load(tmp_path)
    assert loaded.settings_ == method.settings_ and loaded.settings_["epochs"] == 40
    source = perform("walk", ADULT, 3)
    np.testing.assert_array_equal(_transfer(loaded, source).rotations, _transfer(method, source).rotations)


def test_a_fit_that_was_interrupted_ends_in_the_same_weights(tmp_path: Path) -> None:
    """The checkpoint is in the folder that the runner offers, and what it holds is all that matters."""

    class _StoppedError(Exception):
        pass

    def stop(fraction: float, message: str) -> None:
        if fraction >= 0.5:
            raise _StoppedError

    def fit(**context: object) -> Holden:
        method = Holden(preset="smoke", epochs=4)
        return method.fit(small_view(), _task(), rng=np.random.default_rng(1), ctx=FitContext(**context))  # type: ignore[arg-type]

    with pytest.raises(_StoppedError):
        fit(work_dir=tmp_path, report=stop)
    plain, resumed = fit(), fit(work_dir=tmp_path)
    for name, value in plain.network_.state_dict().items():
        assert torch.equal(value, resumed.network_.state_dict()[name])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width": 8}, "width must be odd"),
        ({"start": "middle"}, "start must be 'content' or 'noise'"),
        ({"dropout": 1.0}, "dropout must be at least 0 and below 1"),
        ({"lr": 0.0}, "lr must be above 0"),
        ({"iterations": -1}, "iterations must not be negative"),
        ({"style_weight": 0.0, "content_weight": 0.0}, "are both 0"),
        ({"fps": "fast"}, "fps must be a float"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Holden(preset="smoke", **settings).fit(small_view(), _task(), rng=np.random.default_rng(1), ctx=FitContext())


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'paper'"):
        Holden(preset="papers").fit(small_view(), _task(), rng=np.random.default_rng(1), ctx=FitContext())

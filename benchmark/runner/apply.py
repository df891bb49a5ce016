"""A fitted method of a run, applied to a clip from outside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmark.api import Method, StyleTask
from benchmark.errors import BenchmarkError, ConfigError, ContractError, SkeletonError, StoreError, UnknownNameError
from benchmark.motion.clip import MotionClip
from benchmark.registry import METHODS, Registry
from benchmark.runner.contract import check_result
from benchmark.runner.execute import MODEL, TARGET
from benchmark.runner.plan import Cell
from benchmark.runner.run import read_run
from benchmark.runner.selection import load_method
from benchmark.runner.store import RunStore
from benchmark.seeding import generator


def apply_method(
    folder: Path,
    method: str,
    loaded: MotionClip,
    prepare: Callable[[MotionClip, float], MotionClip],
    *,
    task: str | None = None,
    repetition: int = 0,
    seed: int = 0,
    name: str = "the clip",
    methods: Registry = METHODS,
) -> MotionClip:
    """Load the model that a run stored and transfer one clip with it.

    Parameters
    ----------
    folder
        The run folder.
    method
        The method as the run's tables call it.
    loaded
        The clip as it was read.
    prepare
        Given that and the run's frame rate, returns the clip in the suite's conventions.
    task
        Needed where the run has several.
    repetition
        Which repetition's model.
    seed
        For methods that draw random numbers.
    name
        What messages call the clip.

    Raises
    ------
    StoreError
        If the run has no finished cell for that.
    ConfigError
        If the method needs a reference, which a clip from outside does not have.
    SkeletonError
        If the clip lacks a joint role that the method needs.
    """
    from benchmark.motion import npz

    cell = find_cell(folder, method, task, repetition)
    place = RunStore(folder).cell(cell.key)
    cls = load_method(methods, cell.name)
    needs = cls.info.capabilities
    if needs.uses_reference:
        raise ConfigError(
            f"{method} shows real target clips of the test clips, and {name} has none: choose another method"
        )
    rest = npz.load(place / TARGET)
    lacking = [role for role in needs.required_roles if not loaded.skeleton.has(role)]
    if lacking:
        joints = ", ".join(loaded.skeleton.names)
        raise SkeletonError(
            f"{name}: {method} needs joints in the roles {', '.join(lacking)}, which were not recognised among {joints}; "
            "name them with --role-map"
        )
    clip = prepare(loaded, rest.fps)
    if len(clip) < needs.min_frames:
        raise ConfigError(
            f"{name} has {len(clip)} frames at {clip.fps:g} per second; {method} needs {needs.min_frames}"
        )
    source_style, target_style = cell.styles
    style_task = StyleTask(source_style, target_style, rest.skeleton)
    fitted = load_model(cls, place / MODEL)
    result = fitted.transfer(clip, style_task, rng=generator(seed=seed, stage="transfer", clip=name))
    return check_result(result, clip, style_task, needs).clip


def load_model(cls: type[Method], folder: Path) -> Method:
    """The method that was saved in ``folder``.

    Raises
    ------
    StoreError
        If the files there are not those of such a model: cut short, altered, or of another kind, such as pickles.
    ContractError
        If ``load`` returns something else.
    """
    try:
        fitted = cls.load(folder)
    except BenchmarkError as error:
        raise StoreError(f"the model in {folder} cannot be read: {error}") from error
    except (OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise StoreError(
            f"{folder} holds no model of {cls.__name__} ({type(error).__name__}: {error}): models are JSON, npz and "
            "safetensors, never pickles; restore its files, or run the cell again"
        ) from error
    if not isinstance(fitted, cls):
        raise ContractError(f"{cls.__name__}.load must return a {cls.__name__}, not {type(fitted).__name__}")
    return fitted


def find_cell(folder: Path, method: str, task: str | None, repetition: int) -> Cell:
    """The finished cell of a method in a run; the errors of :func:`apply_method` where there is none."""
    _, cells = read_run(folder)
    labels = list(dict.fromkeys(cell.method for cell in cells))
    if method not in labels:
        raise UnknownNameError(f"method of {folder}", method, labels)
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    if task is None and len(tasks) > 1:
        raise ConfigError(f"{folder} has the tasks {', '.join(tasks)}: choose one with --task")
    if task is not None and task not in tasks:
        raise UnknownNameError(f"task of {folder}", task, tasks)
    of_method = [cell for cell in cells if cell.method == method and cell.task == (task or tasks[0])]
    repetitions = {cell.repetition: cell for cell in of_method}
    if repetition not in repetitions:
        raise ConfigError(
            f"{method} has the repetitions {', '.join(map(str, repetitions))} in {folder}, not {repetition}"
        )
    cell = repetitions[repetition]
    status = RunStore(folder).status(cell.key)
    if status.state != "ok":
        raise StoreError(
            f"{method} has no model in {folder}: its cell is {status.state} ({status.reason or cell.reason})"
        )
    return cell

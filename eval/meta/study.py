"""The whole check: performances of the generated data set, probes, every corruption in processes of its own, and verdicts."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from benchmark.api import FitContext, Metric, MetricInfo, NotApplicableError, Probe, StyleTask
from benchmark.errors import ConfigError, DataError, UnknownNameError
from benchmark.motion.clip import MotionClip
from benchmark.motion.retarget import retarget
from benchmark.registry import METRICS, PROBES, Registry, load_target
from benchmark.seeding import generator
from eval.meta.cases import Case
from eval.meta.check import Value, evaluate, table
from eval.meta.corruptions import CORRUPTIONS, Corruption
from eval.meta.expectations import Expectation, expected, verdict
from eval.meta.ordering import Ordering, order_all

if TYPE_CHECKING:
    from collections.abc import Iterator

    from benchmark.data.splits import Split
    from benchmark.data.synthetic.dataset import SyntheticDataset

SOURCE, TARGET = "adult", "child"

#: Called with a unit of work, the fraction of it that is done, and what is being done.
Progress = Callable[[str, float, str], None]


@dataclass(frozen=True)
class Setup:
    """What a process needs to build the same cases: small and picklable.

    Attributes
    ----------
    clip_ids
        The source clips, in order.
    metrics
        Name to ``"module:Class"``.
    probes
        Name of each fitted probe to ``("module:Class", folder)``.
    seed
        Of corruptions and capture noise.
    """

    clip_ids: tuple[str, ...]
    metrics: Mapping[str, str]
    probes: Mapping[str, tuple[str, str]]
    seed: int


@dataclass(frozen=True)
class Study:
    """What came of a check.

    Attributes
    ----------
    metrics
        Of every metric that was checked, in the order of the registry.
    corruptions
        Every corruption that was tried.
    orderings
        What each metric made of each corruption.
    values
        The numbers behind it.
    clips, seed
        How many performances, and the seed.
    left_out
        Metrics that could not be checked, and why.
    """

    metrics: Mapping[str, MetricInfo]
    corruptions: tuple[Corruption, ...]
    orderings: Mapping[tuple[str, str], Ordering]
    values: tuple[Value, ...]
    clips: int
    seed: int
    left_out: Mapping[str, str]

    def expectation(self, metric: str, corruption: str) -> Expectation:
        """What is declared."""
        return expected(metric, corruption)

    def holds(self, metric: str, corruption: str) -> bool | None:
        """Whether the metric does what is declared; ``None`` where nothing is."""
        return verdict(self.expectation(metric, corruption), self.orderings[metric, corruption])

    def verdicts(self) -> tuple[int, int]:
        """How many declared expectations hold, and how many do not."""
        found = [self.holds(*pair) for pair in self.orderings]
        return found.count(True), found.count(False)

    def surprises(self) -> list[tuple[str, str, str, str]]:
        """``(metric, corruption, expected, observed)`` wherever an expectation does not hold."""
        return [
            (metric, corruption, self.expectation(metric, corruption).word, self.orderings[metric, corruption].observed)
            for metric in self.metrics
            for corruption in (entry.name for entry in self.corruptions)
            if self.holds(metric, corruption) is False
        ]


def choose_corruptions(names: Sequence[str]) -> tuple[Corruption, ...]:
    """The corruptions of these names, or all; :class:`~benchmark.errors.UnknownNameError` suggests the nearest."""
    known = {corruption.name: corruption for corruption in CORRUPTIONS}
    for name in names:
        if name not in known:
            raise UnknownNameError("corruption", name, known)
    return tuple(known[name] for name in names) or CORRUPTIONS


def run_study(
    metrics: Sequence[str],
    *,
    corruptions: Sequence[str] = (),
    dataset: str = "synthetic",
    clips: int = 20,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = lambda unit, fraction, message: None,
    registry: Registry = METRICS,
    probes: Registry = PROBES,
) -> Study:
    """Check metrics.

    Parameters
    ----------
    metrics
        Names or patterns.
    corruptions
        Names; all if there are none.
    dataset
        A data set that can perform a clip's content in any style: ``synthetic``.
    clips
        How many performances, spread over the actions.
    seed
        Of corruptions, capture noise, probes and bootstrap.
    jobs
        Processes; 1 works in this one.
    progress
        Called with a unit of work, the fraction of it that is done, and a message.
    registry, probes
        Where metrics and probes are found.
    """
    if dataset != "synthetic":
        raise DataError(
            f"{dataset!r} has no true performances in every degree of style; metrics are checked on 'synthetic'"
        )
    tried = choose_corruptions(corruptions)
    names = list(dict.fromkeys(name for pattern in metrics for name in registry.select(pattern)))
    if not names:
        raise ConfigError("there is no metric to check")
    chosen = {name: _metric(registry, name) for name in names}
    with tempfile.TemporaryDirectory(prefix="metrics-check-") as folder:
        needed = sorted({metric.info.probe for metric in chosen.values()} - {""})
        fitted, missing = fit_probes(needed, probes, Path(folder), seed=seed, jobs=jobs, progress=progress)
        left_out = {name: missing[metric.info.probe] for name, metric in chosen.items() if metric.info.probe in missing}
        used = {name: metric for name, metric in chosen.items() if name not in left_out}
        # A metric that lives in this process only cannot be found by another.
        local = any(registry.entry(name).value is not None for name in used)
        local |= any(probes.entry(name).value is not None for name in fitted)
        targets = {name: registry.entry(name).target for name in used}
        setup = Setup(choose_clips(clips), targets, fitted, seed)
        values = _work(setup, tried, used, 1 if local else jobs, progress)
    found = table(values, tried)
    infos = {name: metric.info for name, metric in used.items()}
    orderings = order_all(found, infos, clips=len(setup.clip_ids), seed=seed)
    return Study(infos, tried, orderings, tuple(values), len(setup.clip_ids), seed, left_out)


def _metric(registry: Registry, name: str) -> Metric:
    found = registry.get(name)
    metric: Metric = found() if isinstance(found, type) else found
    return metric


def choose_clips(count: int) -> tuple[str, ...]:
    """Ids of ``count`` source clips that are outside training, spread over the actions, of unseen performers first."""
    from benchmark.data.views import eval_items

    dataset, split = _data()
    items = eval_items(dataset, split, SOURCE, TARGET)
    turns: dict[str, list[str]] = {}
    for item in sorted(items, key=lambda item: (item.seen_actor, item.record.clip_id)):
        if item.reference_ids:
            turns.setdefault(item.record.action, []).append(item.record.clip_id)
    if sum(map(len, turns.values())) < count:
        raise ConfigError(f"there are {sum(map(len, turns.values()))} clips to check with, not {count}")
    chosen: list[str] = []
    while len(chosen) < count:
        for action in sorted(turns):
            if turns[action] and len(chosen) < count:
                chosen.append(turns[action].pop(0))
    return tuple(chosen)


def fit_probes(
    names: Sequence[str],
    registry: Registry,
    folder: Path,
    *,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = lambda unit, fraction, message: None,
) -> tuple[dict[str, tuple[str, str]], dict[str, str]]:
    """Fit probes on the training clips and store them: target and folder of each, and why others cannot be had."""
    missing = {name: f"there is no probe {name!r}" for name in names if name not in registry}
    stored: dict[str, tuple[str, str]] = {}
    found = {name: registry.entry(name) for name in names if name not in missing}
    work = {name: (entry.target, str(folder / name)) for name, entry in found.items()}
    if jobs == 1 or any(entry.value is not None for entry in found.values()):
        reasons = {}
        for name, (_, place) in work.items():
            reasons[name] = _fit(registry.get(name), name, place, seed, partial(progress, f"probe {name}"))
            progress(f"probe {name}", 1.0, "fitted")
    else:
        reasons = _fit_apart(work, seed, jobs, progress)
    for name, reason in reasons.items():
        if reason is None:
            stored[name] = work[name]
        else:
            missing[name] = f"probe {name}: {reason}"
    return stored, missing


def _fit_apart(work: Mapping[str, tuple[str, str]], seed: int, jobs: int, progress: Progress) -> dict[str, str | None]:
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    reasons: dict[str, str | None] = {}
    if not work:
        return reasons
    with _one_thread_each(), ProcessPoolExecutor(min(jobs, len(work)), get_context("spawn")) as pool:
        futures = {pool.submit(_fit_target, name, target, place, seed): name for name, (target, place) in work.items()}
        for future in as_completed(futures):
            reasons[futures[future]] = future.result()
            progress(f"probe {futures[future]}", 1.0, "fitted")
    return {name: reasons[name] for name in work}


def _fit_target(name: str, target: str, place: str, seed: int) -> str | None:
    return _fit(load_target(target, f"probe {name!r}"), name, place, seed, lambda fraction, message: None)


def _fit(probe: type[Probe], name: str, place: str, seed: int, report: Callable[[float, str], None]) -> str | None:
    """Fit a probe and store it in ``place``; the reason if there is nothing to learn from."""
    from benchmark.data.views import target_skeleton, train_view

    dataset, split = _data()
    task = StyleTask(SOURCE, TARGET, target_skeleton(dataset, split, TARGET))
    try:
        fitted = probe().fit(
            train_view(dataset, split, SOURCE, TARGET),
            task,
            rng=generator(seed=seed, probe=name),
            ctx=FitContext(report=report),
        )
    except NotApplicableError as reason:
        return str(reason)
    fitted.save(Path(place))
    return None


def make_cases(setup: Setup) -> list[Case]:
    """The performances to corrupt, captured as real clips are, with everything that is known of them."""
    from benchmark.data.synthetic.styles import StyleParameters, style_parameters
    from benchmark.data.views import eval_items, target_skeleton

    dataset, split = _data()
    items = {item.record.clip_id: item for item in eval_items(dataset, split, SOURCE, TARGET)}
    skeleton = target_skeleton(dataset, split, TARGET)
    task = StyleTask(SOURCE, TARGET, skeleton)
    probes = {
        name: load_target(target, f"probe {name!r}").load(Path(at)) for name, (target, at) in setup.probes.items()
    }
    cases = []
    for clip_id in setup.clip_ids:
        item, source = items[clip_id], dataset.load(clip_id)
        truth = dataset.truth(clip_id, TARGET, skeleton)
        own, average = dataset.parameters(item.record.actor), style_parameters(TARGET)

        def blend(
            share: float, clip_id: str = clip_id, own: StyleParameters = own, average: StyleParameters = average
        ) -> MotionClip:
            between = {
                name: (1.0 - share) * value + share * getattr(own, name) for name, value in vars(average).items()
            }
            performed = dataset.truth(clip_id, TARGET, skeleton, parameters=replace(average, **between))
            return captured(performed, clip_id, setup.seed)

        cases.append(
            Case(
                name=clip_id,
                actor=item.record.actor,
                action=item.record.action,
                source=source,
                truth=truth,
                performance=captured(truth, clip_id, setup.seed),
                references=tuple(dataset.load(name) for name in item.reference_ids),
                adult=retarget(source, skeleton),
                blend=blend,
                task=task,
                probes=probes,
            )
        )
    return cases


def captured(clip: MotionClip, name: str, seed: int) -> MotionClip:
    """``clip`` with the noise of a capture, as the real clips it is compared with have it."""
    from benchmark.data.synthetic.perform import CAPTURE_FPS, capture_noise
    from benchmark.motion.resample import resample

    rng = np.random.default_rng([seed, crc32(name.encode())])
    return resample(capture_noise(resample(clip, CAPTURE_FPS), rng), clip.fps)


def _data() -> tuple[SyntheticDataset, Split]:
    from benchmark.data.splits import make_split
    from benchmark.data.synthetic.dataset import SyntheticDataset

    dataset = SyntheticDataset()
    return dataset, make_split(dataset, SOURCE, TARGET)


def _work(
    setup: Setup,
    corruptions: Sequence[Corruption],
    metrics: Mapping[str, Metric],
    jobs: int,
    progress: Progress,
) -> list[Value]:
    """All values: of the uncorrupted performances first, then of each corruption."""
    units: list[Corruption | None] = [None, *corruptions]
    if jobs == 1:
        cases = make_cases(setup)
        values: list[Value] = []
        for unit in units:
            name = "faultless" if unit is None else unit.name
            values += evaluate(
                cases,
                unit,
                metrics,
                seed=setup.seed,
                report=partial(progress, name),
            )
            progress(name, 1.0, "done")
        return values
    return _work_apart(setup, units, jobs, progress)


def _work_apart(setup: Setup, units: Sequence[Corruption | None], jobs: int, progress: Progress) -> list[Value]:
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    names = [None if unit is None else unit.name for unit in units]
    found: dict[str | None, list[Value]] = {}
    with (
        _one_thread_each(),
        ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_start, initargs=(setup,)) as pool,
    ):
        futures = {pool.submit(_unit, name): name for name in names}
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            progress(futures[future] or "faultless", 1.0, "done")
    return [value for name in names for value in found[name]]


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started in here use one thread each; several would fight over the cores and sum in another order."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


class _Process:
    """What a worker process keeps from one unit of work to the next."""

    setup: Setup
    cases: list[Case]
    metrics: dict[str, Metric]


def _start(setup: Setup) -> None:
    _Process.setup = setup
    _Process.cases = make_cases(setup)
    _Process.metrics = {}
    for name, target in setup.metrics.items():
        found = load_target(target, f"metric {name!r}")
        _Process.metrics[name] = found() if isinstance(found, type) else found


def _unit(name: str | None) -> list[Value]:
    corruption = None if name is None else choose_corruptions([name])[0]
    return evaluate(_Process.cases, corruption, _Process.metrics, seed=_Process.setup.seed)

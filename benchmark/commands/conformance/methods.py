"""What the contract asks of a method."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.api import (
    Capabilities,
    FitContext,
    Method,
    MethodInfo,
    NotApplicableError,
    StyleTask,
    Supervision,
    TransferResult,
)
from benchmark.commands.conformance.figures import ADULT, CHILD, FPS, SmallView, perform, small_view
from benchmark.commands.conformance.outcome import (
    Check,
    CheckFailedError,
    NotConcernedError,
    Outcome,
    require,
    run_check,
)
from benchmark.errors import BenchmarkError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES, ROLES
from benchmark.runner.contract import check_result

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


class MethodBench:
    """A method class with one set of parameters, and small clips to try it on.

    What is fitted and transferred once is kept, so that the checks together take a few fits, not one each.

    Parameters
    ----------
    method
        The class.
    params
        Constructor keywords; by default the first of ``test_params``.
    """

    def __init__(self, method: type[Method], params: dict[str, Any] | None = None) -> None:
        self.method = method
        self._params = params

    @cached_property
    def params(self) -> dict[str, Any]:
        """The parameters under test."""
        return self.method.test_params()[0] if self._params is None else self._params

    @property
    def capabilities(self) -> Capabilities:
        """What the method says of itself."""
        return self.method.info.capabilities

    @property
    def fps(self) -> float:
        """The rate of the clips it is tried on."""
        return self.capabilities.fps or FPS

    @cached_property
    def view(self) -> SmallView:
        """Training clips of both styles."""
        return small_view(fps=self.fps)

    @property
    def other_view(self) -> SmallView:
        """Training clips of both styles and all actions, in another order and one take fewer of each."""
        return SmallView(tuple(clip for clip in self.view.held[::-1] if clip.meta.take != "1"), self.fps)

    @cached_property
    def source(self) -> MotionClip:
        """A walk by an adult that is in no training clip."""
        return perform("walk", ADULT, 3, fps=self.fps)

    @cached_property
    def task(self) -> StyleTask:
        """Adult to child, onto a child of the training clips; with a reference only for methods that declare its use."""
        return self.task_for("walk")

    def task_for(self, action: str, *, roles: str = "all") -> StyleTask:
        """The task for one action, on figures with all roles or with the core ones."""
        reference = perform(action, CHILD, 3, fps=self.fps, roles=roles) if self.capabilities.uses_reference else None
        return StyleTask(ADULT, CHILD, perform(action, CHILD, 1, fps=self.fps, roles=roles).skeleton, reference)

    def make(self) -> Method:
        """A new instance, not fitted."""
        return self.method(**self.params)

    def fit(
        self, method: Method, *, seed: int = 1, view: SmallView | None = None, task: StyleTask | None = None
    ) -> Method:
        """Fit ``method`` as the runner would."""
        task = replace(self.task if task is None else task, reference=None)
        with tempfile.TemporaryDirectory() as folder:
            context = FitContext(work_dir=Path(folder))
            return method.fit(view or self.view, task, rng=np.random.default_rng(seed), ctx=context)

    @cached_property
    def fitted(self) -> Method:
        """An instance fitted with seed 1."""
        return self.fit(self.make())

    def transfer(
        self, method: Method, *, seed: int = 2, source: MotionClip | None = None, task: StyleTask | None = None
    ) -> TransferResult:
        """Transfer as the runner would, and check the result against the capabilities."""
        source, task = source or self.source, task or self.task
        result = method.transfer(source, task, rng=np.random.default_rng(seed))
        return check_result(result, source, task, self.capabilities)

    @cached_property
    def result(self) -> TransferResult:
        """What the fitted instance makes of the source."""
        return self.transfer(self.fitted)


def check_method(method: type[Method], params: dict[str, Any] | None = None) -> list[Outcome]:
    """Run every check on a method class; those of ``params`` on these, by default on each of ``test_params``.

    Where one set of parameters fails a check, that is its outcome; the message then starts with the parameters.
    """
    try:
        settings = method.test_params() if params is None else [params]
    except Exception as error:
        raise BenchmarkError(f"{method.__name__}.test_params() raised {type(error).__name__}: {error}") from error
    if not settings:
        raise BenchmarkError(f"{method.__name__}.test_params() is empty: return at least [{{}}]")
    benches = [MethodBench(method, chosen) for chosen in settings]
    outcomes = []
    for check in METHOD_CHECKS:
        each = [run_check(check, bench) for bench in benches]
        worst = min(range(len(each)), key=lambda i: ("failed", "passed", "not concerned").index(each[i].status))
        outcome = each[worst]
        if outcome.status == "failed" and len(each) > 1:
            outcome = replace(outcome, message=f"with {settings[worst]}: {outcome.message}")
        outcomes.append(outcome)
    return outcomes


def fingerprint(clip: MotionClip) -> bytes:
    """The bytes of a clip's arrays."""
    parts = [clip.rotations, clip.root, clip.skeleton.offsets]
    parts += [array for array in (clip.translations, clip.residual) if array is not None]
    return b"".join(np.ascontiguousarray(array).tobytes() for array in parts)


def _same(one: TransferResult, other: TransferResult) -> bool:
    if fingerprint(one.clip) != fingerprint(other.clip) or one.copied_from != other.copied_from:
        return False
    pairs = ((one.time_map, other.time_map), (one.contacts, other.contacts))
    return all(a is b or (a is not None and b is not None and np.array_equal(a, b)) for a, b in pairs)


def _info(bench: MethodBench) -> None:
    info = getattr(bench.method, "info", None)
    if not isinstance(info, MethodInfo):
        raise CheckFailedError(
            "set the class attribute info = MethodInfo(name=…, summary=…, capabilities=Capabilities(…))"
        )
    require(bool(_NAME.fullmatch(info.name)), f"info.name {info.name!r} must be lower-case words joined by hyphens")
    require(bool(info.summary.strip()) and "\n" not in info.summary, "info.summary must be one line")
    require(bool(info.version.strip()), "info.version must not be empty")
    needs = info.capabilities
    require(isinstance(needs.supervision, Supervision), f"supervision must be a Supervision, not {needs.supervision!r}")
    unknown = sorted(set(needs.required_roles) - set(ROLES))
    require(not unknown, f"required_roles names {', '.join(unknown)}, which are no joint roles")
    require(needs.output in ("rotations", "positions"), f"output must be rotations or positions, not {needs.output!r}")
    require(needs.device in ("cpu", "gpu_preferred", "gpu_required"), f"device {needs.device!r} is none of the three")
    require(needs.fit_scope in ("none", "per_task"), f"fit_scope must be none or per_task, not {needs.fit_scope!r}")
    require(needs.min_frames >= 1, f"min_frames must be at least 1, not {needs.min_frames}")
    require(needs.fps is None or needs.fps > 0, f"fps must be positive or None, not {needs.fps}")
    for module in info.code_deps:
        try:
            found = find_spec(module) is not None
        except ModuleNotFoundError:
            found = False
        require(found, f"code_deps names {module!r}, which cannot be imported")


def _constructor(bench: MethodBench) -> None:
    defaults = bench.method.param_defaults()
    method = bench.method()
    for name, value in defaults.items():
        require(hasattr(method, name), f"__init__ does not store {name!r} under its own name")
        require(
            getattr(method, name) is value or getattr(method, name) == value,
            f"__init__ alters {name!r}: store it as given",
        )
    extra = sorted(set(vars(method)) - set(defaults))
    require(not extra, f"__init__ sets {', '.join(extra)}: it may only store its keywords; set up state in fit")
    try:
        json.dumps(defaults)
    except TypeError as error:
        raise CheckFailedError(
            f"a default is not ready for JSON ({error}): parameters are part of file names and keys"
        ) from None


def _parameters(bench: MethodBench) -> None:
    method = bench.make()
    for name, value in bench.params.items():
        require(getattr(method, name, None) == value, f"{name}={value!r} of test_params is not stored under its name")
    try:
        bench.method(no_such_parameter_=1)  # type: ignore[call-arg]
    except TypeError:
        pass
    else:
        raise CheckFailedError(
            "an unknown keyword is accepted: do not take **kwargs, a typing error would go unnoticed"
        )
    for name, chosen in {**bench.method.variants(), **bench.method.presets()}.items():
        try:
            bench.method(**chosen)
        except TypeError as error:
            raise CheckFailedError(f"variant {name!r} cannot be made: {error}") from None


def _fit_returns_self(bench: MethodBench) -> None:
    method = bench.make()
    before = method.params()
    require(bench.fit(method) is method, "fit must return self")
    require(method.params() == before, "fit changes a hyper-parameter: keep what it learns in attributes that end in _")
    stray = sorted(name for name in set(vars(method)) - set(before) if not name.endswith("_"))
    require(not stray, f"fit sets {', '.join(stray)}: names of what it learns end in an underscore")
    if bench.capabilities.fit_scope == "none":
        require(not method.learned(), f"fit_scope is none, but fit learns {', '.join(method.learned())}")


def _refit(bench: MethodBench) -> None:
    method = bench.make()
    bench.fit(method, seed=5, view=bench.other_view)
    bench.fit(method)
    again = bench.transfer(method)
    require(
        _same(again, bench.result), "a second fit gives another result than a fresh one: fit must forget what it knew"
    )


def _transfer(bench: MethodBench) -> None:
    require(bench.result.clip is not None, "transfer returned no clip")
    for action in ("walk", "wave"):
        for frames in (bench.capabilities.min_frames, 41, 97):
            source = perform(action, ADULT, 3, fps=bench.fps).frames(0, max(frames, bench.capabilities.min_frames))
            bench.transfer(bench.fitted, source=source, task=bench.task_for(action))


def _no_target_skeleton(bench: MethodBench) -> None:
    bench.transfer(bench.fitted, task=replace(bench.task, target_skeleton=None))


def _required_roles(bench: MethodBench) -> None:
    extra = sorted(set(bench.capabilities.required_roles) - set(CORE_ROLES))
    if extra:
        raise NotConcernedError(f"it needs more than the core roles: {', '.join(extra)}")
    task = bench.task_for("walk", roles="core")
    method = bench.fit(bench.make(), view=small_view(fps=bench.fps, roles="core"), task=task)
    bench.transfer(method, source=perform("walk", ADULT, 3, fps=bench.fps, roles="core"), task=task)


def _inputs_unchanged(bench: MethodBench) -> None:
    view, source, task = small_view(fps=bench.fps), perform("walk", ADULT, 3, fps=bench.fps), bench.task_for("walk")
    watched = [source, *view.held, *([task.reference] if task.reference else [])]
    assert task.target_skeleton is not None
    offsets = task.target_skeleton.offsets.copy()
    before = [fingerprint(clip) for clip in watched]
    method = bench.fit(bench.make(), view=view, task=task)
    bench.transfer(method, source=source, task=task)
    after = [fingerprint(clip) for clip in watched]
    changed = [clip.meta.clip_id for clip, one, other in zip(watched, before, after, strict=True) if one != other]
    require(not changed, f"the arrays of {', '.join(changed)} were written to: copy before changing")
    kept = np.array_equal(offsets, task.target_skeleton.offsets)
    require(kept, "task.target_skeleton was written to: every method is shown on this body")


def _no_hidden_state(bench: MethodBench) -> None:
    first = bench.transfer(bench.fitted)
    bench.transfer(bench.fitted, source=perform("wave", ADULT, 3, fps=bench.fps), task=bench.task_for("wave"), seed=7)
    second = bench.transfer(bench.fitted)
    require(
        _same(first, second), "the same transfer twice gives two results: transfer must keep nothing from call to call"
    )
    # What is kept from the first call alone shows only in an instance whose first call was another.
    other = bench.fit(bench.make())
    bench.transfer(other, source=perform("wave", ADULT, 3, fps=bench.fps), task=bench.task_for("wave"), seed=7)
    require(
        _same(first, bench.transfer(other)),
        "what the first transfer was changes the result of a later one: transfer must keep nothing from call to call",
    )


def _same_seed(bench: MethodBench) -> None:
    again = bench.transfer(bench.fit(bench.make()))
    require(
        _same(again, bench.result),
        "the same seeds give two results: draw only from the generator passed in, and iterate over nothing unordered",
    )


def _other_seed(bench: MethodBench) -> None:
    declared = bench.capabilities
    other_fit = bench.transfer(bench.fit(bench.make(), seed=11))
    _compare_seeds("fit", declared.stochastic_fit, _same(other_fit, bench.result))
    other_transfer = bench.transfer(bench.fitted, seed=12)
    _compare_seeds("transfer", declared.stochastic_transfer, _same(other_transfer, bench.result))


def _compare_seeds(stage: str, declared: bool, same: bool) -> None:
    if declared:
        require(not same, f"stochastic_{stage} is True, but another seed of {stage} changes nothing: declare it False")
    else:
        require(same, f"another seed of {stage} changes the result: declare stochastic_{stage}=True")


def _global_random_state(bench: MethodBench) -> None:
    np.random.seed(3)  # noqa: NPY002 - it is the legacy global state that must stay untouched
    before = np.random.get_state()[1].copy()  # type: ignore[index]  # noqa: NPY002
    bench.transfer(bench.fit(bench.make()))
    after = np.random.get_state()[1]  # type: ignore[index]  # noqa: NPY002
    require(np.array_equal(before, after), "numpy's global random state was used: draw from the generator passed in")


def _save_load(bench: MethodBench) -> None:
    expected = bench.result
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model"
        bench.fitted.save(model)
        pickles = sorted(
            path.name for path in model.rglob("*") if path.suffix in (".pkl", ".pickle", ".pt", ".pth", ".joblib")
        )
        require(
            not pickles,
            f"save wrote {', '.join(pickles)}: loading a pickle can run code; use .npz, .safetensors or .json",
        )
        # In another process the class is new; here another fit must take away whatever was left on it or in its module.
        bench.fit(bench.make(), seed=5, view=bench.other_view)
        loaded = bench.method.load(model)
    require(type(loaded) is bench.method, f"load returned a {type(loaded).__name__}, not a {bench.method.__name__}")
    require(loaded.params() == bench.fitted.params(), "load gives other hyper-parameters than were saved")
    require(_same(bench.transfer(loaded), expected), "a loaded method gives another result than the one saved")


def _supervision(bench: MethodBench) -> None:
    held = bench.view.held
    if bench.capabilities.supervision is Supervision.NONE:
        bench.transfer(bench.fit(bench.make(), view=SmallView((), bench.fps)))
        return
    lacking = {"clips of the target style": SmallView(tuple(c for c in held if c.meta.style != CHILD), bench.fps)}
    if bench.capabilities.supervision is Supervision.PAIRED:
        walks, waves = bench.view.clips(ADULT, action="walk"), bench.view.clips(CHILD, action="wave")
        lacking["pairs"] = SmallView((*walks, *waves), bench.fps)
    for what, view in lacking.items():
        try:
            bench.fit(bench.make(), view=view)
        except (BenchmarkError, NotApplicableError):
            continue
        except Exception as error:
            raise CheckFailedError(
                f"without {what} fit ends in {type(error).__name__}: {error}; raise a benchmark.errors.DataError that says "
                "what is missing"
            ) from None
        raise CheckFailedError(
            f"fit accepts training clips without {what}: refuse them with a benchmark.errors.DataError"
        )


def _reference(bench: MethodBench) -> None:
    if not bench.capabilities.uses_reference:
        raise NotConcernedError("it is handed no reference")
    try:
        bench.fitted.transfer(bench.source, replace(bench.task, reference=None), rng=np.random.default_rng(2))
    except BenchmarkError:
        return
    raise CheckFailedError("uses_reference is True, but a task without a reference is accepted")


def _light_import(bench: MethodBench) -> None:
    module = bench.method.__module__
    try:
        known = find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):
        known = False
    if not known:
        raise NotConcernedError(f"{module} is no installed module")
    probe = (
        "import sys, importlib; sys.path[:] = sys.argv[2:]; importlib.import_module(sys.argv[1]); "
        "print(' '.join(n for n in ('torch', 'sklearn', 'matplotlib', 'pandas', 'statsmodels') if n in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", probe, module, *sys.path], capture_output=True, text=True, check=False)
    require(done.returncode == 0, f"importing {module} by itself fails: {done.stderr.strip()[-300:]}")
    heavy = done.stdout.split()
    require(
        not heavy, f"importing {module} imports {', '.join(heavy)}: import them inside the functions that need them"
    )


METHOD_CHECKS: Sequence[Check] = (
    Check("info", "info is complete and names things that exist", _info),
    Check("constructor", "the constructor stores its keywords and does nothing else", _constructor),
    Check("parameters", "parameters are stored; unknown ones are refused", _parameters),
    Check("light-import", "importing the method imports no learning or plotting library", _light_import),
    Check("fit-returns-self", "fit returns self and names what it learns with an underscore", _fit_returns_self),
    Check("refit", "fitting again forgets what was learned before", _refit),
    Check("transfer", "results are finite clips on the declared skeleton, clock and length", _transfer),
    Check("no-target-skeleton", "without a target skeleton the source's is kept", _no_target_skeleton),
    Check("required-roles", "a skeleton with just the required joint roles is enough", _required_roles),
    Check("inputs-unchanged", "no clip or skeleton handed in is written to", _inputs_unchanged),
    Check("no-hidden-state", "transfer leaves nothing behind", _no_hidden_state),
    Check("same-seed", "the same seeds give the same bytes", _same_seed),
    Check("other-seed", "other seeds change the result only where that is declared", _other_seed),
    Check("global-random-state", "no global random state is used", _global_random_state),
    Check("save-load", "a saved method gives the same results when loaded, and saves nothing that can run", _save_load),
    Check("supervision", "training clips that cannot do are refused with a clear error", _supervision),
    Check("reference", "a method that is handed a reference says when there is none", _reference),
)

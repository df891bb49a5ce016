"""What a run is: strict settings, merged from defaults, a preset, the user's file and the command line.

An unknown setting is an error that names where it was written and suggests the nearest.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, field_validator

from benchmark.errors import ConfigError, UnknownNameError
from benchmark.toml import parse_toml

Overwrite = Literal["missing", "always", "never", "only-cached"]
Variant = Literal["raw", "cleaned"]

_MEMORY = re.compile(r"(\d{1,12}(?:\.\d{1,6})?)\s*([KMGT]?I?B?)", re.IGNORECASE)
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}

_TASK = re.compile(r"[^:\s]+:[^:\s]+")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)


class DatasetConfig(_Strict):
    """Which data set, where its files are, and its own options."""

    name: str = "synthetic"
    root: Path | None = None
    options: dict[str, Any] = {}


def _kind(value: Any) -> str:
    return "names" if isinstance(value, list | tuple) else "number"


#: A number, or a list of names; told apart first, so that a wrong value is judged as one of the two and not as both.
_SplitParameter = Annotated[
    Annotated[float, Tag("number")] | Annotated[tuple[str, ...], Tag("names")], Discriminator(_kind)
]


class SplitConfig(_Strict):
    """How the clips are divided; ``auto`` is the data set's own protocol, ``file`` takes a stored manifest instead.

    ``parameters`` are the protocol's own: numbers, or lists of names (:func:`benchmark.data.splits.make_split`).
    """

    protocol: str = "auto"
    fold: Annotated[int, Field(ge=0)] = 0
    seed: int = 0
    parameters: dict[str, _SplitParameter] = {}
    file: Path | None = None

    @field_validator("parameters")
    @classmethod
    def _check_parameters(cls, parameters: dict[str, Any]) -> dict[str, Any]:
        for name in ("protocol", "fold", "seed", "file"):
            if name in parameters:
                raise ValueError(f"{name} is a setting of the split itself: write split.{name}")
        return parameters


class RunConfig(_Strict):
    """All settings of a run.

    Attributes
    ----------
    dataset
        The data set.
    tasks
        ``source:target`` pairs of styles; empty for the data set's own.
    methods
        Names, patterns, ``name[variant]``, ``name[param=value]`` or ``all``.
    metrics
        Names, patterns or ``all``.
    params
        Hyper-parameters by method: ``{"dynamic-scaling": {"length": true}}``.
    split
        The split.
    repetitions
        How often a method with a random fit or transfer is run; others run once.
    seed
        Seed of the run, one axis of every other seed.
    variants
        ``raw``: as the method returns it; ``cleaned``: after the foot lock that is the same for all.
    limit
        Only so many test clips, spread evenly; ``None`` for all.
    out
        The run folder; ``None`` for ``runs/DATASET-TASK``.
    overwrite
        ``missing``: run what is missing, damaged or failed; ``always``: everything again; ``never``: keep all there is,
        failures too; ``only-cached``: run nothing.
    force
        Methods to run again whatever there is.
    time_limit
        Seconds after which a cell is ended; ``None`` for no limit.
    memory_limit
        Memory above which a cell is ended, its process and those it starts together: bytes, or a text as ``4 GB``; ``None`` for
        no limit.
    jobs
        Cells at a time, each in a process of its own; ``None`` for one on each core that memory allows.
    threads
        Threads of the numerical libraries in each process. Part of a cell's key, because the order of sums depends on it;
        never derived from ``jobs``, so that results do not depend on those.
    device
        ``auto`` uses a GPU for methods that ask for one.
    backend
        ``processes``; ``dask`` for the workers of a cluster; or ``serial`` for a debugger: in this process, without time
        limits.
    scheduler
        Address of a running Dask scheduler; ``None`` for a cluster of ``jobs`` workers on this machine.
    shard
        ``k/n``: only the cells of the ``k``-th of ``n`` parts; ``None`` for all.
    """

    dataset: DatasetConfig = DatasetConfig()
    tasks: tuple[str, ...] = ()
    methods: Annotated[tuple[str, ...], Field(min_length=1)] = ("all",)
    metrics: Annotated[tuple[str, ...], Field(min_length=1)] = ("all",)
    params: dict[str, dict[str, Any]] = {}
    split: SplitConfig = SplitConfig()
    repetitions: Annotated[int, Field(ge=1)] = 1
    seed: int = 0
    variants: Annotated[tuple[Variant, ...], Field(min_length=1)] = ("raw", "cleaned")
    limit: Annotated[int, Field(ge=1)] | None = None
    out: Path | None = None
    overwrite: Overwrite = "missing"
    force: tuple[str, ...] = ()
    time_limit: Annotated[float, Field(gt=0)] | None = None
    memory_limit: Annotated[int, Field(gt=0)] | None = None
    jobs: Annotated[int, Field(ge=1)] | None = None
    threads: Annotated[int, Field(ge=1)] = 1
    device: Literal["auto", "cpu", "cuda"] = "auto"
    backend: Literal["processes", "serial", "dask"] = "processes"
    scheduler: str | None = None
    shard: Annotated[str, Field(pattern=r"^[1-9][0-9]*/[1-9][0-9]*$")] | None = None
    preset: str | None = None

    @field_validator("shard")
    @classmethod
    def _check_shard(cls, shard: str | None) -> str | None:
        if shard is not None and int(shard.partition("/")[0]) > int(shard.partition("/")[2]):
            raise ValueError("a shard is written k/n with k from 1 to n, for example 2/8")
        return shard

    @field_validator("tasks")
    @classmethod
    def _check_tasks(cls, tasks: tuple[str, ...]) -> tuple[str, ...]:
        for task in tasks:
            if not _TASK.fullmatch(task):
                raise ValueError(f"a task is written source:target, for example adult:child, not {task!r}")
            source, _, target = task.partition(":")
            if source == target:
                raise ValueError(f"the two styles of the task {task!r} are the same")
        return tuple(dict.fromkeys(tasks))

    @field_validator("memory_limit", mode="before")
    @classmethod
    def _read_memory(cls, limit: Any) -> Any:
        if not isinstance(limit, str):
            return limit
        match = _MEMORY.fullmatch(limit.strip())
        if match is None:
            raise ValueError("write a number of bytes with its unit, for example 4GB or 500 MiB")
        return int(float(match[1]) * _UNITS[match[2].upper().removesuffix("B").removesuffix("I")])

    @field_validator("variants")
    @classmethod
    def _order_variants(cls, variants: tuple[Variant, ...]) -> tuple[Variant, ...]:
        return tuple(name for name in ("raw", "cleaned") if name in variants)


#: Settings that cannot change a number; all others make a run folder what it is.
OPERATIONAL = (
    *("out", "overwrite", "force", "time_limit", "memory_limit", "jobs", "backend", "scheduler", "shard"),
    *("preset", "methods", "metrics", "params"),
)


def presets() -> list[str]:
    """Names of the presets that come with the suite."""
    folder = resources.files("benchmark") / "presets"
    return (
        sorted(Path(item.name).stem for item in folder.iterdir() if item.name.endswith(".toml"))
        if folder.is_dir()
        else []
    )


def load_config(
    *,
    preset: str | None = None,
    file: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    assign: Sequence[str] = (),
) -> RunConfig:
    """Merge the layers: defaults < ``preset`` < ``file`` < ``flags`` and ``assign``.

    Parameters
    ----------
    preset
        Name of a preset; the user's file may name one too.
    file
        A TOML file.
    flags
        Settings from the command line, nested as in :class:`RunConfig`; ``None`` values are left out.
    assign
        ``"method.param=value"`` texts; the value is TOML, or a plain string.

    Raises
    ------
    ConfigError
        Naming the layer and the setting, for one that does not exist or has a value out of range.
    """
    layers: list[tuple[str, dict[str, Any]]] = []
    user = _read_toml(file) if file is not None else {}
    preset = preset or user.get("preset")
    if preset is not None:
        if not isinstance(preset, str):
            raise ConfigError(f"{file}: preset: write the name of one ({', '.join(presets())}), not {preset!r}")
        if preset not in presets():
            raise UnknownNameError("preset", preset, presets())
        text = (resources.files("benchmark") / "presets" / f"{preset}.toml").read_text(encoding="utf-8")
        layers += [(f"preset {preset}", tomllib.loads(text)), ("preset", {"preset": preset})]
    if file is not None:
        layers.append((str(file), user))
    layers.append(("the command line", _without_none(flags or {})))
    if assign:
        layers.append(("--set", {"params": _assignments(assign)}))
    merged: dict[str, Any] = {}
    for where, layer in layers:
        _check_names(layer, RunConfig, where)
        merged = _merge(merged, layer)
    try:
        return RunConfig.model_validate(merged)
    except ValidationError as error:
        raise ConfigError(_explain(error, layers)) from None


def read_config(path: Path) -> RunConfig:
    """The settings stored in a run folder by :func:`to_toml`."""
    return load_config(file=path)


def to_toml(config: RunConfig) -> str:
    """The complete settings as TOML that :func:`load_config` reads back; settings that are ``None`` are left out."""
    return _toml(_without_none(config.model_dump(mode="json")))


def parse_value(text: str) -> Any:
    """A value typed on the command line: TOML where it is TOML (``1``, ``2.5``, ``true``, ``[1, 2]``), else the text."""
    try:
        return parse_toml(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _assignments(texts: Iterable[str]) -> dict[str, dict[str, Any]]:
    params: dict[str, dict[str, Any]] = {}
    for text in texts:
        target, equals, value = text.partition("=")
        method, dot, param = target.strip().rpartition(".")
        if not (equals and dot and method and param):
            raise ConfigError(f"--set {text!r}: write method.param=value, for example dynamic-scaling.time=false")
        params.setdefault(method, {})[param] = parse_value(value.strip())
    return params


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"no settings file {path}") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error


def _without_none(tree: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _without_none(value) if isinstance(value, Mapping) else value
        for key, value in tree.items()
        if value is not None
    }


def _merge(below: dict[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = _merge(old, value) if isinstance(old, dict) and isinstance(value, Mapping) else value
    return merged


def _check_names(layer: Mapping[str, Any], model: type[BaseModel], where: str, prefix: str = "") -> None:
    for key, value in layer.items():
        field = model.model_fields.get(key)
        if field is None:
            error = UnknownNameError("setting", prefix + key, [prefix + name for name in model.model_fields])
            raise ConfigError(f"{where}: {error}")
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            if not isinstance(value, Mapping):
                names = ", ".join(inner.model_fields)
                raise ConfigError(f"{where}: {prefix}{key} is a table [{prefix}{key}] with {names}, not {value!r}")
            _check_names(value, inner, where, f"{prefix}{key}.")


def _explain(error: ValidationError, layers: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    problems = []
    for problem in error.errors():
        location = problem["loc"]
        where = next(
            (
                name
                for depth in range(len(location), 0, -1)
                for name, layer in reversed(layers)
                if _holds(layer, location[:depth])
            ),
            "settings",
        )
        message = problem["msg"].removeprefix("Value error, ")
        problems.append(f"{where}: {'.'.join(map(str, location))}: {message} (got {problem['input']!r})")
    return "; ".join(problems)


def _holds(layer: Any, location: Sequence[Any]) -> bool:
    for key in location:
        if not isinstance(layer, Mapping) or key not in layer:
            return False
        layer = layer[key]
    return True


def _toml(table: Mapping[str, Any], prefix: str = "") -> str:
    lines = [f"{_key(key)} = {_toml_value(value)}" for key, value in table.items() if not isinstance(value, Mapping)]
    for key, value in table.items():
        if isinstance(value, Mapping):
            name = f"{prefix}{_key(key)}"
            lines += ["", f"[{name}]", _toml(value, f"{name}.").rstrip("\n")]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def _toml_value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value)

"""Which methods and metrics a run uses: names, patterns, variants and parameters, resolved through the registry."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

from benchmark.api import Capabilities, Method, Metric, MetricInfo, Probe
from benchmark.config import parse_value
from benchmark.digest import code_digest, digest, module_files
from benchmark.errors import ConfigError, ContractError, RegistryError, UnknownNameError
from benchmark.registry import PROBES, Registry

_REQUEST = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<inside>[^\[\]]*)\])?")


@dataclass(frozen=True)
class MethodChoice:
    """One method with all its parameters fixed.

    Attributes
    ----------
    label
        What rows call it: ``name``, ``name[variant]`` or ``name[param=value]``.
    name, origin, target
        Its registry entry; ``target`` is ``"module:Class"``.
    params
        Every parameter, defaults included.
    version, source
        ``info.version`` and the digest of its code with all it imports from its own package and declares.
    capabilities
        What the planner decides from.
    error
        Why it cannot be used, or ``None``; then ``source`` and ``params`` are empty.
    """

    label: str
    name: str
    origin: str
    target: str
    params: Mapping[str, Any] = field(default_factory=dict)
    version: str = ""
    source: str = ""
    capabilities: Capabilities = field(default_factory=Capabilities)
    error: str | None = None


@dataclass(frozen=True)
class ProbeChoice:
    """One probe, with the digest of its code; ``error`` as in :class:`MethodChoice`."""

    name: str
    target: str
    digest: str = ""
    error: str | None = None


@dataclass(frozen=True)
class MetricChoice:
    """One metric, with a digest of everything of its own that can change its values, and the probe that it names.

    ``error`` as in :class:`MethodChoice`.
    """

    name: str
    target: str
    digest: str = ""
    info: MetricInfo | None = None
    error: str | None = None
    probe: ProbeChoice | None = None


def choose_methods(
    registry: Registry, requests: Iterable[str], params: Mapping[str, Mapping[str, Any]] | None = None
) -> list[MethodChoice]:
    """Resolve ``requests`` in order, without repeating a label.

    ``all`` and patterns stand for every registered variant of every matching method; a method that cannot be imported is then
    kept with its error, so that the run shows it as failed. Asked for by its plain name, the error is raised.

    Parameters
    ----------
    registry
        The methods there are.
    requests
        ``all``, ``name``, ``na*e``, ``name[variant]``, ``name[param=value, …]``.
    params
        Parameters by method, below those in brackets.
    """
    params = params or {}
    for name in params:
        registry.entry(name)
    chosen: dict[str, MethodChoice] = {}
    for request in requests:
        match = _REQUEST.fullmatch(request.strip())
        if match is None:
            raise ConfigError(f"method {request!r}: write name, name[variant] or name[param=value]")
        pattern, inside = match["name"].strip(), match["inside"]
        wide = pattern == "all" or any(sign in pattern for sign in "*?")
        for name in registry.select(pattern):
            try:
                cls = load_method(registry, name)
                found = _variants(registry, name, cls, inside, params.get(name, {}), wide)
            except (RegistryError, ContractError) as error:
                if not wide:
                    raise
                entry = registry.entry(name)
                found = [MethodChoice(name, name, entry.origin, entry.target, error=str(error))]
            for choice in found:
                chosen.setdefault(choice.label, choice)
    return list(chosen.values())


def load_method(registry: Registry, name: str) -> type[Method]:
    """The class registered as ``name``; a :class:`~benchmark.errors.ContractError` if it is no method."""
    cls = registry.get(name)
    if not (isinstance(cls, type) and issubclass(cls, Method)) or inspect.isabstract(cls):
        raise ContractError(
            f"method {name!r} from {registry.origin(name)}: {cls!r} is not a complete subclass of Method"
        )
    if not hasattr(cls, "info"):
        raise ContractError(f"method {name!r} from {registry.origin(name)}: {cls.__name__} has no info")
    return cls


def _variants(
    registry: Registry, name: str, cls: type[Method], inside: str | None, params: Mapping[str, Any], wide: bool
) -> list[MethodChoice]:
    variants = cls.variants()
    if inside is None:
        picked = dict(variants) if wide else {"": variants.get("", {})}
        return [
            make_choice(registry, name, cls, {**settings, **params}, f"{name}[{variant}]" if variant else name)
            for variant, settings in picked.items()
        ]
    if "=" not in inside:
        named = {**cls.presets(), **variants}
        if inside not in named:
            raise UnknownNameError(f"variant of {name}", inside, [variant for variant in named if variant])
        return [make_choice(registry, name, cls, {**named[inside], **params}, f"{name}[{inside}]")]
    typed: dict[str, Any] = {}
    for part in inside.split(","):
        key, equals, value = part.partition("=")
        if not equals:
            raise ConfigError(f"method {name}[{inside}]: {part.strip()!r} is not param=value")
        typed[key.strip()] = parse_value(value.strip())
    return [make_choice(registry, name, cls, {**variants.get("", {}), **params, **typed}, f"{name}[{inside}]")]


def make_choice(
    registry: Registry, name: str, cls: type[Method], params: Mapping[str, Any], label: str | None = None
) -> MethodChoice:
    """Fix the parameters of a method and digest its code.

    Raises
    ------
    ConfigError
        For a parameter that the method does not have.
    """
    entry = registry.entry(name)
    defaults = cls.param_defaults()
    for param in params:
        if param not in defaults:
            close = get_close_matches(param, defaults, n=1, cutoff=0.5)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            listing = ", ".join(defaults) or "none"
            raise ConfigError(f"method {name} has no parameter {param!r}{hint} (parameters: {listing})")
    return MethodChoice(
        label or name,
        name,
        entry.origin,
        entry.target,
        {**defaults, **params},
        cls.info.version,
        class_digest(cls, cls.info.code_deps),
        cls.info.capabilities,
    )


def choose_metrics(registry: Registry, requests: Iterable[str], probes: Registry = PROBES) -> list[MetricChoice]:
    """Resolve ``requests`` in order, without repeats; errors as in :func:`choose_methods`."""
    chosen: dict[str, MetricChoice] = {}
    for request in requests:
        wide = request == "all" or any(sign in request for sign in "*?")
        for name in registry.select(request):
            if name not in chosen:
                try:
                    chosen[name] = _metric_choice(registry, name, probes)
                except (RegistryError, ContractError, UnknownNameError) as error:
                    if not wide:
                        raise
                    chosen[name] = MetricChoice(name, registry.entry(name).target, error=str(error))
    return list(chosen.values())


def _metric_choice(registry: Registry, name: str, probes: Registry) -> MetricChoice:
    metric = make_metric(registry.get(name), name)
    code = class_digest(type(metric), metric.info.code_deps)
    probe = choose_probe(probes, metric.info.probe) if metric.info.probe else None
    own = {"name": name, "version": metric.info.version, "code": code, "probe": probe.digest if probe else ""}
    return MetricChoice(name, registry.entry(name).target, digest(own), metric.info, probe=probe)


def choose_probe(registry: Registry, name: str) -> ProbeChoice:
    """The probe registered as ``name``; a :class:`~benchmark.errors.ContractError` if it is none."""
    entry, cls = registry.entry(name), registry.get(name)
    if not (isinstance(cls, type) and issubclass(cls, Probe)) or inspect.isabstract(cls):
        raise ContractError(f"probe {name!r} from {entry.origin}: {cls!r} is not a complete subclass of Probe")
    if cls.info.name != name:
        raise ContractError(f"probe {name!r} calls itself {cls.info.name!r}: the two names must be the same")
    if not importable(cls):
        raise ContractError(f"probe {name!r}: define it in a module that worker processes can import")
    own = {"name": name, "version": cls.info.version, "code": class_digest(cls, cls.info.code_deps)}
    return ProbeChoice(name, entry.target, digest(own))


def make_metric(registered: Any, name: str) -> Metric:
    """A metric from what is registered: a class, or an instance for metrics that come in several settings."""
    metric = registered() if isinstance(registered, type) else registered
    if not isinstance(metric, Metric):
        raise ContractError(f"metric {name!r}: {registered!r} is neither a subclass of Metric nor an instance of one")
    if metric.info.name != name:
        raise ContractError(f"metric {name!r} calls itself {metric.info.name!r}: the two names must be the same")
    return metric


def class_digest(cls: type, declared: Iterable[str] = ()) -> str:
    """Digest of a class's code: the modules of the class and of its bases with what they import, and those ``declared``.

    A class written in a notebook or script is digested from its own source text.

    Raises
    ------
    RegistryError
        If the source cannot be found.
    """
    modules, texts = set(), []
    for base in cls.__mro__:
        if base.__module__ in ("builtins", "abc", "typing", "benchmark.api"):
            continue
        if not importable(base):
            try:
                texts.append(inspect.getsource(base))
            except (OSError, TypeError) as error:
                raise RegistryError(
                    f"the source of {base.__qualname__} cannot be found ({error}): define it in a file so that results "
                    "made by other versions of it can be told apart"
                ) from error
        else:
            modules.add(base.__module__)
    return digest({"modules": code_digest(modules, declared), "texts": texts})


def importable(value: Any) -> bool:
    """Whether another process can import ``value`` by its module and name."""
    if value.__module__ == "__main__" or "<locals>" in value.__qualname__:
        return False
    try:
        module_files(value.__module__)
    except RegistryError:
        return False
    return True

"""One lazy registry for methods, metrics, data sets and figures.

An entry is a name and a ``"module:attribute"`` string, so that listing imports nothing heavy and an entry whose
dependency is missing breaks only itself. There are three doors:

- the built-in mapping of the package (found by name when it is first needed, never imported by this layer);
- the decorator ``@METHODS.register`` for scripts and notebooks;
- an entry point group, for installed packages.

Two entries under one name are an error that names both origins.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from types import ModuleType
from typing import Any, TypeVar, overload

from benchmark.digest import module_files
from benchmark.errors import RegistryError, UnknownNameError

Registrable = TypeVar("Registrable")


@dataclass(frozen=True)
class Entry:
    """One name of a registry.

    Attributes
    ----------
    name
        The name users type.
    target
        ``"module:attribute"``.
    door
        ``built-in``, ``entry point`` or ``registered``.
    origin
        Where the entry came from, for people.
    value
        The object itself, where the decorator was given one.
    """

    name: str
    target: str
    door: str
    origin: str
    value: Any = None

    @property
    def module(self) -> str:
        """The module that defines the entry."""
        return self.target.partition(":")[0]

    @property
    def attribute(self) -> str:
        """The attribute of that module."""
        return self.target.partition(":")[2]


@dataclass(frozen=True)
class Description:
    """What the source of an entry says about it, read without importing it.

    Attributes
    ----------
    summary
        One line; empty where the source does not state one literally.
    facts
        The other literal fields of its info.
    error
        Why it could not be read, or ``None``.
    """

    summary: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)
    error: str | None = None


class Registry:
    """Names to lazily imported objects of one kind.

    Parameters
    ----------
    kind
        What the entries are, for messages: ``"method"``.
    group
        Entry point group that installed packages add to.
    builtin
        ``"module:MAPPING"`` of a mapping from name to ``"module:attribute"``.
    info_fields
        Names of the positional fields of the entries' info class, for :meth:`describe`.
    """

    def __init__(self, kind: str, group: str, builtin: str | None = None, info_fields: Sequence[str] = ()) -> None:
        self.kind, self.group, self.builtin, self.info_fields = kind, group, builtin, tuple(info_fields)
        self._registered: dict[str, Entry] = {}

    @overload
    def register(self, value: Registrable, /) -> Registrable: ...
    @overload
    def register(self, value: str, target: str, /) -> None: ...
    @overload
    def register(self, /, *, name: str) -> Callable[[Registrable], Registrable]: ...

    def register(self, value: Any = None, target: str | None = None, /, *, name: str | None = None) -> Any:
        """Add an entry from a script or a notebook.

        ``@METHODS.register`` takes the name from the class's ``info``; ``@METHODS.register(name="mine")`` gives one;
        ``METHODS.register("mine", "package.module:Class")`` stays lazy. Running the cell that defines a class again
        replaces it.

        Raises
        ------
        RegistryError
            If the name is taken or the object has none.
        """
        if isinstance(value, str):
            if target is None or not all(target.partition(":")):
                raise RegistryError(
                    f"{self.kind} {value!r} needs a target such as 'package.module:Class', not {target!r}"
                )
            self._add(Entry(value, target, "registered", f"registered as {target}"))
            return None
        if value is None:
            return lambda later: self._register_object(later, name)
        return self._register_object(value, name)

    def _register_object(self, value: Any, name: str | None) -> Any:
        name = name or getattr(getattr(value, "info", None), "name", None)
        if not name:
            raise RegistryError(f"{value!r} has no info.name: give @register(name=...) the {self.kind}'s name")
        target = f"{value.__module__}:{value.__qualname__}"
        self._add(Entry(name, target, "registered", f"registered by {target}", value))
        return value

    def _add(self, entry: Entry) -> None:
        for other in (self._installed.get(entry.name), self._registered.get(entry.name)):
            if other is not None and not (other.door == "registered" and other.target == entry.target):
                raise self._collision(other, entry)
        self._registered[entry.name] = entry

    def _collision(self, first: Entry, second: Entry) -> RegistryError:
        return RegistryError(
            f"two {self.kind}s are named {first.name!r}: {first.origin} and {second.origin}; rename one of them "
            "or uninstall its package"
        )

    def unregister(self, name: str) -> None:
        """Take back an entry made by :meth:`register`."""
        if name not in self._registered:
            raise UnknownNameError(f"registered {self.kind}", name, self._registered)
        del self._registered[name]

    @cached_property
    def _installed(self) -> dict[str, Entry]:
        entries: dict[str, Entry] = {}
        if self.builtin is not None:
            module, _, attribute = self.builtin.partition(":")
            for name, target in getattr(importlib.import_module(module), attribute, {}).items():
                entries[name] = Entry(name, target, "built-in", f"built-in ({target})")
        from importlib.metadata import entry_points

        for point in sorted(entry_points(group=self.group), key=lambda point: (point.name, point.value)):
            package = f"{point.dist.name} {point.dist.version}" if point.dist else "an installed package"
            entry = Entry(point.name, point.value.replace(" ", ""), "entry point", f"{package} ({point.value})")
            other = entries.get(point.name)
            if other is not None and other.target == entry.target and other.door == entry.door:
                continue
            if other is not None:
                raise self._collision(other, entry)
            entries[point.name] = entry
        return entries

    def _entries(self) -> dict[str, Entry]:
        return {**self._installed, **self._registered}

    def names(self) -> list[str]:
        """Every name: built-in ones in their own order, then installed, then registered ones."""
        return list(self._entries())

    def __contains__(self, name: object) -> bool:
        return name in self._entries()

    def entry(self, name: str) -> Entry:
        """The entry of ``name``, not imported; an :class:`~benchmark.errors.UnknownNameError` suggests the nearest."""
        entries = self._entries()
        if name not in entries:
            raise UnknownNameError(self.kind, name, entries)
        return entries[name]

    def origin(self, name: str) -> str:
        """Where ``name`` came from."""
        return self.entry(name).origin

    def select(self, pattern: str) -> list[str]:
        """The names that match ``pattern``: ``all``, a name, or one with ``*``, ``?`` and ``[…]``.

        Raises
        ------
        UnknownNameError
            If there is none.
        """
        if pattern == "all":
            return self.names()
        if any(sign in pattern for sign in "*?"):
            chosen = [name for name in self.names() if fnmatchcase(name, pattern)]
            if not chosen:
                raise UnknownNameError(f"{self.kind} pattern", pattern, self.names())
            return chosen
        return [self.entry(pattern).name]

    def get(self, name: str) -> Any:
        """Import and return the object called ``name``.

        Raises
        ------
        RegistryError
            If the import fails; the message carries the reason.
        """
        entry = self.entry(name)
        if entry.value is not None:
            return entry.value
        return load_target(entry.target, f"{self.kind} {name!r} from {entry.origin}")

    def describe(self, name: str) -> Description:
        """What the source states about ``name``, by reading it; imported only where ``info`` is made by a function."""
        entry = self.entry(name)
        if entry.value is not None:
            return Description(summary=getattr(getattr(entry.value, "info", None), "summary", ""))
        try:
            files = module_files(entry.module, whole_package=False)
            tree = ast.parse(files[0][1])
        except (RegistryError, SyntaxError, ValueError) as error:
            return Description(error=str(error))
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and node.name == entry.attribute:
                facts = _info_call(node, self.info_fields)
                if facts is None:
                    return self._described(name)
                return Description(summary=str(facts.pop("summary", "")), facts=facts)
            if isinstance(node, ast.FunctionDef) and node.name == entry.attribute:
                return Description(summary=(ast.get_docstring(node) or "").partition("\n")[0].rstrip("."))
        if not _binds(tree, entry.attribute):
            return Description(error=f"module {entry.module!r} has no {entry.attribute!r}")
        return Description()

    def _described(self, name: str) -> Description:
        try:
            info = self.get(name).info
        except (RegistryError, AttributeError) as error:
            return Description(error=str(error))
        facts = dict(vars(info))
        return Description(summary=str(facts.pop("summary", "")), facts=facts)


def load_target(target: str, what: str) -> Any:
    """Import ``"module:attribute"``.

    Raises
    ------
    RegistryError
        Naming ``what``, if the import fails for any reason that the module itself has.
    """
    module_name, _, attribute = target.partition(":")
    try:
        module: ModuleType = importlib.import_module(module_name)
    except Exception as error:
        raise RegistryError(f"{what} cannot be imported: {type(error).__name__}: {error}") from error
    value: Any = module
    for part in attribute.split("."):
        if not hasattr(value, part):
            raise RegistryError(f"{what} cannot be imported: module {module_name!r} has no {attribute!r}")
        value = getattr(value, part)
    return value


def _binds(tree: ast.Module, name: str) -> bool:
    return any(
        (isinstance(node, ast.Name) and node.id == name)
        or (isinstance(node, ast.alias) and (node.asname or node.name) == name)
        or (isinstance(node, ast.FunctionDef) and node.name == name)
        for node in ast.walk(tree)
    )


def _info_call(node: ast.ClassDef, positional: Sequence[str]) -> dict[str, Any] | None:
    """The literal arguments of the class's ``info``; ``None`` where a function makes it and they are not in sight."""
    for statement in node.body:
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        value = getattr(statement, "value", None)
        if any(isinstance(t, ast.Name) and t.id == "info" for t in targets) and isinstance(value, ast.Call):
            return _literals(value, positional) if ast.unparse(value.func).endswith("Info") else None
    return {}


def _literals(call: ast.Call, positional: Sequence[str]) -> dict[str, Any]:
    pairs = [*zip(positional, call.args, strict=False), *((k.arg, k.value) for k in call.keywords if k.arg)]
    facts: dict[str, Any] = {}
    for name, value in pairs:
        if name is None:
            continue
        if isinstance(value, ast.Call):
            facts[name] = _literals(value, ())
        elif isinstance(value, ast.Attribute):
            facts[name] = value.attr.lower()
        else:
            try:
                facts[name] = ast.literal_eval(value)
            except ValueError:
                continue
    return facts


METHODS = Registry(
    "method", "motion_style_benchmark.methods", "methods:BUILTIN", ("name", "summary", "capabilities", "version")
)
METRICS = Registry(
    "metric", "motion_style_benchmark.metrics", "eval:BUILTIN_METRICS", ("name", "summary", "unit", "direction")
)
PROBES = Registry("probe", "motion_style_benchmark.probes", "eval:BUILTIN_PROBES", ("name", "summary"))
DATASETS = Registry("dataset", "motion_style_benchmark.datasets", "benchmark.data:BUILTIN_DATASETS")
FIGURES = Registry("figure", "motion_style_benchmark.figures", "reports:BUILTIN_FIGURES", ("name", "summary"))

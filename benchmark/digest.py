"""Digests: canonical JSON for values, and source digests for code that is not imported.

A cell's key is the SHA-256 of the canonical JSON of everything that can change its numbers.
"""

from __future__ import annotations

import ast
import hashlib
import json
import math
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.errors import ConfigError, RegistryError


def canonical_json(value: Any) -> str:
    """The one text of ``value``: keys sorted, no spaces, shortest exact floats, tuples as lists.

    ``-0.0`` is written as ``0.0``; integers and floats stay apart. NumPy scalars and arrays are written as numbers and lists.

    Raises
    ------
    ConfigError
        For NaN, infinity, keys that are not strings and values that are not JSON; the message says where.
    """
    return json.dumps(
        _plain(value, "value"), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )


def _plain(value: Any, where: str) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ConfigError(f"{where} is {value}: only finite numbers can be part of a key")
        return value + 0.0  # turns -0.0 into 0.0
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise ConfigError(f"{where} has the key {key!r}: keys must be strings")
        return {str(key): _plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{index}]") for index, item in enumerate(value)]
    raise ConfigError(
        f"{where} is a {type(value).__name__}: only numbers, strings, lists and tables can be part of a key"
    )


def digest(value: Any) -> str:
    """SHA-256 of the canonical JSON of ``value``, as 64 hex digits."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


class VaryingDigest:
    """``digest({**fixed, **varying})`` for many ``varying``, without going through ``fixed`` each time.

    Parameters
    ----------
    fixed
        The entries that all have in common.
    varying
        Names of the others.
    """

    def __init__(self, fixed: Mapping[str, Any], varying: Iterable[str]) -> None:
        names = {*fixed, *varying}
        self._heads = {name: f"{canonical_json(name)}:" for name in names}
        self._texts = {name: canonical_json(value) for name, value in fixed.items()}
        self._order = sorted(names)

    def __call__(self, **varying: Any) -> str:
        """SHA-256 of the canonical JSON of the whole table."""
        texts = {**self._texts, **{name: _text(value) for name, value in varying.items()}}
        entries = ",".join([self._heads[name] + texts[name] for name in self._order])
        return hashlib.sha256(f"{{{entries}}}".encode()).hexdigest()


def _text(value: Any) -> str:
    return str(value) if type(value) is int else canonical_json(value)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, as 64 hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def source_digest(*modules: str) -> str:
    """Digest of the source files of ``modules``, none of which is imported; a package stands for all its modules.

    The order of ``modules``, line endings and where they are installed do not matter.

    Raises
    ------
    RegistryError
        If there is no such module.
    """
    files = {name: text for module in sorted(set(modules)) for name, text in module_files(module)}
    return digest({name: hashlib.sha256(text).hexdigest() for name, text in files.items()})


def module_files(module: str, *, whole_package: bool = True) -> list[tuple[str, bytes]]:
    """Names and contents of the source files of ``module``, sorted; line endings are normalised.

    Of a package that stands for all its modules the TOML files count too: they hold its presets.

    Parameters
    ----------
    module
        Dotted name. Neither it nor its parent packages are imported.
    whole_package
        Whether a package stands for all modules in it or for its ``__init__`` alone.

    Raises
    ------
    RegistryError
        If there is no such module, or it has no file.
    """
    spec = _spec(module)
    if spec is None:
        raise RegistryError(f"there is no module {module!r} to take the source of")
    if spec.submodule_search_locations and whole_package:
        found = [
            (f"{module}/{path.relative_to(folder).as_posix()}", path)
            for folder in map(Path, spec.submodule_search_locations)
            for pattern in ("*.py", "*.toml")
            for path in folder.rglob(pattern)
        ]
    elif spec.origin is not None and Path(spec.origin).is_file():
        found = [(f"{module}/__init__.py" if spec.submodule_search_locations else module, Path(spec.origin))]
    else:
        raise RegistryError(f"module {module!r} has no source file")
    return [(name, path.read_bytes().replace(b"\r\n", b"\n")) for name, path in sorted(found)]


def _spec(module: str) -> ModuleSpec | None:
    """The module's spec, found by walking down from its top package so that no parent is imported."""
    parts = module.split(".")
    spec = _top_spec(parts[0])
    for depth in range(1, len(parts)):
        if spec is None or not spec.submodule_search_locations:
            return None
        spec = PathFinder.find_spec(".".join(parts[: depth + 1]), list(spec.submodule_search_locations))
    return spec


def _top_spec(name: str) -> ModuleSpec | None:
    for finder in sys.meta_path:
        find = getattr(finder, "find_spec", None)
        spec = find(name, None, None) if find else None
        if spec is not None:
            return spec
    return None


def import_closure(module: str) -> tuple[str, ...]:
    """``module`` and every module of its own top-level package that it imports, directly or through others; sorted.

    Imports inside functions count; nothing is imported. A package's ``__init__`` counts only where a name is taken from it,
    so that adding a method to the list of methods leaves all others as they are.
    """
    top = module.split(".")[0]
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        waiting += [found for found in _imports(name) if found.split(".")[0] == top and found not in seen]
    return tuple(sorted(seen))


def _imports(module: str) -> list[str]:
    """The modules of its own top-level package that ``module`` imports anywhere in its source."""
    ((_, text),) = module_files(module, whole_package=False)
    spec = _spec(module)
    package = module.split(".")
    if spec is None or not spec.submodule_search_locations:
        package = package[:-1]
    found: set[str] = set()
    for base, names, level in _import_statements(text):
        if level:
            parent = package[: len(package) - level + 1]
            base = ".".join([*parent, base] if base else parent)
        if base.split(".")[0] != module.split(".")[0]:
            continue
        below = [f"{base}.{name}" for name in names if _has_file(f"{base}.{name}")]
        found.update(below)
        if len(below) < len(names) or not names:
            found.add(base)
    return sorted(name for name in found if _has_file(name))


@cache
def _import_statements(text: bytes) -> tuple[tuple[str, tuple[str, ...], int], ...]:
    """(module, names, level) of every import statement; none for what is not Python source."""
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):  # an extension module, or one whose import will say what is wrong with it
        return ()
    found: list[tuple[str, tuple[str, ...], int]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, (), 0) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append((node.module or "", tuple(alias.name for alias in node.names), node.level))
    return tuple(found)


def _has_file(module: str) -> bool:
    spec = _spec(module)
    return spec is not None and spec.origin is not None and Path(spec.origin).is_file()


def code_digest(modules: Iterable[str], declared: Iterable[str] = ()) -> str:
    """Digest of ``modules`` with all they import from their own package, and of the ``declared`` modules."""
    closure = sorted({name for module in modules for name in import_closure(module)})
    texts = {
        name: hashlib.sha256(text).hexdigest() for m in closure for name, text in module_files(m, whole_package=False)
    }
    return digest({"closure": texts, "declared": {name: source_digest(name) for name in sorted(set(declared))}})

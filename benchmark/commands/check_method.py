"""``check-method``: the conformance suite against one method or metric."""

from __future__ import annotations

import importlib
import inspect
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import click

from benchmark.errors import RegistryError, UnknownNameError
from benchmark.registry import METHODS, METRICS, load_target


@click.command("check-method")
@click.argument("name")
@click.option("--metric", is_flag=True, help="NAME is a metric, not a method.")
@click.option("-v", "--verbose", is_flag=True, help="Show what each check promises.")
@click.pass_context
def check_method(context: click.Context, name: str, metric: bool, verbose: bool) -> None:
    """Run the conformance suite against NAME and end with 1 if a check fails.

    NAME is a registered name, module:Class, or the path of a file that defines one class (path:Class if several).
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from benchmark.commands import conformance

    subject = resolve(name, metric=metric)
    outcomes = conformance.check_metric(subject) if metric else conformance.check_method(subject)

    table = Table(title=f"{subject.__module__}:{subject.__qualname__}", title_justify="left", box=None, pad_edge=False)
    for column in ("check", "outcome", *(["promise"] if verbose else []), "what to do"):
        table.add_column(column, overflow="fold", no_wrap=column in ("check", "outcome"))
    shown = {"passed": "[green]PASSED[/]", "failed": "[red]FAILED[/]", "not concerned": "[dim]not concerned[/]"}
    for outcome in outcomes:
        promise = [outcome.check.promise] if verbose else []
        table.add_row(outcome.check.name, shown[outcome.status], *promise, escape(outcome.message))
    Console().print(table)
    failed = sum(outcome.status == "failed" for outcome in outcomes)
    passed = sum(outcome.status == "passed" for outcome in outcomes)
    click.echo(f"{passed} passed, {failed} failed, {len(outcomes) - passed - failed} not concerned")
    context.exit(1 if failed else 0)


def resolve(name: str, *, metric: bool = False) -> type[Any]:
    """The class that ``name`` stands for.

    Raises
    ------
    UnknownNameError
        If nothing is registered under the name.
    RegistryError
        If a module or file cannot be imported, or holds no such class.
    """
    from benchmark.api import Method, Metric

    base: type = Metric if metric else Method
    kind, registry = ("metric", METRICS) if metric else ("method", METHODS)
    place, _, attribute = name.rpartition(":") if ":" in name else (name, "", "")
    if place.endswith(".py"):
        return _class_of(_imported(Path(place)), attribute, base, place)
    if attribute:
        found = load_target(name, f"{kind} {name!r}")
        if not (inspect.isclass(found) and issubclass(found, base)):
            raise RegistryError(f"{name!r} is no subclass of benchmark.api.{base.__name__}")
        return found
    if name not in registry:
        raise UnknownNameError(kind, name, registry.names())
    found = registry.get(name)
    if not (inspect.isclass(found) and issubclass(found, base)):
        raise RegistryError(
            f"{kind} {name!r} from {registry.origin(name)} is no subclass of benchmark.api.{base.__name__}"
        )
    return found


def _imported(path: Path) -> ModuleType:
    """Import a file under the name that it has from its topmost package on, so that its own imports work."""
    if not path.is_file():
        raise RegistryError(f"{path}: no such file")
    path = path.resolve()
    parts, folder = [path.stem], path.parent
    while (folder / "__init__.py").is_file():
        parts.insert(0, folder.name)
        folder = folder.parent
    name = ".".join(parts)
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(name)
    except Exception as error:
        raise RegistryError(f"{path} cannot be imported: {type(error).__name__}: {error}") from error
    if Path(str(module.__file__)).resolve() != path:
        raise RegistryError(f"{path} cannot be imported: {name!r} is {module.__file__}; rename the file")
    return module


def _class_of(module: ModuleType, attribute: str, base: type, place: str) -> type[Any]:
    found = {
        name: value
        for name, value in vars(module).items()
        if inspect.isclass(value) and issubclass(value, base) and value.__module__ == module.__name__
    }
    if attribute:
        if attribute not in found:
            raise UnknownNameError(f"{base.__name__.lower()} class in {place}", attribute, found)
        return found[attribute]
    if len(found) != 1:
        what = ", ".join(sorted(found)) or "none"
        raise RegistryError(
            f"{place} must define one subclass of benchmark.api.{base.__name__} (found: {what}), or say {place}:Class"
        )
    return next(iter(found.values()))

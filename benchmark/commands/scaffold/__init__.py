"""The plug-in package that ``new-method`` writes: templates, and how they are filled in."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

from benchmark.errors import ConfigError

#: Template to path in the new package; ``{module}`` is the package's import name.
FILES: dict[str, str] = {
    "pyproject.toml.j2": "pyproject.toml",
    "README.md.j2": "README.md",
    "LICENSE.j2": "LICENSE",
    "init.py.j2": "src/{module}/__init__.py",
    "method.py.j2": "src/{module}/method.py",
    "test_method.py.j2": "tests/test_method.py",
}

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def check_name(name: str) -> str:
    """Return ``name`` if a method and its package can be called so.

    Raises
    ------
    ConfigError
        Saying what a name looks like, or what already has this one.
    """
    import keyword
    import sys
    from importlib.util import find_spec

    from benchmark.registry import METHODS

    if not _NAME.fullmatch(name) or len(name) > 60:
        suggestion = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-").lstrip("-0123456789")
        hint = f"; try {suggestion!r}" if _NAME.fullmatch(suggestion) else ""
        raise ConfigError(
            f"method name {name!r} must be lower-case words and digits joined by hyphens, letter first{hint}"
        )
    if name in METHODS:
        raise ConfigError(f"there is a method {name!r} already: {METHODS.origin(name)}; choose another name")
    module = module_name(name)
    if keyword.iskeyword(module) or module in sys.stdlib_module_names or find_spec(module) is not None:
        raise ConfigError(
            f"the package of {name!r} would be called {module!r}, which Python already has; choose another name"
        )
    return name


def module_name(name: str) -> str:
    """The import name of the package of method ``name``."""
    return name.replace("-", "_")


def class_name(name: str) -> str:
    """The class name of method ``name``."""
    return "".join(part.capitalize() for part in name.split("-"))


def write(name: str, folder: Path) -> list[Path]:
    """Write the package of method ``name`` into ``folder`` and return its files.

    Raises
    ------
    ConfigError
        If the name will not do, or ``folder`` exists and is not empty; nothing is ever overwritten.
    """
    from importlib.metadata import version

    from jinja2 import Environment, StrictUndefined

    check_name(name)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder} exists already; choose another folder with --into, or remove it")
    environment = Environment(undefined=StrictUndefined, keep_trailing_newline=True, autoescape=False)
    names = {
        "name": name,
        "module": module_name(name),
        "class_name": class_name(name),
        "suite_version": version("motion-style-benchmark"),
    }
    templates = resources.files("benchmark.commands.scaffold")
    written = []
    for template, place in FILES.items():
        path = folder / place.format(module=names["module"])
        path.parent.mkdir(parents=True, exist_ok=True)
        text = environment.from_string((templates / template).read_text(encoding="utf-8")).render(names)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written

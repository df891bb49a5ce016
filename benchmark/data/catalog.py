"""From a name to a data set."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from benchmark.data.base import Dataset
from benchmark.data.cards import list_cards, load_card
from benchmark.errors import ConfigError, UnknownNameError
from benchmark.registry import DATASETS

__all__ = ["list_cards", "load_card", "open_dataset"]


def open_dataset(name: str, *, root: Path | str | None = None, **options: Any) -> Dataset:
    """Open a data set.

    Parameters
    ----------
    name
        ``synthetic``, ``kinder-gator``, ``bandai-namco``, ``adult2child``, ``folder:PATH``, or the name of a data set that
        an installed package adds.
    root
        Where its files are: an unpacked folder, an archive, or a folder that holds either. Without it the folder named by
        the environment variable ``BENCHMARK_DATA`` is searched, then what ``data fetch`` stored.
    options
        Settings of the data set; see the class of each.

    Raises
    ------
    DataError
        The files are not there, or are not what they should be.
    UnknownNameError
        No data set has that name, or it has no such option.
    ConfigError
        A folder is missing where one is needed, or given where none is.
    """
    registered, _, path = name.partition(":")
    if registered not in DATASETS:
        raise UnknownNameError(
            "data set", name, ["folder:PATH" if known == "folder" else known for known in DATASETS.names()]
        )
    opener = DATASETS.get(registered)
    keywords = dict(options)
    if registered == "folder":
        if not path and root is None:
            raise ConfigError("which folder? Write folder:PATH, for example folder:captures")
        keywords["path"] = Path(root) / path if root is not None else Path(path)
    elif path:
        raise ConfigError(f"data set {registered!r} takes no path after a colon; only folder:PATH does")
    elif root is not None:
        keywords["root"] = Path(root)
    parameters = inspect.signature(opener).parameters.values()
    known = [parameter.name for parameter in parameters]
    if "root" in keywords and "root" not in known:
        raise ConfigError(f"data set {name} is generated and has no files: leave its folder out")
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        for keyword in keywords:
            if keyword not in known:
                raise UnknownNameError(f"option of data set {name}", keyword, known)
    dataset: Dataset = opener(**keywords)
    return dataset

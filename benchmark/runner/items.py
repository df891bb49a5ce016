"""The list of a cell's clips, read back strictly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from benchmark.errors import StoreError

ITEMS = "items.json"


class _Item(BaseModel):
    """What is known of every clip."""

    model_config = ConfigDict(extra="allow", strict=True)

    clip_id: str
    actor: str
    action: str
    seen_actor: bool | None
    reference_ids: list[str]
    has_truth: bool
    state: Literal["ok", "skipped"]
    reason: str


class _Done(_Item):
    """And of one that was transferred. ``stem`` becomes part of file names."""

    stem: str
    variants: dict[str, str | None]
    copied_from: str | None
    transfer_seconds: float

    @property
    def unsafe(self) -> bool:
        """Whether the file names would lie elsewhere."""
        return Path(self.stem).name != self.stem or "\\" in self.stem or "\0" in self.stem


_LIST = TypeAdapter(list[_Item])


def read_items(folder: Path) -> list[dict[str, Any]]:
    """The clips of the cell in ``folder``, as they were written.

    Raises
    ------
    StoreError
        Naming the file and the field that is not what it should be.
    """
    path = folder / ITEMS
    try:
        content = json.loads(path.read_bytes())
        _LIST.validate_python(content)
        for index, item in enumerate(content):
            if item["state"] == "ok":
                _check_done(path, index, item)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the list"
        raise StoreError(f"{path}: {where}: {first['msg']}; run the cell again") from error
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError(f"{path} is damaged ({error}): run the cell again") from error
    found: list[dict[str, Any]] = content
    return found


def _check_done(path: Path, index: int, item: dict[str, Any]) -> None:
    done = _Done.model_validate(item)
    if done.unsafe:
        raise StoreError(f"{path}: {index}.stem: {done.stem!r} is no plain file name; run the cell again")

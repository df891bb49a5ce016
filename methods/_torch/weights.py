"""Weights as safetensors, with JSON facts in the same file, and their size."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from benchmark.errors import StoreError

_FACTS = "facts"


def write_tensors(path: Path, tensors: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
    """Write tensors and JSON-ready ``facts`` into one file, whole or not at all, even if the machine stops.

    One file and one rename: weights and the facts about them can never be of different moments.
    """
    import os
    import secrets

    from safetensors.torch import save

    # Parameters that share memory (a tied decoder) are refused by the format unless each has its own copy.
    data = save(
        {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()},
        metadata={_FACTS: json.dumps(facts, sort_keys=True, allow_nan=False)},
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    try:
        with aside.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What :func:`write_tensors` wrote, on the CPU; a ``StoreError`` for a file that is not of that kind."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            facts = json.loads((file.metadata() or {})[_FACTS])
            return {name: file.get_tensor(name) for name in file.keys()}, facts  # noqa: SIM118 - not a dict
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise StoreError(f"{path} holds no weights of this suite ({error}): remove it and fit again") from error


def save_weights(path: Path, modules: Mapping[str, nn.Module], facts: Mapping[str, Any] | None = None) -> None:
    """Write the parameters and buffers of ``modules``, named ``module/parameter``, with JSON-ready ``facts``."""
    tensors = {f"{name}/{key}": value for name, module in modules.items() for key, value in module.state_dict().items()}
    write_tensors(path, tensors, facts or {})


def load_weights(path: Path, modules: Mapping[str, nn.Module]) -> dict[str, Any]:
    """Fill ``modules`` with what :func:`save_weights` wrote and return its ``facts``.

    Raises
    ------
    StoreError
        If the file is no such file, or its weights do not fit the modules.
    """
    tensors, facts = read_tensors(path)
    for name, module in modules.items():
        try:
            module.load_state_dict(under(tensors, f"{name}/"))
        except RuntimeError as error:
            raise StoreError(f"the weights in {path} are of another network: {error}") from error
    return facts


def under(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names start with ``prefix``, without it."""
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def size(*modules: nn.Module) -> dict[str, int]:
    """Number of parameters, and bytes of parameters and buffers."""
    parameters = sum(parameter.numel() for module in modules for parameter in module.parameters())
    tensors: list[Tensor] = [value for module in modules for value in (*module.parameters(), *module.buffers())]
    return {"parameters": parameters, "bytes": sum(tensor.numel() * tensor.element_size() for tensor in tensors)}


def all_finite(*modules: nn.Module) -> bool:
    """Whether no parameter or buffer is NaN or infinite."""
    return all(
        bool(torch.isfinite(value).all())
        for module in modules
        for value in (*module.parameters(), *module.buffers())
        if value.is_floating_point()
    )

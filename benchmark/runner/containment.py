"""What a method may change in its process and forget to change back."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np


@contextlib.contextmanager
def restored() -> Iterator[None]:
    """Put back, when the block ends, what of the process the block has changed.

    Working directory, environment, file mode mask, signal handlers and timers, standard streams, search path, recursion limit,
    tracing, warning filters, NumPy's error handling, the global generators of Python and NumPy, and torch's threads, precision
    and switches. What is scored afterwards in this process, or run after it, must not depend on any of them.
    """
    with contextlib.ExitStack() as stack:
        # Put back in the other order: what the rest needs comes last here.
        stack.callback(_put_back_torch, _torch_now())
        _keep_places(stack)
        if threading.current_thread() is threading.main_thread():
            _keep_signals(stack)
        _keep_interpreter(stack)
        yield


def _keep_places(stack: contextlib.ExitStack) -> None:
    environment = dict(os.environ)
    folder = os.open(".", os.O_RDONLY)  # also where its name is changed meanwhile
    mask = os.umask(0o077)
    os.umask(mask)

    def put_back() -> None:
        if dict(os.environ) != environment:
            os.environ.clear()
            os.environ.update(environment)
        with contextlib.suppress(OSError):
            os.fchdir(folder) if hasattr(os, "fchdir") else None
        with contextlib.suppress(OSError):
            os.close(folder)
        os.umask(mask)

    stack.callback(put_back)


def _keep_interpreter(stack: contextlib.ExitStack) -> None:
    streams = sys.stdin, sys.stdout, sys.stderr
    path, limit = list(sys.path), sys.getrecursionlimit()
    numbers, ours = np.random.get_state(), random.getstate()  # noqa: NPY002 - a method may have drawn from it
    errors = np.geterr()
    stack.enter_context(warnings.catch_warnings())

    def put_back() -> None:
        sys.stdin, sys.stdout, sys.stderr = streams
        sys.path[:] = path
        sys.setrecursionlimit(limit)
        sys.settrace(None)
        np.random.set_state(numbers)  # noqa: NPY002
        random.setstate(ours)
        np.seterr(**errors)

    stack.callback(put_back)


def _keep_signals(stack: contextlib.ExitStack) -> None:
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}

    def put_back() -> None:
        if hasattr(signal, "setitimer"):
            for timer in (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL, signal.ITIMER_PROF):
                signal.setitimer(timer, 0.0)
        for number, handler in handlers.items():
            # None: a handler that was not set from Python, which cannot be put back from there either.
            if handler is not None and signal.getsignal(number) is not handler:
                with contextlib.suppress(OSError, ValueError):
                    signal.signal(number, handler)

    stack.callback(put_back)


#: How torch starts.
_TORCH = {"dtype": "float32", "gradients": True, "strict": False, "precision": "highest"}


def _torch_now() -> dict[str, Any]:
    """Torch's switches as they are; as it starts where it is not imported."""
    torch = sys.modules.get("torch")
    if torch is None:
        return {**_TORCH, "threads": int(os.environ.get("OMP_NUM_THREADS", "0"))}
    return {
        "dtype": str(torch.get_default_dtype()).removeprefix("torch."),
        "gradients": torch.is_grad_enabled(),
        "strict": torch.are_deterministic_algorithms_enabled(),
        "precision": torch.get_float32_matmul_precision(),
        "threads": torch.get_num_threads(),
    }


def _put_back_torch(before: dict[str, Any]) -> None:
    torch = sys.modules.get("torch")
    if torch is None:
        return
    now = _torch_now()
    if now["dtype"] != before["dtype"]:
        torch.set_default_dtype(getattr(torch, before["dtype"]))
    torch.set_grad_enabled(before["gradients"])
    torch.set_float32_matmul_precision(before["precision"])
    if now["strict"] != before["strict"]:  # imports much of torch
        torch.use_deterministic_algorithms(before["strict"])
    if before["threads"] and now["threads"] != before["threads"]:
        torch.set_num_threads(before["threads"])

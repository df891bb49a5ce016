"""Makes the fork server answer for every process that a method leaves behind.

The fork server imports this module when it starts; nothing else may. From then on processes whose parents have ended
become its children, also those that left their process group, and when the run ends, however it ends, it ends them
all. Without it they would outlive a run that is killed, and so would a worker that is stuck in code which never lets
another thread run.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import sys
import time
import warnings
from types import FrameType

import psutil

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36


def end_descendants(seconds: float = 10.0) -> None:
    """Kill every process below this one, and those that become its children as their parents end."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        below = psutil.Process().children(recursive=True)
        if not below:
            return
        for process in below:
            with contextlib.suppress(psutil.Error):
                process.kill()
        time.sleep(0.005)


def _answer_for_orphans() -> None:
    server, run = os.getpid(), os.getppid()
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)

    def end() -> None:
        if os.getpid() == server:  # not in a worker, which inherits this
            end_descendants()

    def parent_ended(number: int, frame: FrameType | None) -> None:
        # The signal also comes when only the thread that started this server ends.
        if os.getpid() == server and os.getppid() != run:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            end()
            os._exit(0)

    # Workers hold the pipe by which a fork server notices the end of its run, so the end of a stuck one must not wait for that.
    signal.signal(signal.SIGTERM, parent_ended)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    atexit.register(end)
    warnings.filterwarnings("ignore", message="forkserver: waitpid returned unexpected pid")


if sys.platform == "linux":
    _answer_for_orphans()

"""Methods that do what no method should: by mistake, or on purpose."""

from __future__ import annotations

import ctypes
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import fakebench
import numpy as np
from fakebench import Copy, _info

from benchmark.api import TransferResult


class Stuck(Copy):
    """Hangs in C code that never lets another thread run."""

    info = _info("stuck")

    def fit(self, train, task, *, rng, ctx):
        re.match(r"(a+)+$", "a" * 64 + "b")
        return self


class Leaks(Copy):
    """Takes more and more memory; gives up where nobody stops it, for the sake of the machine."""

    info = _info("leaks")

    def fit(self, train, task, *, rng, ctx):
        self.hoard = []
        for _ in range(60):
            self.hoard.append(np.ones(1 << 22))  # 32 MiB, touched
            time.sleep(0.05)
        raise AssertionError("nobody noticed")


class LeaksInChild(Copy):
    """Lets a process of its own take the memory."""

    info = _info("leaks-in-child")

    def fit(self, train, task, *, rng, ctx):
        code = "import time\nx = bytearray(1 << 30)\nx[::4096] = b'1' * len(x[::4096])\ntime.sleep(60)"
        subprocess.run([sys.executable, "-c", code], check=False)
        return self


class Leaves(Copy):
    """Leaves processes behind: in its group, in a session of their own, and one whose parent has ended."""

    info = _info("leaves")

    def fit(self, train, task, *, rng, ctx):
        subprocess.Popen(["sleep", "300"])
        subprocess.Popen(["sleep", "301"], start_new_session=True)
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                time.sleep(302)
            os._exit(0)
        return self


class Abandons(Leaves):
    """Leaves processes behind and ends at once, so that nobody can ask it which."""

    info = _info("abandons")

    def fit(self, train, task, *, rng, ctx):
        super().fit(train, task, rng=rng, ctx=ctx)
        os._exit(3)


class Shouts(Copy):
    """Prints a gigabyte."""

    info = _info("shouts")

    def fit(self, train, task, *, rng, ctx):
        print("the first words", flush=True)
        line = b"x" * (1 << 20)
        for _ in range(1024):
            os.write(1, line)
        print("the last words", flush=True)
        os.abort()


class Exits(Copy):
    info = _info("exits")

    def fit(self, train, task, *, rng, ctx):
        sys.exit("enough")


class ExitsInTransfer(Copy):
    info = _info("exits-in-transfer")

    def transfer(self, source, task, *, rng):
        raise SystemExit(0)


class ExitsHard(Copy):
    info = _info("exits-hard")

    def fit(self, train, task, *, rng, ctx):
        os._exit(0)


class Interrupts(Copy):
    info = _info("interrupts")

    def fit(self, train, task, *, rng, ctx):
        raise KeyboardInterrupt


class Own(BaseException):
    """An exception that nobody expects."""


class RaisesBase(Copy):
    info = _info("raises-base")

    def fit(self, train, task, *, rng, ctx):
        raise Own("nobody expects me")


class Meddles(Copy):
    """Changes everything of its process that a metric could depend on."""

    info = _info("meddles")

    def fit(self, train, task, *, rng, ctx):
        import torch

        np.random.seed(1)  # noqa: NPY002
        random.seed(1)
        torch.manual_seed(1)
        torch.set_num_threads(3)
        torch.set_default_dtype(torch.float64)
        np.seterr(all="raise")
        os.environ["OMP_NUM_THREADS"] = "7"
        os.environ.pop("PATH", None)
        os.chdir("/")
        os.umask(0o777)
        sys.setrecursionlimit(7000)
        sys.stdout = sys.stderr = None
        return self


class Handles(Copy):
    """Takes the signals, and lets one come later."""

    info = _info("handles")

    def fit(self, train, task, *, rng, ctx):
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD, signal.SIGUSR1):
            signal.signal(number, lambda *_: None)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, 100.0)
        return self


class WrongRate(Copy):
    info = _info("wrong-rate")

    def transfer(self, source, task, *, rng):
        return TransferResult(source.replace(fps=source.fps * 2))


class Huge(Copy):
    info = _info("huge", changes_timing=True)

    def transfer(self, source, task, *, rng):
        return TransferResult(
            source.replace(
                rotations=np.repeat(source.rotations, 2000, axis=0), root=np.repeat(source.root, 2000, axis=0)
            )
        )


class ForeignSkeleton(Copy):
    info = _info("foreign-skeleton")

    def transfer(self, source, task, *, rng):
        names = tuple(f"bone{index}" for index in range(len(source.skeleton)))
        skeleton = source.skeleton
        return TransferResult(source.replace(skeleton=type(skeleton)(names, skeleton.parents, skeleton.offsets)))


class Nothing(Copy):
    info = _info("nothing")

    def transfer(self, source, task, *, rng):
        return None


class Closes(Copy):
    """Closes every file, the connection to the run among them."""

    info = _info("closes")

    def fit(self, train, task, *, rng, ctx):
        os.closerange(0, 256)
        time.sleep(60)
        return self


class KillsServer(Copy):
    """Ends the process that all workers come from."""

    info = _info("kills-server")

    def fit(self, train, task, *, rng, ctx):
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(60)
        return self


class Scribbles(Copy):
    """Spoils every other cell, the tables and the settings; leaves rubbish."""

    info = _info("scribbles")

    def fit(self, train, task, *, rng, ctx):
        run = ctx.work_dir.parent.parent
        for cell in (run / "cells").glob("[!.]*"):
            (cell / "items.json").write_text("[]")
            (cell / "rubbish.txt").write_text("rubbish")
        (run / "cells" / "rubbish").mkdir(exist_ok=True)
        for name in ("results.parquet", "leaderboard.csv", "plan.json", ".views.json"):
            (run / name).write_text("rubbish")
        return self


class BadSurrogate(Copy):
    """Raises with a text that no file can hold, and reports one."""

    info = _info("bad-text")

    def fit(self, train, task, *, rng, ctx):
        ctx.report(float("nan"), "\ud800\0\x1b[2J")
        raise ValueError("\ud800 and a \0")


class BadSave(Copy):
    """Learns, and cannot be stored."""

    info = _info("bad-save")

    def save(self, folder: Path) -> None:
        ctypes.string_at(0)


METHODS = {
    cls.info.name: f"hostile:{cls.__name__}"
    for cls in (
        *(
            Stuck,
            Leaks,
            LeaksInChild,
            Leaves,
            Abandons,
            Shouts,
            Exits,
            ExitsInTransfer,
            ExitsHard,
            Interrupts,
            RaisesBase,
        ),
        *(Meddles, Handles, WrongRate, Huge, ForeignSkeleton, Nothing, Closes, KillsServer, Scribbles),
        *(BadSurrogate, BadSave),
    )
} | fakebench.METHODS

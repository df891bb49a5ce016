"""Where a run's numbers come from: commit, versions, hardware, threads, time and command."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

#: Packages whose versions can matter to a number.
PACKAGES = (
    "motion-style-benchmark",
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "scikit-learn",
    "statsmodels",
    "torch",
    "threadpoolctl",
)


def environment(*, threads: int, jobs: int) -> dict[str, Any]:
    """The facts of this machine and moment; nothing heavy is imported to learn them."""
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "git": git_state(Path(__file__).resolve().parents[2]),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": versions(),
        "hardware": hardware(),
        "threads": threads,
        "jobs": jobs,
        "gpu": gpu_usable(),
    }


def versions() -> dict[str, str]:
    """Installed versions of :data:`PACKAGES`."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def git_state(folder: Path) -> dict[str, Any] | None:
    """Commit and whether the working tree differs from it; ``None`` outside a repository."""
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        dirty = bool(_git(folder, "status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": commit, "dirty": dirty}


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()


def hardware() -> dict[str, Any]:
    """Processor, cores and memory."""
    import psutil

    return {
        "processor": processor(),
        "cores": psutil.cpu_count(logical=False),
        "threads": os.cpu_count(),
        "memory_bytes": psutil.virtual_memory().total,
    }


def processor() -> str:
    """Its name."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


@cache
def gpu_usable() -> bool:
    """Whether torch was built for CUDA and the driver sees a device; found without importing torch."""
    spec = find_spec("torch")
    if spec is None or spec.origin is None:
        return False
    built = Path(spec.origin).with_name("version.py")
    if not built.is_file():
        return False
    lines = [line for line in built.read_text(encoding="utf-8").splitlines() if line.startswith("cuda")]
    if not any("=" in line and line.rpartition("=")[2].strip() not in ("None", "") for line in lines):
        return False
    import ctypes

    count = ctypes.c_int(0)
    try:
        driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
        return driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0
    except OSError:
        return False

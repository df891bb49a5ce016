"""Fixtures shared by every test."""

from __future__ import annotations

import os
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Continuous integration tries the same examples each time, so that it fails only for what a change did.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

REPOSITORY = Path(__file__).resolve().parents[1]


def _find_real_data() -> Path | None:
    named = os.environ.get("BENCHMARK_DATA")
    candidate = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not candidate.is_absolute():
        candidate = REPOSITORY / candidate
    return candidate if (candidate / "kinder-gator-subset.zip").exists() else None


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of archives of real captures."""
    folder = _find_real_data()
    if folder is None:
        pytest.skip("no real captures: set BENCHMARK_DATA to a folder that holds kinder-gator-subset.zip")
    return folder


def _unpacked(archive: Path, target: Path) -> Path:
    with zipfile.ZipFile(archive) as file:
        file.extractall(target)
    (root,) = target.iterdir()
    return root


@pytest.fixture(scope="session")
def kinder_gator(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Kinder-Gator, unpacked: the folder that holds ``Adults`` and ``Children``."""
    return _unpacked(real_data / "kinder-gator-subset.zip", tmp_path_factory.mktemp("kinder-gator"))


@pytest.fixture(scope="session")
def bandai_namco(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bandai-Namco, unpacked: the folder that holds ``dataset``."""
    return _unpacked(real_data / "bandai-namco-subset.zip", tmp_path_factory.mktemp("bandai-namco"))


@pytest.fixture
def rng() -> np.random.Generator:
    """A fixed generator."""
    return np.random.default_rng(20201016)


#: What keeps a chromium from asking for anything by itself.
_QUIET = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A headless chromium, the system's own; ``CHROMIUM`` names another one.

    One for each module: while it lives, its event loop runs in this thread, and ``asyncio.run`` is refused.
    """
    sync_api = pytest.importorskip("playwright.sync_api")
    names = (os.environ.get("CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome")
    executable = next((found for name in names if name and (found := shutil.which(name))), None)
    if executable is None:
        pytest.skip("no chromium: install it, or name one by CHROMIUM")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(_QUIET))
        yield browser
        browser.close()

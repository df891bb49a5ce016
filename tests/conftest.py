"""Fixtures shared by every test."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

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

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

import ppt_rl.envs  # noqa: F401  before any test imports MuJoCo: it chooses the backend of rendering

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))


torch.set_num_threads(1)  # the tensors here are small: more threads only get in each other's way


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


@pytest.fixture
def root() -> Path:
    """Top of the repository."""
    return ROOT

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
import torch

import ppt_rl.envs  # noqa: F401  before any test imports MuJoCo: it chooses the backend of rendering

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))


torch.set_num_threads(1)  # fixtures of modules run before the first test does


@pytest.fixture(autouse=True)
def _torch_as_new() -> None:
    """Each test begins with the same seed, and with one thread, since the tensors here are small."""
    torch.manual_seed(0)
    torch.set_num_threads(1)


@pytest.fixture
def root() -> Path:
    """Top of the repository."""
    return ROOT


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--engine", choices=["threads", "warp"], help="engine of every environment for which a test names none"
    )


def pytest_configure(config: pytest.Config) -> None:
    name = config.getoption("--engine")
    if name is not None:
        os.environ["PPT_RL_ENGINE"] = name  # worker processes inherit it

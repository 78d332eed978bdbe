from __future__ import annotations

import pytest

from ppt_rl import load_policy


@pytest.fixture(scope="package")
def policy():
    """The published policy, in a world that is quick to simulate."""
    return load_policy("ppt_push").with_changes(num_threads=1, physics_dt=0.0005, duration=0.3)

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

import ppt_rl
from ppt_rl.evaluation import published_policies, shipped_recipes


def test_the_top_level_names_are_few_and_there():
    assert sorted(ppt_rl.__all__) == ["Policy", "__version__", "load_policy"]
    assert all(hasattr(ppt_rl, name) for name in ppt_rl.__all__)
    assert ppt_rl.__version__.count(".") >= 1
    with pytest.raises(AttributeError, match="has no attribute 'loadpolicy'; it has"):
        _ = ppt_rl.loadpolicy


def test_importing_the_package_imports_no_heavy_library():
    code = (
        "import ppt_rl, sys; print([name for name in ('torch', 'torchrl', 'mujoco', 'numpy') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_every_variant_has_a_published_policy():
    assert set(published_policies()) == {*shipped_recipes(), "ppt_push_position", "s_push_position"}


@pytest.mark.parametrize("name", ["ppt_push", "s_push", "ppt_push_position"])
def test_a_stranger_needs_a_name_an_environment_and_an_actor(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy = ppt_rl.load_policy(name)
    env = policy.make_env(num_envs=4)
    with torch.no_grad():
        rollout = env.rollout(2, policy.actor)
    assert rollout["action"].isfinite().all()
    assert rollout.shape[0] == 4

"""The record of the energy in the virtual spring, against energy computed by hand."""

import math

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import Compose, Transform, TransformedEnv
from torchrl.envs.utils import check_env_specs

from ppt_rl.envs import ArmEnv, EngineConfig
from ppt_rl.evaluation.spring_energy import SpringEnergyTransform
from ppt_rl.modules import CartesianImpedanceController, Kinematics
from ppt_rl.transforms import ImpedanceTransform, JointTorqueTransform


@pytest.fixture
def env():
    base = ArmEnv(3, seed=0, duration=0.5, dtype=torch.float64, engine=EngineConfig(physics_dt=0.002, num_threads=1))
    controller = CartesianImpedanceController((100.0, 200.0, 400.0, 10.0, 20.0, 30.0)).double()
    kinematics = Kinematics(base.arm, base.tool_length, dtype=torch.float64)
    chain = JointTorqueTransform(kinematics), ImpedanceTransform(controller), SpringEnergyTransform(controller)
    return TransformedEnv(base, Compose(*chain))


def reference(pose, offset, turn=0.0):
    """References displaced by an offset (3,) and turned by an angle about the vertical."""
    w, x, y, z = pose[:, 3:].unbind(-1)
    c, s = math.cos(turn / 2), math.sin(turn / 2)
    turned = torch.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], -1)
    return torch.cat([pose[:, :3] + torch.tensor(offset), turned, torch.zeros(len(pose), 6)], -1).double()


def test_the_energy_is_half_the_stiffness_times_the_square_of_the_error(env):
    tensordict = env.reset()
    assert (tensordict["spring_energy"] == 0).all()
    action = reference(tensordict["pose"], (0.02, -0.01, 0.03), turn=0.1)
    after = env.step(tensordict.set("action", action))["next"]
    expected = 0.5 * (100 * 0.02**2 + 200 * 0.01**2 + 400 * 0.03**2 + 30 * math.sin(0.1) ** 2)
    assert_close(after["spring_energy"], torch.full((3, 1), expected).double(), rtol=1e-3, atol=0)


def test_it_is_the_largest_of_the_episode_and_starts_again_with_the_next(env):
    tensordict = env.reset()
    for offset in (0.01, 0.05, 0.0):
        action = reference(tensordict["pose"], (offset, 0.0, 0.0))
        tensordict = env.step(tensordict.set("action", action))["next"]
    assert_close(tensordict["spring_energy"], torch.full((3, 1), 0.5 * 100 * 0.05**2).double(), rtol=0.02, atol=0)
    mask = torch.tensor([[True], [False], [False]])
    again = env.reset(tensordict.clone().set("_reset", mask))
    assert again["spring_energy"][0] == 0
    assert_close(again["spring_energy"][1:], tensordict["spring_energy"][1:])


def test_a_softened_spring_holds_less(env):
    class Softened(Transform):
        """Writes the factor that an impedance with a softened spring writes."""

        def _call(self, next_tensordict):
            return next_tensordict.set("stiffness_factor", torch.full((3, 1), 0.25).double())

        def _reset(self, tensordict, tensordict_reset):
            return self._call(tensordict_reset)

    env.transform.insert(0, Softened())
    tensordict = env.reset()
    after = env.step(tensordict.set("action", reference(tensordict["pose"], (0.02, 0.0, 0.0))))["next"]
    assert_close(after["spring_energy"], torch.full((3, 1), 0.25 * 0.5 * 100 * 0.02**2).double(), rtol=1e-3, atol=0)


def test_it_fits_its_specs(env):
    check_env_specs(env)

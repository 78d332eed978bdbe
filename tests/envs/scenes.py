"""Environments, chains and rollouts that several test files use."""

from __future__ import annotations

import ctypes.util
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv

from ppt_rl.arms import PANDA
from ppt_rl.envs import PandaEnv, PandaPushEnv
from ppt_rl.modules.impedance import CartesianImpedanceController
from ppt_rl.modules.kinematics import Kinematics
from ppt_rl.transforms.impedance import ImpedanceTransform
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from tests.engines import write_state

#: A test that needs pictures.
opengl = pytest.mark.skipif(
    not (ctypes.util.find_library("EGL") or ctypes.util.find_library("OSMesa")),
    reason="no OpenGL library for off-screen rendering: neither EGL nor OSMesa",
)
#: Mid-air, in front of the arm, tool down.
MID_AIR = (0.45, 0.0, 0.35, 0.0, 1.0, 0.0, 0.0)


class MidAirEnv(PandaEnv):
    """An environment that starts with free space in every direction."""

    start_pose = MID_AIR


def from_joint_positions(start: Tensor) -> type[PandaEnv]:
    """A class of environments that start at given joint positions, ``(num_envs, 7)``."""

    class Env(PandaEnv):
        def _begin(self, rows: Tensor) -> Tensor:
            return start[rows]

    return Env


def impedance_chain(
    env: PandaEnv, controller: CartesianImpedanceController | None = None, *between: Any, **posture: float
) -> EnvBase:
    """The environment with a reference pose and twist as its action; ``between`` are transforms of the wrench."""
    controller = CartesianImpedanceController() if controller is None else controller
    joints = JointTorqueTransform(Kinematics(env.arm, env.tool_length), **posture)
    return TransformedEnv(env, Compose(joints, *between, ImpedanceTransform(controller)))


def torques(env: PandaEnv, steps: int, seed: int = 0, scale: float = 0.05) -> Tensor:
    """Random torques ``(num_envs, steps, 7)``, uniform within ``scale`` times the limits."""
    unit = 2 * torch.rand(env.num_envs, steps, 7, generator=torch.Generator().manual_seed(seed), dtype=env.dtype) - 1
    return scale * unit * torch.tensor(PANDA.joints.torque_limits, dtype=env.dtype)


def act(env: EnvBase, observation: TensorDictBase, action: Tensor | None = None) -> TensorDictBase:
    """The observation after one step; the default action is zero torque."""
    root = observation.exclude("reward")
    return env.step(root.set("action", env.action_spec.zero() if action is None else action))["next"]


def rollout(env: PandaEnv, actions: Tensor) -> TensorDictBase:
    """Rollout of given actions from a reset, across the ends of episodes."""
    steps = iter(actions.unbind(1))
    policy = lambda td: td.set("action", next(steps))  # noqa: E731
    return env.rollout(actions.shape[1], policy, break_when_any_done=False)


def leaves(td: TensorDictBase) -> dict[str, Tensor]:
    """The tensors of a tensordict by name."""
    return {"/".join(k) if isinstance(k, tuple) else k: v for k, v in td.items(True, True)}


def put_box(env: PandaPushEnv, row: int, position: Any, quat: Any = (1.0, 0.0, 0.0, 0.0)) -> None:
    """Move the box of one environment behind its back; the box is at rest afterwards."""
    write_state(env, row, slice(8, 15), [*position, *quat])  # after the time and 7 joints
    write_state(env, row, slice(22, 28), 0.0)


def forwarded(model: Any, state: np.ndarray) -> Any:
    """MuJoCo data of a full physics state, after the forward computation."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_forward(model, data)
    return data


def assert_same(a, b, rows=slice(None)):
    """Assert that all tensors of two tensordicts are bitwise equal in some rows."""
    a, b = leaves(a), leaves(b)
    assert a.keys() == b.keys()
    for name in a:
        assert torch.equal(a[name][rows], b[name][rows]), name

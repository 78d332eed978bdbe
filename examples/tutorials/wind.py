"""A point mass in a wind: a task in fifty lines of torch, for the tutorials on learning."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase


class Wind(EnvBase):
    """Bring a mass of 1 kg to a target within a second, through a wind that blows in the middle of the way.

    The action is a force in x and y [N]. Position, velocity, the last force, target and wind are observed. The reward
    is the negative squared distance to the target at the end [m^2], times 100, and 0 before. Everything is batched: all
    environments step together.

    Args:
        num_envs: number of environments.
        seed: seed of targets and winds.
    """

    control_dt = 0.02  # [s]; the transforms take it from here
    horizon = 50
    names = ("joint_position", "joint_velocity", "force", "target", "wind")

    def __init__(self, num_envs: int = 1, seed: int | None = None) -> None:
        super().__init__(batch_size=[num_envs])
        shape, column = (num_envs, 2), (num_envs, 1)
        self.observation_spec = Composite({name: Unbounded(shape) for name in self.names}, shape=self.batch_size)
        self.observation_spec["success"] = Unbounded(column, dtype=torch.bool)
        self.action_spec = Bounded(-50.0, 50.0, shape=shape)
        self.reward_spec = Unbounded(column)
        self.set_seed(seed)

    def _set_seed(self, seed: int | None) -> None:
        self.rng = torch.Generator().manual_seed(0 if seed is None else seed)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: object) -> TensorDictBase:
        def draw(low: float, high: float) -> torch.Tensor:
            return low + (high - low) * torch.rand(self.num_envs, 1, generator=self.rng)

        rows = slice(None) if tensordict is None or "_reset" not in tensordict else tensordict["_reset"].reshape(-1)
        if not hasattr(self, "state"):
            zeros = torch.zeros(self.num_envs, 2)
            self.state = {name: zeros.clone() for name in self.names}
            self.step_count = torch.zeros(self.num_envs, 1)
        fresh = {
            "joint_position": torch.zeros(self.num_envs, 2),
            "joint_velocity": torch.zeros(self.num_envs, 2),
            "force": torch.zeros(self.num_envs, 2),
            "target": torch.cat([draw(0.4, 0.6), draw(-0.2, 0.2)], -1),
            "wind": torch.cat([torch.zeros(self.num_envs, 1), draw(-8.0, 8.0)], -1),
        }
        for name, value in fresh.items():
            self.state[name][rows] = value[rows]
        self.step_count[rows] = 0
        return self._observed(torch.zeros(self.num_envs, 1, dtype=torch.bool))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state, dt = self.state, self.control_dt
        inside = (state["joint_position"][:, :1] - 0.25).abs() < 0.15  # where the wind blows
        state["force"] = tensordict["action"].detach()
        acceleration = state["force"] + state["wind"] * inside  # mass 1 kg
        state["joint_velocity"] = state["joint_velocity"] + dt * acceleration
        state["joint_position"] = state["joint_position"] + dt * state["joint_velocity"]
        self.step_count += 1
        over = self.step_count >= self.horizon
        distance = (state["joint_position"] - state["target"]).norm(dim=-1, keepdim=True)
        following = self._observed(over & (distance < 0.02))
        following.update({"reward": -100 * distance**2 * over, "done": over, "terminated": over})
        return following

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self.batch_size[0]

    def _observed(self, success: torch.Tensor) -> TensorDictBase:
        return TensorDict({**{k: v.clone() for k, v in self.state.items()}, "success": success}, self.batch_size)

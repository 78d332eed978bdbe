"""Small environments for the tests: cheap, deterministic, with their whole state in the tensordict."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from ppt_rl.arms import PANDA


class MockArmEnv(EnvBase):
    """Everything a Panda observes, as sines of the step count that the actions push up and down.

    The next observation is a function of observation and action in the tensordict, so one instance can follow several
    trajectories at once. ``executed`` is the action as it arrived.

    Args:
        batch_size: batch-locked batch.
        action_shape: of one row.
        action_key: the action.
        prefix: nest of pose, twist, wrench and via-points.
        horizons: steps after which the rows are done; repeated over the batch.
        honours_step: whether rows outside the ``_step`` mask stand still; else every row moves and a row is done at its
            horizon only, not after it.
        dtype: of everything.
        reward_terms: whether rewards are split into terms.
        via_points: whether there are via-points.
        device: of everything; on ``"meta"`` there are shapes and no values.
    """

    control_dt: float | None = 0.01
    #: The next observation follows from the tensordict alone.
    state_in_tensordict = True

    def __init__(
        self,
        batch_size: Sequence[int] = (),
        *,
        action_shape: Sequence[int] = (7,),
        action_key: NestedKey = "action",
        prefix: tuple[str, ...] = (),
        horizons: Sequence[int] = (6,),
        honours_step: bool = True,
        dtype: torch.dtype = torch.float32,
        reward_terms: bool = True,
        via_points: bool = True,
        device: str = "cpu",
    ) -> None:
        super().__init__(device=torch.device(device), batch_size=torch.Size(batch_size))
        self.via_points = via_points
        self.dtype, self.prefix, self.honours_step, self.reward_terms = dtype, prefix, honours_step, reward_terms
        self.action_name = action_key
        rows = self.batch_size.numel()
        ends = torch.tensor([horizons[i % len(horizons)] for i in range(rows)])
        self.ends = ends.reshape(*self.batch_size, 1).to(device)
        self.action_shape = tuple(action_shape)
        example = self._observe(self._zeros(1), self._zeros(1), self._zeros(1), self._zeros(*self.action_shape))
        self.observation_spec = self._spec(example)
        self.action_spec = self._spec(TensorDict({action_key: self._zeros(*self.action_shape)}, self.batch_size))
        self.reward_spec = Unbounded(shape=(*self.batch_size, 1), dtype=dtype, device=device)
        self.set_seed(0)

    def _zeros(self, *shape: int) -> Tensor:
        return torch.zeros(*self.batch_size, *shape, dtype=self.dtype, device=self.device)

    def _spec(self, example: TensorDictBase) -> Composite:
        leaves = {}
        for key, value in example.items():
            if isinstance(value, TensorDictBase):
                leaves[key] = self._spec(value)
            elif value.dtype is torch.bool:
                leaves[key] = Binary(shape=value.shape, dtype=torch.bool, device=self.device)
            else:
                leaves[key] = Unbounded(shape=value.shape, dtype=value.dtype, device=self.device)
        return Composite(leaves, shape=example.batch_size, device=self.device)

    def _named(self, name: str) -> NestedKey:
        return (*self.prefix, name) if self.prefix else name

    def _observe(self, count: Tensor, offset: Tensor, push: Tensor, executed: Tensor) -> TensorDict:
        def wave(size: int, gain: float = 1.0) -> Tensor:
            index = torch.arange(1, size + 1, dtype=self.dtype, device=self.device)
            return gain * (torch.sin(0.7 * index * count + 6.0 * offset + index) + push)

        yaw = wave(1, 0.1)
        pose = torch.cat([0.4 + wave(3, 0.05), torch.zeros_like(yaw), (yaw / 2).cos(), (yaw / 2).sin(), 0 * yaw], -1)
        td = TensorDict(
            {
                "count": count,
                "offset": offset,
                "push": push,
                "executed": executed,
                "joint_position": torch.tensor(PANDA.home, dtype=self.dtype, device=self.device) + wave(7, 0.1),
                "joint_velocity": wave(7),
                self._named("pose"): pose,
                self._named("twist"): wave(6),
                self._named("wrench"): wave(6, 5.0),
                self._named("start_heading"): wave(1),
            },
            self.batch_size,
        )
        if self.via_points:
            like = {"dtype": self.dtype, "device": self.device}
            phase, cov = torch.tensor((0.25, 1.0), **like), 1e-4 * torch.eye(3, **like)
            td[self._named("via_phase")] = phase.expand(*self.batch_size, 2).clone()
            td[self._named("via_position")] = wave(6, 0.1).unflatten(-1, (2, 3))
            td[self._named("via_cov")] = cov.expand(*self.batch_size, 2, 3, 3).clone()
            td[self._named("via_mask")] = torch.ones(*self.batch_size, 2, dtype=torch.bool, device=self.device)
        if self.prefix:
            td["twist"] = wave(6)
        if self.reward_terms:
            td["reward_terms"] = self._terms(count, push)
        return td

    def _terms(self, count: Tensor, push: Tensor) -> TensorDict:
        return TensorDict({"near": (count + 1.0).cos(), "far": push.clone()}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        offset = torch.rand(*self.batch_size, 1, generator=self._generator).to(self.device, self.dtype)
        td = self._observe(self._zeros(1), offset, self._zeros(1), self._zeros(*self.action_shape))
        return td.update({"done": self._zeros(1).bool(), "terminated": self._zeros(1).bool()})

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict.get(self.action_name)
        mean = action.reshape(*self.batch_size, -1).mean(-1, keepdim=True)
        count = tensordict.get("count") + 1
        push = 0.9 * tensordict.get("push") + 0.1 * torch.tanh(mean)
        td = self._observe(count, tensordict.get("offset"), push, action.clone())
        terms = self._terms(count, push)
        td["reward"] = terms["near"] + terms["far"]
        mask = tensordict.get("_step", None)
        if mask is not None and self.honours_step:
            mask = mask.reshape(self.batch_size)
            still = {key: tensordict.get(key) for key in td.keys(True, True) if key in tensordict.keys(True, True)}
            still["reward"] = torch.zeros_like(td["reward"])
            still |= {key: torch.zeros_like(td[key]) for key in still if key[0] == "reward_terms"}
            for key, value in still.items():
                td[key] = torch.where(expand_as_right(mask, value), td[key], value)
        done = td["count"] >= self.ends if self.honours_step else td["count"] == self.ends
        return td.update({"done": done, "terminated": done.clone()})

    def _set_seed(self, seed: int | None) -> None:
        self._generator = torch.Generator().manual_seed(seed or 0)


class NestedEffortEnv(EnvBase):
    """Agents with an effort action and a twist, all of it under ``agent``; the done flag is at the root.

    Args:
        batch_size: batch-locked batch.
        agents: shape of the nest beyond the batch.
    """

    control_dt = 0.01
    state_in_tensordict = True

    def __init__(self, batch_size: Sequence[int] = (), agents: Sequence[int] = ()) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size(batch_size))
        self.nest = (*self.batch_size, *agents)

        def nested(name: str) -> Composite:
            leaf = Unbounded(shape=(*self.nest, 6))
            return Composite({"agent": Composite({name: leaf}, shape=self.nest)}, shape=self.batch_size)

        self.observation_spec = nested("twist")
        self.action_spec = nested("action")
        self.reward_spec = Unbounded(shape=(*self.batch_size, 1))
        self.set_seed(0)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        twist = torch.randn(*self.nest, 6, generator=self._generator)
        agent = TensorDict({"twist": twist}, self.nest)
        return TensorDict({"agent": agent, "done": torch.zeros(*self.batch_size, 1).bool()}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        twist = 0.9 * tensordict["agent", "twist"] + 0.1 * tensordict["agent", "action"]
        agent = TensorDict({"twist": twist}, self.nest)
        zero = torch.zeros(*self.batch_size, 1)
        return TensorDict({"agent": agent, "reward": zero, "done": zero.bool()}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._generator = torch.Generator().manual_seed(seed or 0)


class AgentsEnv(EnvBase):
    """Two agents whose twist, action and reward lie under ``agents``, a nest with a dimension of its own.

    The reward of an agent is the mean of its twist plus its number. Rows outside a ``_step`` mask move too.

    Args:
        batch_size: batch-locked batch.
        horizons: steps after which the rows are done; repeated over the batch.
        nested_done: whether the flags lie under ``agents`` too, where only the last agent's becomes True, and only that
            agent is then reset.
    """

    control_dt = 0.01

    def __init__(
        self, batch_size: Sequence[int] = (3,), *, horizons: Sequence[int] = (6,), nested_done: bool = False
    ) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size(batch_size))
        rows = self.batch_size.numel()
        self.ends = torch.tensor([horizons[i % len(horizons)] for i in range(rows)]).reshape(*self.batch_size, 1)
        self.nested_done, self.nest = nested_done, (*self.batch_size, 2)

        def nested(**leaves: Unbounded | Binary) -> Composite:
            return Composite({"agents": Composite(leaves, shape=self.nest)}, shape=self.batch_size)

        real = Unbounded(shape=(*self.nest, 6))
        self.observation_spec = nested(twist=real, executed=real, count=Unbounded(shape=(*self.nest, 1)))
        self.action_spec = nested(action=real)
        self.reward_spec = nested(reward=Unbounded(shape=(*self.nest, 1)))
        flags = {name: Binary(shape=(*self.nest, 1), dtype=torch.bool) for name in ("done", "terminated")}
        if nested_done:
            self.done_spec = nested(**flags)
        self.set_seed(0)

    def _pack(self, **agents: Tensor) -> TensorDict:
        done = agents["count"][..., -1, :] >= self.ends
        flags = {"done": done, "terminated": done.clone()}
        if self.nested_done:
            last = torch.tensor([[False], [True]])
            agents |= {name: flag.unsqueeze(-2) & last for name, flag in flags.items()}
        nest = TensorDict({key: value.clone() for key, value in agents.items()}, self.nest)
        return TensorDict({"agents": nest, **({} if self.nested_done else flags)}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        twist = torch.randn(*self.nest, 6, generator=self._generator)
        return self._pack(count=torch.zeros(*self.nest, 1), twist=twist, executed=torch.zeros_like(twist))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict["agents", "action"]
        twist = 0.9 * tensordict["agents", "twist"] + 0.1 * action
        reward = twist.mean(-1, keepdim=True) + torch.tensor([[1.0], [2.0]])
        return self._pack(count=tensordict["agents", "count"] + 1, twist=twist, executed=action, reward=reward)

    def _set_seed(self, seed: int | None) -> None:
        self._generator = torch.Generator().manual_seed(seed or 0)


class ScriptedEnv(EnvBase):
    """Observations that follow a script whatever the actions; the reward is 1, the last step of the script is done.

    ``executed`` is the action as it arrived. Every row moves, also outside a ``_step`` mask. It has no ``control_dt``.

    Args:
        action_size: of one row.
        script: observations ``(B, T + 1, ...)`` after 0 to T steps, all of one precision.
    """

    state_in_tensordict = True

    def __init__(self, action_size: int, **script: Tensor) -> None:
        first = next(iter(script.values()))
        rows, steps = first.shape[:2]
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size((rows,)))
        self.script, self.last, self.dtype = script, steps - 1, first.dtype

        def real(*shape: int) -> Unbounded:
            return Unbounded(shape=(rows, *shape), dtype=first.dtype)

        observed = {key: real(*value.shape[2:]) for key, value in script.items()}
        count = Unbounded(shape=(rows, 1), dtype=torch.int64)
        self.observation_spec = Composite(**observed, count=count, executed=real(action_size), shape=(rows,))
        self.action_spec = real(action_size)
        self.reward_spec = real(1)

    def _observe(self, count: Tensor, executed: Tensor) -> TensorDict:
        here = torch.arange(len(count)), count.squeeze(-1)
        observed = {key: value[here] for key, value in self.script.items()}
        done = count >= self.last
        flags = {"done": done, "terminated": done.clone()}
        return TensorDict({**observed, **flags, "count": count, "executed": executed}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        return self._observe(torch.zeros(*self.batch_size, 1, dtype=torch.int64), self.action_spec.zero())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        count = (tensordict.get("count") + 1).clamp_max(self.last)
        following = self._observe(count, tensordict.get("action").clone())
        return following.set("reward", torch.ones(*self.batch_size, 1, dtype=self.dtype))

    def _set_seed(self, seed: int | None) -> None:
        pass


class TowedEnv(EnvBase):
    """A tool on a heading that never turns, towed by chunks of references; its whole state is in the tensordict.

    ``executed`` is the chunk as it arrived. The orientation of the tool stays as it is.

    Args:
        pose: ``(B, 7)`` at the start.
        heading: ``(B, 1)``.
        steps: references in a chunk.
        share: of the way to the last reference that the tool makes; 0 is a tool that is blocked.
    """

    control_dt = 0.01

    state_in_tensordict = True

    def __init__(self, pose: Tensor, heading: Tensor, *, steps: int, share: float) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=pose.shape[:1])
        self.pose, self.heading, self.share, self.dtype = pose, heading, share, pose.dtype

        def real(*shape: int) -> Unbounded:
            return Unbounded(shape=(*self.batch_size, *shape), dtype=pose.dtype)

        self.observation_spec = Composite(
            pose=real(7), heading=real(1), executed=real(steps, 13), shape=self.batch_size
        )
        self.action_spec = real(steps, 13)
        self.reward_spec = real(1)

    def _observe(self, pose: Tensor, heading: Tensor, executed: Tensor) -> TensorDict:
        done = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        flags = {"done": done, "terminated": done.clone()}
        return TensorDict({"pose": pose, "heading": heading, "executed": executed, **flags}, self.batch_size)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        return self._observe(self.pose.clone(), self.heading.clone(), self.full_action_spec["action"].zero())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        pose, chunk = tensordict.get("pose").clone(), tensordict.get("action").clone()
        pose[:, :3] += self.share * (chunk[:, -1, :3] - pose[:, :3])
        following = self._observe(pose, tensordict.get("heading").clone(), chunk)
        return following.set("reward", torch.zeros(*self.batch_size, 1, dtype=self.dtype))

    def _set_seed(self, seed: int | None) -> None:
        pass


def actions_for(env: EnvBase, steps: int, scale: float = 0.5, seed: int = 0) -> Tensor:
    """Random actions ``(steps, *action shape)`` for an environment."""
    generator = torch.Generator().manual_seed(seed)
    spec = env.full_action_spec[env.action_key]
    return (scale * torch.randn(steps, *spec.shape, generator=generator, dtype=torch.float64)).to(spec.dtype)


def play(env: EnvBase, actions: Tensor) -> TensorDictBase:
    """Rollout of given actions, resetting the rows that are done."""
    remaining = iter(actions)
    return env.rollout(len(actions), lambda td: td.set(env.action_key, next(remaining)), break_when_any_done=False)

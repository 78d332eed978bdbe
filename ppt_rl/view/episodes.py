"""The world of the live view: a policy that acts in real time, one episode after the other. It knows no browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import Transform
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ppt_rl.envs import ArmEnv
from ppt_rl.evaluation import Policy, beside_the_reference
from ppt_rl.view.settings import changed_policy

__all__ = ["LiveEpisodes", "Reading"]

#: Fastest that the obstacle follows the hand that drags it [m/s], and how often a pause looks whether it is over [s].
_DRAG, _NAP = 0.4, 0.02
#: By how much the view may fall behind before it gives up to catch up [s].
_LATE = 0.2


@dataclass(frozen=True)
class Reading:
    """What one control step did.

    Attributes:
        step: number of the control step in its episode, from 1.
        time: since the start of the view, in simulated time [s].
        power: of the wrench, positive where energy leaves the robot [W]; NaN where the chain writes none.
        tank_energy: level of the tank [J]; NaN where there is none.
        force: size of the measured force at the tool [N].
    """

    step: int
    time: float
    power: float
    tank_energy: float
    force: float


class _Abandoned(Exception):
    """The episode is not to be finished."""


class _Listener(Transform):
    """Calls a function after every control step with what was observed."""

    def __init__(self, hear: Callable[[TensorDictBase], None]) -> None:
        super().__init__()
        self._hear = hear

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._hear(next_tensordict)
        return next_tensordict


class LiveEpisodes:
    """Runs episodes of a policy in real time and reports every control step.

    Changed settings take effect at the next episode; pause, speed and the obstacle at the next control step. Methods
    may be called from other threads than the one that runs the episodes.

    Args:
        policy: the policy, which acts deterministically.
        seed: seed of the episodes.
        on_step: called after every control step.
        real_time: whether a control step takes its time; else as little as it can.

    Attributes:
        paused: whether the world stands still.
        speed: of the world, relative to real time.
        obstacle: where the obstacle shall be, ``(x, y)`` [m]; it follows at 0.4 m/s at most.
        has_obstacle: whether the task has an obstacle to move.
        settings: changed settings by name.
        present: the policy with the settings of the present episode.

    Raises:
        ValueError: if the policy has no such setting, or a value is impossible.
    """

    def __init__(
        self, policy: Policy, *, seed: int, on_step: Callable[[Reading], None], real_time: bool = True
    ) -> None:
        self.policy = policy
        self.paused, self.speed = False, 1.0
        self.settings: dict[str, float] = {}
        self.has_obstacle = policy.recipe.task.make_movable_env is not None
        self._seed, self._on_step, self._real_time = seed, on_step, real_time
        self._made_with: dict[str, float] | None = None
        self._restart = self._closed = False
        self._steps = self._step = 0
        self._due = 0.0
        self._env: Any = None
        self._make()
        self.obstacle = self._obstacle_place() if self.has_obstacle else (0.0, 0.0)

    @property
    def closed(self) -> bool:
        """Whether no episode can be run any more."""
        return self._closed

    @property
    def base(self) -> ArmEnv:
        """The bare environment."""
        return self._env.base_env

    # -- what a user does ---------------------------------------------------------------------------------------------

    def change(self, name: str, value: float) -> None:
        """Change a setting from the next episode on.

        Args:
            name: name of the setting.
            value: its new value.

        Raises:
            ValueError: if the policy has no such setting, or the value is impossible.
        """
        changed_policy(self.policy, {name: value})
        self.settings = {**self.settings, name: float(value)}

    def restart(self) -> None:
        """Give up the present episode and begin the next one."""
        self._restart = True

    def close(self) -> None:
        """End the present episode, after which none can be run."""
        self._closed = True

    # -- episodes -----------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def run(self, began: Callable[[], None] = lambda: None) -> bool | None:
        """Run one episode.

        Args:
            began: called when it has begun.

        Returns:
            Whether it succeeded; None if it was given up.
        """
        if self._closed:
            return None
        if self._made_with != self.settings:
            self._make()
        self._restart, self._step = False, 0
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            tensordict = self._env.reset()
            began()
            self._due = time.perf_counter()
            try:
                while True:
                    tensordict = self._env.step(self.policy.actor(tensordict))
                    following = tensordict["next"]
                    if bool(following["done"]):
                        return bool(following["success"])
                    tensordict = self._env.step_mdp(tensordict)
            except _Abandoned:
                return None

    def free(self) -> None:
        """Free the environment."""
        self._env.close()

    def _make(self) -> None:
        """Make the environment with the present settings; its episodes go on where those of the last one ended."""
        settings = self.settings
        policy = changed_policy(self.policy, settings)
        recipe = policy.recipe
        task, hear = recipe.task, self._heard
        if task.make_movable_env is not None:
            task = replace(task, make_test_env=task.make_movable_env)

        def make_chain(config: Any, base: ArmEnv, **modules: nn.Module) -> list[Transform]:
            return beside_the_reference(recipe.make_chain(config, base, **modules), _Listener(hear))

        self.present = replace(policy, recipe=replace(recipe, task=task, make_chain=make_chain))
        if self._env is not None:
            self._env.close()
            self._seed += 1
        self._env = self.present.make_env(1, seed=self._seed)
        self._made_with = settings
        if self._steps and self.has_obstacle:
            self._move_obstacle(self.obstacle)

    def _heard(self, observed: TensorDictBase) -> None:
        """Report a control step, then wait until the next one is due."""
        self._steps, self._step = self._steps + 1, self._step + 1
        self._on_step(
            Reading(
                self._step,
                self._steps * self.base.control_dt,
                _number(observed, "power"),
                _number(observed, "tank_energy"),
                float(observed["wrench"][0, :3].norm()),
            )
        )
        self._follow()
        while self.paused and not (self._restart or self._closed):
            time.sleep(_NAP)
            self._due = time.perf_counter()
        if self._restart or self._closed:
            raise _Abandoned
        if self._real_time:
            self._wait()

    def _wait(self) -> None:
        self._due += self.base.control_dt / self.speed
        ahead = self._due - time.perf_counter()
        if ahead > 0:
            time.sleep(ahead)
        elif ahead < -_LATE:
            self._due = time.perf_counter()

    # -- the obstacle -------------------------------------------------------------------------------------------------

    def _obstacle_place(self) -> tuple[float, float]:
        base: Any = self.base
        return base.obstacle_place

    def _move_obstacle(self, place: tuple[float, float]) -> None:
        base: Any = self.base
        base.move_obstacle(place)

    def _follow(self) -> None:
        """Move the obstacle towards where it shall be."""
        if not self.has_obstacle:
            return
        here, there = np.asarray(self._obstacle_place()), np.asarray(self.obstacle)
        way = there - here
        distance = float(np.linalg.norm(way))
        if distance > 1e-6:
            step = way * min(1.0, _DRAG * self.base.control_dt / distance)
            self._move_obstacle((float(here[0] + step[0]), float(here[1] + step[1])))


def _number(observed: TensorDictBase, key: str) -> float:
    value = observed.get(key, None)
    return float("nan") if value is None else float(value[0, 0])

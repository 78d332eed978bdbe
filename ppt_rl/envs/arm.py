"""A batch of simulated arms with joint torque as the action."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import EnvBase

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.audit import AUDITED, AuditedPhysics
from ppt_rl.envs.models import PADDLE, Tool, remove_visual_geoms, table_scene
from ppt_rl.envs.mujoco_imports import mjcf
from ppt_rl.envs.physics import EngineConfig, ThreadedPhysics, substeps_per_control_step
from ppt_rl.envs.readings import ArmReadings
from ppt_rl.envs.rendering import RenderedScenes
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.checks import require_finite, require_positive
from ppt_rl.modules.kinematics import Kinematics

__all__ = ["ArmEnv", "Rows"]

Rows = NDArray[np.int64]


class ArmEnv(RenderedScenes, EnvBase):
    """Arms over an empty table: free motion, no task. Tasks are subclasses.

    Gravity is compensated, as the real arm does inside. All environments step together (``batch_locked``), on a native
    thread pool. Readings are those of the last physics substep, half a millisecond old, as on hardware.

    Action: ``action`` ``(num_envs, n)`` joint torque [N m], clipped to the limits of the arm's n joints.

    Observations, each ``(num_envs, ...)``:
        ``joint_position`` n [rad], ``joint_velocity`` n [rad/s], ``pose`` 7 [m, -] and ``twist`` 6 [m/s, rad/s] of the
        end-effector point in world axes, ``wrench`` 6 [N, N m] applied by the robot on the world there, measured at
        the wrist with the tool's weight taken off (its inertia is not), ``diverged`` 1, True where the physics blew up.

    With ``EngineConfig(audit=True)``, also the nest ``audit``: ``commanded_work`` and ``measured_work`` [J],
    ``commanded_power`` and ``measured_power`` (the largest) [W] of the episode so far, over every physics substep
    (:mod:`ppt_rl.envs.audit`).

    An episode is truncated after ``duration`` (a task may end there instead, see ``horizon_terminates``), or at once
    where the physics diverges: that row keeps its last good state, so no NaN reaches a collector.

    Args:
        num_envs: number of environments.
        arm: the arm; ``env.arm`` gives it back.
        duration: episode length [s].
        control_dt: time between actions [s]; ``env.control_dt`` gives it back.
        seed: seed of the randomisation; None draws one.
        dtype: precision of what the environment returns.
        device: device of what the environment returns.
        engine: options of the physics, None for the defaults; ``env.engine_config`` gives them back.

    Raises:
        ValueError: if a number is out of range or the time steps do not divide.

    Examples:
        >>> env = ArmEnv(num_envs=2, seed=0)
        >>> env.rollout(3)["next", "pose"].shape
        torch.Size([2, 3, 7])
    """

    tool: Tool = PADDLE
    #: Whether the end of the horizon is the end of the task (``terminated``: nothing to bootstrap from) or just the end
    #: of the record (``truncated``).
    horizon_terminates = False
    #: Pose of the end effector at the start: in front of the base, bar at box height, tool down [m, -].
    start_pose = (0.36, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0)

    def __init__(
        self,
        num_envs: int = 1,
        *,
        arm: Arm = PANDA,
        duration: float = 3.0,
        control_dt: float = 0.01,
        seed: int | None = None,
        dtype: torch.dtype = torch.float32,
        device: torch.device | str = "cpu",
        engine: EngineConfig | None = None,
    ) -> None:
        if isinstance(num_envs, bool) or int(num_envs) != num_envs or num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}; expected a whole number of at least 1.")
        super().__init__(device=torch.device(device), batch_size=torch.Size([int(num_envs)]))
        self.num_envs = int(num_envs)
        self.arm = arm
        self.dtype = dtype
        self.engine_config = engine = EngineConfig() if engine is None else engine
        self.control_dt = require_positive("control_dt", control_dt, "s")
        self.duration = require_positive("duration", duration, "s")
        self.substeps = substeps_per_control_step(control_dt, engine.physics_dt)
        self.horizon = max(1, round(duration / control_dt))
        root = self._scene()
        remove_visual_geoms(root)
        model = mjcf.Physics.from_mjcf_model(root).model.ptr
        physics = ThreadedPhysics(model, self.num_envs, self.substeps, engine.num_threads)
        self.engine: Any = AuditedPhysics(physics, model) if engine.audit else physics
        self._kinematics = Kinematics(arm, self.tool_length, dtype=torch.float64)
        self._readings = ArmReadings(model, dtype)
        self._prepare(model)
        self._sensors = torch.zeros(self.num_envs, model.nsensordata, dtype=dtype)
        self._elapsed = torch.zeros(self.num_envs, 1, dtype=torch.int64)
        self._diverged = torch.zeros(self.num_envs, 1, dtype=torch.bool)
        self._torque_limit = torch.tensor(self.arm.joints.torque_limits, dtype=torch.float64)
        self._make_specs()
        self.set_seed(seed if seed is not None else int(np.random.SeedSequence().generate_state(1)[0]))

    # -- hooks of a task, in the order of time ------------------------------------------------------------------------

    def _scene(self) -> Any:
        """MJCF of the scene, with looks."""
        return table_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt)

    def _task_spec(self, make: SpecMaker) -> Composite:
        """Specs of the observations that the task adds."""
        return make.nest()

    def _prepare(self, model: Any) -> None:
        """Look up in the compiled model what the task needs of it."""

    def _begin(self, rows: Rows) -> np.ndarray:
        """Draw an episode for ``rows``, write its parameters into their models and return ``(R, nq)`` positions."""
        start = torch.tensor(self.start_pose, dtype=torch.float64).expand(len(rows), 7)
        return self._arm_position(start).numpy()

    def _task_reset(self, rows: Tensor) -> dict[str, Any]:
        """Observations of the task, ``(num_envs, ...)``, after ``rows`` began an episode."""
        return {}

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        """Observations of the task and ``reward`` after a control step; ``ended`` marks the rows at their horizon."""
        return {"reward": torch.zeros(self.num_envs, 1, dtype=self.dtype)}

    def _task_over(self) -> Tensor | None:
        """``(num_envs, 1)`` True where the task is over before its horizon; None where it never is."""
        return None

    def _write_parameters(self, model: Any, row: int) -> None:
        """Write the episode's parameters of environment ``row`` into a model (physics or rendering)."""

    # -- EnvBase ------------------------------------------------------------------------------------------------------

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        every = torch.ones(self.num_envs, dtype=torch.bool)
        mask = every if mask is None else mask.reshape(self.num_envs).cpu()
        rows = mask.nonzero().squeeze(-1)
        if len(rows):
            index = rows.numpy()
            position = self._begin(index)
            self._put_sensors(rows, torch.from_numpy(self.engine.reset(index, position)).to(self.dtype))
            self._elapsed[rows] = 0
            self._diverged[rows] = False
        observation = self._observation()
        observation |= self._task_reset(rows)
        return self._pack(observation | self._done(self._elapsed >= self.horizon))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        mask = tensordict.get("_step", None)
        mask = None if mask is None else mask.reshape(self.num_envs).cpu()
        torque = self._checked_torque(tensordict.get("action"), mask)
        if mask is None:
            step = self.engine.step(torque.numpy())
            good = ~torch.from_numpy(step.diverged)
            moved = torch.from_numpy(step.sensors[:, -1]).to(self.dtype, copy=True)  # the engine reuses its buffer
            self._sensors = moved if bool(good.all()) else torch.where(good.unsqueeze(-1), moved, self._sensors)
            self._diverged = ~good.unsqueeze(-1)
            self._elapsed += 1
        else:
            self._masked_step(torque, mask)
        observation = self._observation()
        ended = self._elapsed >= self.horizon
        observation |= self._task_step(observation, ended)
        if mask is not None:
            self._silence(observation, mask)
        return self._pack(observation | self._done(ended))

    def _masked_step(self, torque: Tensor, mask: Tensor) -> None:
        rows = mask.nonzero().squeeze(-1)
        if not len(rows):
            return
        step = self.engine.step(torque[rows].numpy(), rows.numpy())
        good = ~torch.from_numpy(step.diverged)
        moved = torch.from_numpy(step.sensors[:, -1]).to(self.dtype)
        self._put_sensors(rows, torch.where(good.unsqueeze(-1), moved, self._sensors[rows]))
        self._diverged[rows] = ~good.unsqueeze(-1)
        self._elapsed[rows] += 1

    def _put_sensors(self, rows: Tensor, sensors: Tensor) -> None:
        """Take over readings of some rows. Observations are views, so what was returned before keeps the old tensor."""
        self._sensors = self._sensors.clone()
        self._sensors[rows] = sensors

    @staticmethod
    def _silence(observation: dict[str, Any], mask: Tensor) -> None:
        """No reward for rows that did not step."""
        column = mask.unsqueeze(-1)
        observation["reward"] = observation["reward"] * column
        terms = observation.get("reward_terms", {})
        for name, value in terms.items():
            terms[name] = value * column

    def _set_seed(self, seed: int | None) -> None:
        self._rng = np.random.default_rng(seed)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the physics threads and free the renderer.

        Args:
            raise_if_closed: whether closing twice is an error.
        """
        if not self.is_closed:
            self.engine.close()
            self._free_renderer()
        super().close(raise_if_closed=raise_if_closed)

    @property
    def tool_length(self) -> float:
        """Distance from flange to end-effector point [m]."""
        return self.tool.length

    def _make_specs(self) -> None:
        make = SpecMaker(self.batch_size, self.dtype, self.device)
        real, flag, count = make.real, make.flag, self.arm.num_joints
        self.observation_spec = make.nest(
            joint_position=real(count), joint_velocity=real(count), pose=real(7), twist=real(6), wrench=real(6),
            diverged=flag(),
        )  # fmt: skip
        self.observation_spec.update(self._task_spec(make))
        if self.engine_config.audit:
            self.observation_spec["audit"] = make.nest(**{name: real(1) for name in AUDITED})
        limit = torch.tensor(self.arm.joints.torque_limits, dtype=self.dtype, device=self.device).expand(
            self.num_envs, count
        )
        self.action_spec = Bounded(-limit, limit, shape=limit.shape, dtype=self.dtype, device=self.device)
        self.reward_spec = real(1)
        self.done_spec = make.nest(done=flag(), terminated=flag(), truncated=flag())

    def _checked_torque(self, action: Tensor, mask: Tensor | None) -> Tensor:
        if action.shape != (self.num_envs, self.arm.num_joints):
            raise ValueError(
                f"action has shape {tuple(action.shape)}; expected ({self.num_envs}, {self.arm.num_joints}): the joint "
                "torques [N m] of each environment. Put JointTorqueTransform on the environment to act with a wrench."
            )
        torque = action.detach().to("cpu", torch.float64)
        require_finite("action (joint torque)", torque if mask is None else torque[mask])
        return torque.clamp(-self._torque_limit, self._torque_limit)

    def _observation(self) -> dict[str, Any]:
        observation: dict[str, Any] = self._readings.observe(self._sensors)
        observation["diverged"] = self._diverged.clone()
        if self.engine_config.audit:
            observation["audit"] = self.engine.observe(self.dtype)
        return observation

    def _done(self, ended: Tensor) -> dict[str, Tensor]:
        over = self._task_over()
        terminal = ended if self.horizon_terminates else torch.zeros_like(ended)
        if over is not None:
            terminal = terminal | over
        done = ended | terminal | self._diverged
        terminated = terminal & ~self._diverged
        return {"done": done, "terminated": terminated, "truncated": done & ~terminated}

    def _pack(self, observation: dict[str, Any]) -> TensorDict:
        if self.device.type != "cpu":
            return TensorDict(observation, batch_size=self.batch_size).to(self.device)
        return TensorDict(observation, batch_size=self.batch_size, device=self.device)

    def _arm_position(self, pose: Tensor) -> Tensor:
        """Joint positions of the arm at ``(R, 7)`` poses."""
        guess = torch.tensor(self.arm.home, dtype=pose.dtype).expand(len(pose), -1)
        return self._kinematics.inverse(pose, guess)

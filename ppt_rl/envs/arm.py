"""A batch of simulated arms with joint torque as the action."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torchrl.data import Bounded

from ppt_rl.arms import PANDA, Arm
from ppt_rl.envs.audit import AUDITED
from ppt_rl.envs.batch import BatchedEnv
from ppt_rl.envs.models import PADDLE, Tool, table_scene
from ppt_rl.envs.physics import EngineConfig, EngineName
from ppt_rl.envs.readings import ArmReadings
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.argument_checks import require_instance, require_whole
from ppt_rl.functional.checks import is_readable, require_finite
from ppt_rl.modules.kinematics import Kinematics

__all__ = ["ArmEnv"]


class ArmEnv(BatchedEnv):
    """Arms over an empty table: free motion, no task. Tasks are subclasses.

    All environments step together (``batch_locked``), on CPU threads or, with ``device="cuda"``, in one simulation on
    the GPU (:class:`~ppt_rl.envs.physics.EngineConfig`). Gravity is compensated, as a real arm's
    controller does. Readings are those of the last physics substep, half a millisecond old, as on hardware.

    Action: ``action`` ``(num_envs, n)``, the torques of the arm's n joints [N m], clipped to its limits.

    Observations, each ``(num_envs, ...)``:
        ``joint_position`` n [rad], ``joint_velocity`` n [rad/s], ``pose`` 7 [m, -] and ``twist`` 6 [m/s, rad/s] of the
        end-effector point in world axes, ``wrench`` 6 [N, N m] that the robot applies to the world there, measured at
        the wrist with the tool's weight subtracted (but not its inertia), ``diverged`` 1, True where the physics blew
        up.

    With ``EngineConfig(audit=True)`` also ``audit``, which holds ``commanded_work`` and ``measured_work`` [J],
    ``commanded_power`` and ``measured_power`` (the largest) [W] of the episode so far, over every physics substep
    (:mod:`ppt_rl.envs.audit`).

    An episode is truncated after ``duration`` (some tasks terminate it, see ``horizon_terminates``), and at once where
    the physics diverges; a diverged environment keeps its last good readings, so no NaN reaches a collector.

    Args:
        num_envs: number of environments.
        arm: the arm; later ``env.arm``.
        duration: episode length [s].
        control_dt: time between actions [s]; later ``env.control_dt``.
        seed: seed of the randomisation; None draws one from torch's generator, as torchrl's environments do.
        dtype: precision of what the environment returns.
        device: device of what the environment returns.
        engine: options of the physics, or the name of an engine, ``"threads"`` or ``"warp"``; None takes the defaults;
            later ``env.engine_config``.

    Raises:
        ValueError: if a number is out of range or ``control_dt`` is no multiple of the physics' time step.
        ImportError: if the engine is not installed.

    Examples:
        >>> from ppt_rl.arms import UR5E
        >>> env = ArmEnv(num_envs=2, arm=UR5E, seed=0)
        >>> env.rollout(3)["next", "joint_position"].shape
        torch.Size([2, 3, 6])
    """

    tool: Tool = PADDLE
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
        engine: EngineConfig | EngineName | None = None,
    ) -> None:
        require_instance("arm", arm, Arm)
        if seed is not None:
            require_whole("seed", seed, 0)
        super().__init__(num_envs, duration=duration, control_dt=control_dt, dtype=dtype, device=device, engine=engine)
        self.arm = arm
        model = self._start_engine()
        self._kinematics = Kinematics(arm, self.tool_length, dtype=torch.float64).to(self.place)
        self._readings = ArmReadings(model, dtype, self.place)
        self._prepare(model)
        limit = torch.tensor(arm.joints.torque_limits, dtype=torch.float64, device=self.place)
        self._torque_bounds = -limit, limit
        self._make_specs()
        self.set_seed(seed)

    @property
    def tool_length(self) -> float:
        """Distance from flange to end-effector point [m]."""
        return self.tool.length

    def _scene(self) -> Any:
        return table_scene(self.arm, self.tool, physics_dt=self.engine_config.physics_dt)

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
        limit = self._torque_bounds[1].to(self.dtype).to(self.device).expand(self.num_envs, count)
        self.action_spec = Bounded(-limit, limit, shape=limit.shape, dtype=self.dtype, device=self.device)
        self.reward_spec = real(1)
        self.done_spec = make.nest(done=flag(), terminated=flag(), truncated=flag())

    def _begin(self, rows: Tensor) -> Tensor:
        return self._arm_position(self._start_poses(rows))

    def _start_poses(self, rows: Tensor) -> Tensor:
        """``(R, 7)`` copies of the pose at the start."""
        return torch.tensor(self.start_pose, dtype=torch.float64, device=self.place).repeat(len(rows), 1)

    def _arm_position(self, pose: Tensor) -> Tensor:
        """``(R, n)`` joint positions of the arm at ``(R, 7)`` poses."""
        guess = pose.new_tensor(self.arm.home).expand(len(pose), -1)
        return self._kinematics.inverse(pose, guess)

    def _checked_action(self, action: Tensor, mask: Tensor | None) -> Tensor:
        if action.shape != (self.num_envs, self.arm.num_joints):
            raise ValueError(
                f"action has shape {tuple(action.shape)}; expected ({self.num_envs}, {self.arm.num_joints}): the joint "
                "torques [N m] of each environment. Put JointTorqueTransform on the environment to act with a wrench."
            )
        torque = action.detach().to(self.place, torch.float64)
        if is_readable(torque):  # elsewhere nothing may wait for an answer, and such an environment diverges
            require_finite("action (joint torque)", torque if mask is None else torque[mask])
        return torque.clamp(*self._torque_bounds)

    def _observation(self) -> dict[str, Any]:
        observation: dict[str, Any] = self._readings.observe(self._sensors)
        observation["diverged"] = self._diverged.clone()
        if self.engine_config.audit:
            observation["audit"] = self.engine.observe(self.dtype)
        return observation

"""Box pushing with something in the way that neither the policy nor the controller is told about."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.data import Composite

from ppt_rl.envs.contact_audit import CONTACT, ContactAudit
from ppt_rl.envs.push.env import PushEnv
from ppt_rl.envs.push.obstacles import Obstacle, add_plates, facing, set_solid, write_plate
from ppt_rl.envs.push.scene import PUSH_BOX
from ppt_rl.envs.row_generators import RowGenerators
from ppt_rl.envs.specs import SpecMaker
from ppt_rl.functional.argument_checks import require_instance, require_numbers

__all__ = ["ObstructedPushEnv"]

#: Random stream of what happens to an episode; the episode itself is that of :class:`PushEnv` with the same seed.
_FATES = 71
#: Longest time step at which the springs of the plates are stable [s].
_LONGEST_STEP = 0.0005
#: Where the box stands if it is out of the tool's way: this far behind the first plate [m].
_OUT_OF_THE_WAY = 0.3
#: Clear height of the tool above a table that is too high, at the start [m].
_CLEARANCE = 0.001
#: MuJoCo's ``solref`` of the box between tool and stop: stiff, so that the paddle does not sink into a light box.
_HARD_BOX = (0.002, 1.0)


class ObstructedPushEnv(PushEnv):
    """Box pushing with an :class:`~ppt_rl.envs.push.obstacles.Obstacle`; the force on it is measured at every substep.

    The episode of a seed is that of :class:`PushEnv`: the same box, goal, via-points and observations, so policies are
    compared in the same episodes. Beside them it writes, for the record and not for a policy, ``peak_force``,
    ``static_force``, ``pressure_force`` [N], ``contact_time`` [s] and ``contact_speed`` [m/s] of the last plate
    (:class:`~ppt_rl.envs.contact_audit.ContactAudit`), ``contact`` (whether it was touched), ``held_force`` (the
    largest on the first one) [N] and ``kind`` (0, 1, ...: in which of the obstacle's ways the episode goes), each
    ``(num_envs, 1)``.

    Args:
        num_envs: number of environments.
        obstacle: the obstacle.
        **kwargs: as for :class:`PushEnv`.

    Attributes:
        obstacle_place: x and y of the middle of the front of the first plate [m], where it does not stand in the way.

    Raises:
        ValueError: if the physics' time step is above 0.5 ms, or as for :class:`PushEnv`.
    """

    def __init__(self, num_envs: int = 1, *, obstacle: Obstacle, **kwargs: Any) -> None:
        require_instance("obstacle", obstacle, Obstacle)
        self.obstacle = obstacle
        self.obstacle_place = obstacle.at
        super().__init__(num_envs, **kwargs)
        if self.engine_config.on(self.device) != "threads":
            raise ValueError(
                "the engine is 'warp'; expected 'threads', which can follow the plates' contacts one by one."
            )

    # -- scene --------------------------------------------------------------------------------------------------------

    def _scene(self) -> Any:
        if self.engine_config.physics_dt > _LONGEST_STEP:
            raise ValueError(
                f"physics_dt is {self.engine_config.physics_dt} s; expected at most {_LONGEST_STEP} s, at which the "
                "springs of the obstacle are stable and force is measured at 2 kHz."
            )
        root = super()._scene()
        add_plates(root, self.obstacle)
        return root

    def _prepare(self, model: Any) -> None:
        super()._prepare(model)
        count = len(self.obstacle.plates)
        names = [f"plate{index}_force" for index in range(count)]
        self._contact = ContactAudit(self.engine, model, names, self.horizon * self.control_dt)
        self.engine = self._contact
        self._joints_of_plates = model.nq - (self.arm.num_joints + 7)
        self._front = np.zeros((self.num_envs, count, 3))  # [m]
        self._heading = np.zeros(self.num_envs)  # [rad]
        self._count = np.arange(self.num_envs) + self.first_row - 1  # an episode later, that of the row and its episode
        self._moment = np.zeros(self.num_envs)  # [0, 1]
        self._held = np.ones(self.num_envs, dtype=bool)
        self._start = torch.zeros(self.num_envs, 2, dtype=self.dtype)  # of the tool [m]

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            seed = int(torch.empty((), dtype=torch.int64).random_())
        super()._set_seed(seed)
        self._fates = RowGenerators(seed, self.num_envs, stream=_FATES, first_row=self.first_row)
        self._count = np.arange(self.num_envs) + self.first_row - 1

    # -- episode ------------------------------------------------------------------------------------------------------

    @property
    def kind(self) -> Tensor:
        """``(num_envs, 1)`` in which of the obstacle's ways the episode goes; they take turns."""
        return torch.from_numpy(self._count % len(self.obstacle.clamped)).unsqueeze(-1)

    def _arm_position(self, pose: Tensor) -> Tensor:
        if self.obstacle.rise:
            pose = pose.clone()
            pose[:, 2] = self.obstacle.rise + self.tool.half_extent[2] + _CLEARANCE
        self._began_at = pose[:, :2].to(self.dtype)
        return super()._arm_position(pose)

    def _begin(self, begun: Tensor) -> Tensor:
        position = super()._begin(begun).numpy()
        rows = begun.numpy()
        self._start[begun] = self._began_at
        self._count[rows] += 1
        self._held[rows] = True
        self._moment[rows] = self._fates.uniform(begun, 1)[:, 0].numpy()
        self._place(rows)
        for row in rows:
            self._write_obstacle(self.engine.models[row], int(row))
        box = position[:, self.arm.num_joints :]
        if self.obstacle.place == "tool":
            ahead = np.stack([np.cos(self._heading[rows]), np.sin(self._heading[rows])], -1)
            box[:, :2] = self._front[rows, 0, :2] + _OUT_OF_THE_WAY * ahead
        box[:, 2] += self.obstacle.rise
        return torch.from_numpy(np.concatenate([position, np.zeros((len(rows), self._joints_of_plates))], -1))

    def _place(self, rows: NDArray[np.int64]) -> None:
        """Where the fronts of the plates stand, and their heading."""
        episode, obstacle = self._episode, self.obstacle
        if self.obstacle_place is not None:
            self._front[rows], self._heading[rows] = (*self.obstacle_place, obstacle.plates[0].half_size[2]), 0.0
            return
        if obstacle.place == "table":
            self._front[rows], self._heading[rows] = (0.5, 0.0, obstacle.rise), 0.0
            return
        start, behind, end = self._via_points(self._start)[:, :, :2].double().numpy().swapaxes(0, 1)
        if obstacle.place == "box":
            behind, end = episode.box_start.double().numpy(), episode.goal.double().numpy()
        for row in rows:
            way = end[row] - behind[row]
            point = behind[row] + obstacle.along * way
            if obstacle.place == "box":
                point = point + float(episode.half[row]) * way / np.linalg.norm(way)
            reach = max(self.tool.half_extent[0], self.tool.stem_radius), self.tool.half_extent[1]
            heading = facing(point, way, start=start[row], end=end[row], tool=reach)
            ahead = np.asarray([np.cos(heading), np.sin(heading)])
            for index, plate in enumerate(obstacle.plates):
                self._front[row, index] = (*point, plate.half_size[2])
                point = point + (2 * plate.half_size[0] + obstacle.gap) * ahead
            self._heading[row] = heading

    def _write_parameters(self, model: Any, row: int) -> None:
        super()._write_parameters(model, row)
        self._write_obstacle(model, row)

    def _write_obstacle(self, model: Any, row: int) -> None:
        obstacle = self.obstacle
        clamped = obstacle.clamped[int(self._count[row]) % len(obstacle.clamped)]
        lies = obstacle.place == "table"
        for index, front in enumerate(self._front[row]):
            write_plate(
                model, index, front, float(self._heading[row]), clamped=clamped, meets_box=obstacle.place == "box",
                lies=lies,
            )  # fmt: skip
        if not self._held[row]:
            set_solid(model, 0, False)
        if obstacle.place == "box":
            model.geom(PUSH_BOX).solref[:] = _HARD_BOX
        if lies:
            table = model.geom("table")
            table.pos[2], model.geom_sameframe[table.id] = obstacle.rise, 0

    def move_obstacle(self, place: tuple[float, float]) -> None:
        """Move the first plate, its normal along x, in every environment, at once and for the episodes to come.

        Args:
            place: x and y of the middle of its front [m].

        Raises:
            ValueError: if ``place`` is not two finite numbers.
        """
        x, y = (float(value) for value in require_numbers("place", place, (2,), unit="m"))
        self.obstacle_place = x, y
        self._place(np.arange(self.num_envs))
        for row, model in enumerate(self.engine.models):
            self._write_obstacle(model, row)

    # -- what happens -------------------------------------------------------------------------------------------------

    def reference_offset(self) -> Tensor:
        """``(num_envs, 3)`` by how much the reference has jumped until now [m]."""
        when = 1 + torch.from_numpy(self._moment).unsqueeze(-1) * (0.8 * self.horizon)  # control steps
        heading = torch.from_numpy(self._heading)
        ahead = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
        return (self.obstacle.jump * ahead * (self._elapsed >= when)).to(self.dtype)

    def _release(self) -> None:
        """Let the first plate vanish where it was pushed for long enough."""
        low, high = self.obstacle.hold or (0.0, 0.0)
        begun = self._contact.measured[:, 0, CONTACT.index("contact_time")]
        now = self._elapsed[:, 0].numpy() * self.control_dt
        due = self._held & (now - begun >= low + (high - low) * self._moment)
        for row in due.nonzero()[0]:
            set_solid(self.engine.models[row], 0, False)
        self._held &= ~due

    def _is_flat(self, box: Tensor) -> Tensor:
        if self.obstacle.rise:
            box = box.clone()
            box[:, 2] -= self.obstacle.rise
        return super()._is_flat(box)

    def _task_step(self, observation: dict[str, Any], ended: Tensor) -> dict[str, Any]:
        if self.obstacle.hold is not None:
            self._release()
        return super()._task_step(observation, ended)

    def _task_observation(self, *args: Any) -> dict[str, Any]:
        measured = torch.from_numpy(self._contact.measured).to(self.dtype, copy=True)
        last = dict(zip(CONTACT, measured[:, -1].split(1, -1), strict=True))
        touched = ~last["contact_time"].isnan()
        last["contact_time"] = last["contact_time"].nan_to_num(0.0)
        held = measured[:, 0, :1]
        last |= {"contact": touched, "held_force": held, "kind": self.kind.to(self.dtype)}
        return super()._task_observation(*args) | last

    def _task_spec(self, make: SpecMaker) -> Composite:
        spec = super()._task_spec(make)
        for name in (*CONTACT, "held_force", "kind"):
            spec[name] = make.real(1)
        spec["contact"] = make.flag()
        return spec

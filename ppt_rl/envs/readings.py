"""Sensor readings of the arm in the library's conventions."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from ppt_rl.functional.rotations import quat_rotate

__all__ = ["ArmReadings", "sensor_span"]


def sensor_span(model: Any, first: str, last: str) -> slice:
    """The slice of the sensor vector from one sensor to another, both included.

    Args:
        model: ``mujoco.MjModel``.
        first: name of the first sensor.
        last: name of the last sensor.

    Returns:
        The slice.
    """
    begin, end = model.sensor(first), model.sensor(last)
    return slice(int(begin.adr[0]), int(end.adr[0] + end.dim[0]))


class ArmReadings:
    """Turns sensor vectors into observations of the arm.

    Args:
        model: compiled model with the sensors of ``arm_model`` and ``attach_tool``.
        dtype: precision of the observations.
        device: where the readings are.
    """

    def __init__(self, model: Any, dtype: torch.dtype, device: torch.device | None = None) -> None:
        self.slices = {
            "joint_position": sensor_span(model, "joint_position1", f"joint_position{model.nu}"),
            "joint_velocity": sensor_span(model, "joint_velocity1", f"joint_velocity{model.nu}"),
            "pose": sensor_span(model, "position", "orientation"),
            "twist": sensor_span(model, "linear_velocity", "angular_velocity"),
        }
        spans = [*self.slices.values(), sensor_span(model, "force", "torque")]
        edges = sorted({0, int(model.nsensordata)}.union(*((span.start, span.stop) for span in spans)))
        self._sizes = [end - start for start, end in pairwise(edges)]
        self._places = [edges.index(span.start) for span in spans]
        tool, point = model.body("tool"), model.site("end_effector").pos
        self._weight = torch.tensor(float(tool.mass[0]) * model.opt.gravity, dtype=dtype, device=device)  # [N]
        self._com = torch.tensor(
            tool.ipos - point, dtype=dtype, device=device
        )  # from the end-effector point, in tool axes [m]

    def observe(self, sensors: Tensor) -> dict[str, Tensor]:
        """Split readings into observations: the wrench is computed, the others are views of the readings.

        Args:
            sensors: ``(B, S)`` readings.

        Returns:
            ``joint_position`` ``(B, n)`` [rad], ``joint_velocity`` ``(B, n)`` [rad/s], ``pose`` ``(B, 7)`` [m, -],
            ``twist`` ``(B, 6)`` [m/s, rad/s] and ``wrench`` ``(B, 6)`` [N, N m], as in :class:`ppt_rl.envs.ArmEnv`.
        """
        pieces = sensors.split_with_sizes(self._sizes, 1)
        *parts, force = (pieces[place] for place in self._places)
        observation = dict(zip(self.slices, parts, strict=True))
        observation["wrench"] = self._wrench(force, observation["pose"][:, 3:])
        return observation

    def _wrench(self, reading: Tensor, orientation: Tensor) -> Tensor:
        """Wrench on the world in world axes: wrist force and torque with the tool's weight subtracted."""
        com = self._com.expand(len(reading), 1, 3)
        turned = quat_rotate(orientation.unsqueeze(1), torch.cat([reading.view(-1, 2, 3), com], 1))
        force, torque, com = turned.unbind(1)
        weight = self._weight.expand_as(com)
        return torch.cat([force + weight, torque + torch.linalg.cross(com, weight)], -1)

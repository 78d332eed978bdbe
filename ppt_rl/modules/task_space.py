"""Task-space coordinates of a movement primitive, and the end-effector poses that they describe."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.rotations import quat_conjugate, quat_from_yaw, quat_multiply, yaw_from_quat

__all__ = ["TaskSpace"]

_LINEAR = ("x", "y", "z")


class TaskSpace(nn.Module):
    """Map between D task-space coordinates and pose and twist of the end effector.

    ``x``, ``y``, ``z`` are world coordinates of the end-effector point [m]; ``yaw`` rotates the orientation of the
    origin about the world z axis [rad]. A coordinate that is not among ``axes`` keeps its value in the origin pose.

    Args:
        axes: names of the coordinates, in the order of the D columns.
        origin: ``(7,)`` pose that provides all other coordinates [m, -].

    Raises:
        ValueError: if a name is unknown or occurs twice, or the origin is not a pose.

    Examples:
        >>> space = TaskSpace(("x", "y", "yaw"), (0.4, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0))
        >>> space.project(space.pose(torch.tensor([0.5, 0.1, 0.3])))
        tensor([0.5000, 0.1000, 0.3000])
    """

    origin: Tensor

    def __init__(self, axes: Sequence[str], origin: Sequence[float]) -> None:
        super().__init__()
        valid = (*_LINEAR, "yaw")
        if not axes or len(set(axes)) != len(axes) or any(axis not in valid for axis in axes):
            raise ValueError(f"axes are {tuple(axes)}; expected one or more distinct names from {valid}.")
        if len(origin) != 7:
            raise ValueError(f"origin has {len(origin)} numbers; expected 7: x, y, z, qw, qx, qy, qz.")
        self.axes = tuple(axes)
        self.register_buffer("origin", torch.tensor(origin, dtype=torch.get_default_dtype()))

    @property
    def num_dof(self) -> int:
        """Number of coordinates D."""
        return len(self.axes)

    def pose(self, position: Tensor) -> Tensor:
        """End-effector pose at given coordinates.

        Args:
            position: ``(*B, D)`` coordinates [m, rad].

        Returns:
            ``(*B, 7)`` pose in world [m, -].
        """
        require_last_dim("task-space position", position, self.num_dof)
        origin = self.origin.to(position.dtype)
        columns = [
            position[..., self.axes.index(axis)] if axis in self.axes else origin[i].expand(position.shape[:-1])
            for i, axis in enumerate(_LINEAR)
        ]
        if "yaw" in self.axes:
            quat = quat_multiply(
                quat_from_yaw(position[..., self.axes.index("yaw")]), origin[3:].expand(*position.shape[:-1], 4)
            )
        else:
            quat = origin[3:].expand(*position.shape[:-1], 4)
        return torch.cat([torch.stack(columns, -1), quat], -1)

    def twist(self, velocity: Tensor) -> Tensor:
        """End-effector twist at given velocities of the coordinates.

        Args:
            velocity: ``(*B, D)`` velocities [m/s, rad/s].

        Returns:
            ``(*B, 6)`` twist, world axes [m/s, rad/s].
        """
        zero = torch.zeros_like(velocity[..., 0])
        names = (*_LINEAR, "roll", "pitch", "yaw")
        return torch.stack([velocity[..., self.axes.index(name)] if name in self.axes else zero for name in names], -1)

    def difference(self, position: Tensor, other: Tensor) -> Tensor:
        """``position - other``, with the difference in yaw wrapped to ``[-pi, pi]``.

        Args:
            position: ``(*B, D)`` coordinates [m, rad].
            other: ``(*B, D)`` coordinates [m, rad].

        Returns:
            ``(*B, D)`` difference [m, rad].
        """
        difference = position - other
        if "yaw" in self.axes:
            turns = (difference[..., self.axes.index("yaw")] / (2 * math.pi)).round()
            full = torch.zeros_like(difference)
            full[..., self.axes.index("yaw")] = 2 * math.pi * turns
            difference = difference - full
        return difference

    def project(self, pose: Tensor) -> Tensor:
        """Coordinates of a pose. It inverts :meth:`pose` for poses that the coordinates can describe.

        Args:
            pose: ``(*B, 7)`` pose in world [m, -].

        Returns:
            ``(*B, D)`` coordinates [m, rad].
        """
        turn = quat_multiply(pose[..., 3:], quat_conjugate(self.origin[3:].to(pose.dtype)).expand_as(pose[..., 3:]))
        columns = {"x": pose[..., 0], "y": pose[..., 1], "z": pose[..., 2], "yaw": yaw_from_quat(turn)}
        return torch.stack([columns[axis] for axis in self.axes], -1)

"""Task-space coordinates of a movement primitive, and the end-effector poses that they describe."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ppt_rl.functional.argument_checks import require_numbers
from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.rotations import quat_conjugate, quat_from_yaw, quat_multiply, yaw_from_quat

__all__ = ["TaskSpace"]

_LINEAR = ("x", "y", "z")
#: Largest difference of a unit quaternion's norm from 1 [-].
_UNIT = 1e-3


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
        names = tuple(axes) if isinstance(axes, Sequence) and not isinstance(axes, str) else ()
        if not names or any(axis not in valid for axis in names) or len(set(names)) != len(names):
            shown = names or repr(axes)
            raise ValueError(f"axes are {shown}; expected one or more distinct names from {valid}.")
        pose = require_numbers("origin", origin, (7,))
        norm = float(pose[3:].norm())
        if abs(norm - 1.0) > _UNIT:
            raise ValueError(
                f"origin has the quaternion {tuple(pose[3:].tolist())} of norm {norm:.3g}; expected a unit quaternion "
                "qw, qx, qy, qz after x, y, z."
            )
        self.axes = names
        self.register_buffer("origin", pose)

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

        Raises:
            ValueError: if there are not D coordinates.
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

        Raises:
            ValueError: if there are not D velocities.
        """
        require_last_dim("task-space velocity", velocity, self.num_dof)
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

        Raises:
            ValueError: if there are not D coordinates.
        """
        require_last_dim("position", position, self.num_dof)
        require_last_dim("other", other, self.num_dof)
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

        Raises:
            ValueError: if the pose has not 7 numbers.
        """
        require_last_dim("pose", pose, 7)
        turn = quat_multiply(pose[..., 3:], quat_conjugate(self.origin[3:].to(pose.dtype)).expand_as(pose[..., 3:]))
        columns = {"x": pose[..., 0], "y": pose[..., 1], "z": pose[..., 2], "yaw": yaw_from_quat(turn)}
        return torch.stack([columns[axis] for axis in self.axes], -1)

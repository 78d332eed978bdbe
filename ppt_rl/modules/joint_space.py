"""Joint positions as the coordinates of a movement primitive."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.joints import joint_difference

__all__ = ["JointSpace", "continuous_joints"]


class JointSpace(nn.Module):
    """Joint positions as coordinates: what :class:`TaskSpace` is for the end effector, for any robot and no kinematics.

    A transform that takes a task space takes this one too. The "pose" is then the joint position, D numbers, and the
    "twist" the joint velocity, D numbers, so that a reference has 2 D numbers instead of 13.

    Args:
        num_dof: number of joints D.
        continuous: indices of the joints that turn without end, of which :meth:`difference` takes the shorter way.

    Raises:
        ValueError: if there is no joint, or an index is out of range.

    Examples:
        >>> space = JointSpace(2, continuous=(0,))
        >>> space.difference(torch.tensor([3.0, 3.0]), torch.tensor([-3.0, -3.0]))
        tensor([-0.2832,  6.0000])
    """

    continuous: Tensor

    def __init__(self, num_dof: int, continuous: Sequence[int] = ()) -> None:
        super().__init__()
        if num_dof < 1:
            raise ValueError(f"num_dof is {num_dof}; expected at least 1 joint.")
        self.num_dof = int(num_dof)
        self.register_buffer("continuous", continuous_joints(self.num_dof, continuous), persistent=False)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the coordinates: ``joint1`` to ``jointD``."""
        return tuple(f"joint{i}" for i in range(1, self.num_dof + 1))

    def pose(self, position: Tensor) -> Tensor:
        """The first half of a reference.

        Args:
            position: ``(*B, D)`` joint positions [rad].

        Returns:
            The same.
        """
        return self._checked("joint position", position)

    def twist(self, velocity: Tensor) -> Tensor:
        """The second half of a reference.

        Args:
            velocity: ``(*B, D)`` joint velocities [rad/s].

        Returns:
            The same.
        """
        return self._checked("joint velocity", velocity)

    def difference(self, position: Tensor, other: Tensor) -> Tensor:
        """``position - other``, for continuous joints wrapped to half a turn.

        Args:
            position: ``(*B, D)`` joint positions [rad].
            other: ``(*B, D)`` joint positions [rad].

        Returns:
            ``(*B, D)`` difference [rad].
        """
        return joint_difference(position, other, self.continuous)

    def project(self, pose: Tensor) -> Tensor:
        """Coordinates of a measured joint position.

        Args:
            pose: ``(*B, D)`` joint positions [rad].

        Returns:
            The same.

        Raises:
            ValueError: if the last dimension is not D.
        """
        return self._checked("joint position", pose)

    def _checked(self, name: str, value: Tensor) -> Tensor:
        require_last_dim(f"{name} of JointSpace({self.num_dof})", value, self.num_dof)
        return value

    def extra_repr(self) -> str:
        """Size, for ``print``."""
        return f"num_dof={self.num_dof}"


def continuous_joints(num_dof: int, indices: Sequence[int]) -> Tensor:
    """Mask of the joints that turn without end.

    Args:
        num_dof: number of joints D.
        indices: of those joints.

    Returns:
        ``(D,)`` bool.

    Raises:
        ValueError: if an index is out of range.
    """
    mask = torch.zeros(num_dof, dtype=torch.bool)
    for index in indices:
        if isinstance(index, bool) or not 0 <= index < num_dof:
            raise ValueError(f"continuous is {tuple(indices)}; expected indices of joints, 0 to {num_dof - 1}.")
        mask[index] = True
    return mask

"""Seeded random quantities that several test files draw."""

import torch
from torch import Tensor

from ppt_rl.arms import PANDA, Arm
from ppt_rl.functional.promp import Gaussian


def random_quats(*shape: int, seed: int = 0) -> Tensor:
    """Unit quaternions, uniform over the rotations, float64."""
    quats = torch.randn(*shape, 4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return quats / quats.norm(dim=-1, keepdim=True)


def random_poses(*shape: int, seed: int = 0) -> Tensor:
    """Poses with positions in the unit cube, float64."""
    position = torch.rand(*shape, 3, generator=torch.Generator().manual_seed(seed + 1), dtype=torch.float64)
    return torch.cat([position, random_quats(*shape, seed=seed)], -1)


def random_joint_positions(*shape: int, arm: Arm = PANDA, seed: int = 0) -> Tensor:
    """Joint positions, uniform between the limits, float64."""
    low, high = torch.tensor(arm.joints.position_limits, dtype=torch.float64).unbind(-1)
    return low + (high - low) * torch.rand(
        *shape, arm.num_joints, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
    )


def normal(*shape: int, seed: int = 0) -> Tensor:
    """Standard normal numbers, float64."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def random_cov(*batch: int, size: int, scale: float = 1.0, seed: int = 0) -> Tensor:
    """Positive definite matrices ``(*batch, size, size)``."""
    root = normal(*batch, size, size, seed=seed)
    return scale * (root @ root.mT / size + 0.1 * torch.eye(size, dtype=torch.float64))


def random_gaussian(size: int, *batch: int, seed: int = 0) -> Gaussian:
    """Normal distributions with means ``(*batch, size)``."""
    return Gaussian(normal(*batch, size, seed=seed + 1), random_cov(*batch, size=size, seed=seed))

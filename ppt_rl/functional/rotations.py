"""Unit quaternions ``(w, x, y, z)`` and rotation matrices: batched, with finite gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.constants import constant
from ppt_rl.functional.shape_checks import require_same_batch, require_trailing

__all__ = [
    "matrix_to_quat",
    "quat_conjugate",
    "quat_from_yaw",
    "quat_multiply",
    "quat_rotate",
    "quat_to_matrix",
    "vee",
    "yaw_from_quat",
]


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product ``a * b``: rotation ``b`` first, then ``a``.

    Args:
        a: ``(*B, 4)`` quaternion, w first.
        b: ``(*B, 4)`` quaternion, w first.

    Returns:
        ``(*B, 4)`` product.

    Raises:
        ValueError: if a shape does not fit.
    """
    require_last_dim("a", a, 4)
    require_last_dim("b", b, 4)
    require_same_batch(a=a, b=b)
    aw, av = a[..., :1], a[..., 1:]
    bw, bv = b[..., :1], b[..., 1:]
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    v = aw * bv + bw * av + torch.linalg.cross(av, bv)
    return torch.cat([w, v], -1)


def quat_conjugate(quat: Tensor) -> Tensor:
    """Inverse of a unit quaternion.

    Args:
        quat: ``(*B, 4)`` unit quaternion, w first.

    Returns:
        ``(*B, 4)`` conjugate.

    Raises:
        ValueError: if the shape does not fit.
    """
    require_last_dim("quat", quat, 4)
    return torch.cat([quat[..., :1], -quat[..., 1:]], -1)


def quat_rotate(quat: Tensor, vector: Tensor) -> Tensor:
    """Rotate ``vector`` by ``quat``: ``v + 2 w (u x v) + 2 u x (u x v)``.

    Args:
        quat: ``(*B, 4)`` unit quaternion ``(w, u)``.
        vector: ``(*B, 3)`` vector.

    Returns:
        ``(*B, 3)`` rotated vector.

    Raises:
        ValueError: if a shape does not fit.
    """
    require_last_dim("quat", quat, 4)
    require_last_dim("vector", vector, 3)
    require_same_batch(quat=quat, vector=vector)
    w, u = quat.split_with_sizes((1, 3), -1)
    u = u.expand_as(vector)
    t = constant(2.0, vector) * torch.linalg.cross(u, vector)
    return vector + w * t + torch.linalg.cross(u, t)


def quat_to_matrix(quat: Tensor) -> Tensor:
    """Rotation matrix of a unit quaternion.

    Args:
        quat: ``(*B, 4)`` unit quaternion, w first.

    Returns:
        ``(*B, 3, 3)`` rotation matrix.

    Raises:
        ValueError: if the shape does not fit.
    """
    require_last_dim("quat", quat, 4)
    w, x, y, z = quat.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def matrix_to_quat(matrix: Tensor) -> Tensor:
    """Unit quaternion of a rotation matrix, with ``w >= 0``.

    Four algebraically equal forms divide by different numbers; the one with the largest divisor is used, so that the
    division is always well conditioned.

    Args:
        matrix: ``(*B, 3, 3)`` rotation matrix.

    Returns:
        ``(*B, 4)`` quaternion, w first.

    Raises:
        ValueError: if the shape does not fit.
    """
    require_trailing("matrix", matrix, 3, 3)
    m = matrix
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # The entries of 4 q q^T; its row i is 4 q_i q.
    ww, xx = 1 + m00 + m11 + m22, 1 + m00 - m11 - m22
    yy, zz = 1 - m00 + m11 - m22, 1 - m00 - m11 + m22
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    outer = torch.stack([ww, wx, wy, wz, wx, xx, xy, xz, wy, xy, yy, yz, wz, xz, yz, zz], -1).unflatten(-1, (4, 4))
    best = torch.stack([ww, xx, yy, zz], -1).argmax(-1)
    row = outer.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    quat = row / row.norm(dim=-1, keepdim=True)
    return torch.where(quat[..., :1] < 0, -quat, quat)


def quat_from_yaw(yaw: Tensor) -> Tensor:
    """Rotation by ``yaw`` about the world z axis.

    Args:
        yaw: ``(*B,)`` angle [rad].

    Returns:
        ``(*B, 4)`` quaternion, w first.

    Raises:
        ValueError: if it is no tensor.
    """
    require_instance("yaw", yaw, Tensor)
    half = 0.5 * yaw
    zero = torch.zeros_like(half)
    return torch.stack([half.cos(), zero, zero, half.sin()], -1)


def yaw_from_quat(quat: Tensor) -> Tensor:
    """Yaw angle of a quaternion, in z-y-x Euler angles.

    Args:
        quat: ``(*B, 4)`` unit quaternion, w first.

    Returns:
        ``(*B,)`` yaw in (-pi, pi] [rad].

    Raises:
        ValueError: if the shape does not fit.
    """
    require_last_dim("quat", quat, 4)
    w, x, y, z = quat.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def vee(matrix: Tensor) -> Tensor:
    """Vector of a skew-symmetric matrix: ``vee([v]_x) = v``.

    Args:
        matrix: ``(*B, 3, 3)`` skew-symmetric matrix.

    Returns:
        ``(*B, 3)`` vector.

    Raises:
        ValueError: if the shape does not fit.
    """
    require_trailing("matrix", matrix, 3, 3)
    return torch.stack([matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0]], -1)

"""An arm with its tool as a serial chain of pytorch-kinematics."""

from __future__ import annotations

import math

import pytorch_kinematics as pk
import torch
from pytorch_kinematics.frame import Frame, Joint, Link
from torch import Tensor

from ppt_rl.arms import Arm

__all__ = ["offsets_of", "serial_chain"]


def _turn_x(angle: float) -> Tensor:
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]], dtype=torch.float64)


def _turn_z(angle: float) -> Tensor:
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _offsets(arm: Arm, tool_length: float) -> Tensor:
    """``(n + 1, 4, 4)`` poses of the joints and of the end-effector point, each in the frame before it."""
    offsets = torch.eye(4, dtype=torch.float64).repeat(arm.num_joints + 1, 1, 1)
    for matrix, offset in zip(offsets, arm.chain.offsets, strict=False):
        matrix[:3, :3] = _turn_x(offset.twist) @ _turn_z(offset.turn)
        matrix[:3, 3] = torch.tensor(offset.position, dtype=torch.float64)
    offsets[-1, :3, :3] = _turn_z(arm.chain.tool_turn)
    offsets[-1, 2, 3] = arm.chain.flange + tool_length
    return offsets


def serial_chain(arm: Arm, tool_length: float) -> pk.SerialChain:
    """The serial chain of an arm's joints and its tool, in double precision on the CPU.

    Args:
        arm: the arm.
        tool_length: distance from flange to end-effector point [m].

    Returns:
        The chain. Its frames are ``base``, ``link1`` to ``link{n}`` and ``tool``; the joints have the arm's limits.
    """
    f64 = torch.float64
    base = Frame("base", link=Link("base"), joint=Joint("base_fixed", dtype=f64))
    parent = base
    *joints, tip = (pk.Transform3d(matrix=offset, dtype=f64) for offset in _offsets(arm, tool_length))
    for i, (offset, limits) in enumerate(zip(joints, arm.joints.position_limits, strict=True), start=1):
        joint = Joint(f"joint{i}", offset, "revolute", (0.0, 0.0, 1.0), dtype=f64, limits=tuple(limits))
        child = Frame(f"link{i}", link=Link(f"link{i}"), joint=joint)
        parent.add_child(child)
        parent = child
    parent.add_child(Frame("tool", link=Link("tool"), joint=Joint("tool_fixed", tip, "fixed", dtype=f64)))
    return pk.SerialChain(pk.Chain(base, dtype=f64), "tool", dtype=f64)


def offsets_of(chain: pk.SerialChain) -> Tensor:
    """The constants of a chain of :func:`serial_chain`.

    Args:
        chain: the chain of an arm with n joints.

    Returns:
        ``(n + 1, 4, 4)`` poses of the joints and of the end-effector point, each in the frame before it.
    """
    names = [*(f"link{i}" for i in range(1, len(chain.get_joint_parameter_names()) + 1)), "tool"]
    return torch.stack([chain.find_frame(name).joint.offset.get_matrix()[0] for name in names])

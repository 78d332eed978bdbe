"""Which velocity an effort works on."""

from __future__ import annotations

from collections.abc import Mapping

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

__all__ = ["flow_of_size", "same_shape"]


def flow_of_size(
    flows: Mapping[str, Tensor | None], effort_key: NestedKey, size: int, tensordict: TensorDictBase
) -> tuple[str, Tensor]:
    """The one velocity that has the size of an effort.

    Args:
        flows: velocities by key, None where there is none.
        effort_key: the effort, for messages.
        size: of the effort.
        tensordict: where the velocities were looked for, for messages.

    Returns:
        Key and velocity.

    Raises:
        ValueError: if more than one has that size.
        KeyError: if none has it.
    """
    fitting = {key: flow for key, flow in flows.items() if flow is not None and flow.shape[-1] == size}
    if len(fitting) == 1:
        return fitting.popitem()
    if fitting:
        raise ValueError(
            f"{list(fitting)} both have the size {size} of the effort {effort_key!r}; expected one velocity that it "
            "works on. Pass flow_key='twist' for a wrench, flow_key='joint_velocity' for joint torque."
        )
    present = sorted(str(key) for key in tensordict.keys(True, True))
    raise KeyError(
        f"EnergyTankTransform found no velocity for the effort {effort_key!r} of size {size}: none of {tuple(flows)} "
        f"has that size. Pass flow_key=, the velocity that the effort works on; there are {present}."
    )


def same_shape(key: NestedKey, flow: Tensor, effort_key: NestedKey, effort: Tensor) -> Tensor:
    """A velocity in the shape of the effort that works on it.

    Args:
        key: the velocity, for messages.
        flow: ``(*B, N)``; without the last dimension where N = 1.
        effort_key: the effort, for messages.
        effort: ``(*B, N)``.

    Returns:
        ``(*B, N)`` velocity.

    Raises:
        ValueError: if it has another shape.
    """
    if effort.shape[-1] == 1 and flow.shape == effort.shape[:-1]:
        return flow.unsqueeze(-1)
    if flow.shape != effort.shape:
        chunk = " A chunk of efforts? Append the tank before the MacroStepTransform." if effort.ndim > flow.ndim else ""
        raise ValueError(
            f"the velocity {key!r} has shape {tuple(flow.shape)} and the effort {effort_key!r} {tuple(effort.shape)}; "
            f"expected the same shape, so that their product is a power.{chunk}"
        )
    return flow

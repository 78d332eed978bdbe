"""A Cartesian impedance controller with its gains."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from ppt_rl.arms import PANDA
from ppt_rl.functional.checks import require_last_dim
from ppt_rl.functional.impedance import cartesian_impedance, critical_damping

__all__ = ["ROTATIONAL_SHARE", "CartesianImpedanceController"]

#: What one number for all six axes means for rotation: stiffness and damping about an axis, per stiffness and damping
#: along it. With the default, 30 N m/rad for 400 N/m [m^2].
ROTATIONAL_SHARE = 0.075
#: Default stiffness: high enough to track a reference, low enough for contact [N/m, N m/rad].
STIFFNESS = (400.0, 400.0, 400.0, 30.0, 30.0, 30.0)


class CartesianImpedanceController(nn.Module):
    r"""Computes the wrench of a spring and a damper between the end effector and a moving reference.

    .. math:: \lambda = K\,[x_d - x;\ e_R] + D\,(\nu_d - \nu), \qquad D = 2\,\zeta\,\sqrt{K M}

    for each world axis, where ``M`` is the apparent inertia. Everything is differentiable. One number for stiffness or
    damping is that of translation; rotation gets :data:`ROTATIONAL_SHARE` = 0.075 m^2 times that number. One for both
    would be wrong: 400 N/m is moderate, but 400 N m/rad makes a wrist chatter at 100 Hz.

    An :class:`~ppt_rl.transforms.ImpedanceTransform` warns where the gains are unstable at the environment's rate.

    Args:
        stiffness: K, one number [N/m] or six [N/m, N m/rad].
        damping_ratio: zeta, one number or six [-].
        damping: D, one number [N s/m] or six [N s/m, N m s/rad]; None derives it from the damping ratio.
        inertia: M, six numbers [kg, kg m^2]: the arm's ``apparent_inertia``; the default is the Panda's.
        learnable: whether the gains are parameters; their logarithms are stored, so that they stay positive.

    Raises:
        ValueError: if a gain is not positive, or has neither one nor six numbers.

    Source:
        Paper, eq. (5), with the orientation error corrected.

    Examples:
        >>> controller = CartesianImpedanceController(stiffness=400.0, damping_ratio=1.0)
        >>> pose = torch.tensor([[0.4, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0]])
        >>> controller(pose, torch.zeros(1, 6), pose, torch.zeros(1, 6)).abs().max()
        tensor(0.)
    """

    def __init__(
        self,
        stiffness: float | Sequence[float] = STIFFNESS,
        damping_ratio: float | Sequence[float] = 1.0,
        *,
        damping: float | Sequence[float] | None = None,
        inertia: Sequence[float] = PANDA.apparent_inertia,
        learnable: bool = False,
    ) -> None:
        super().__init__()
        gains = {"stiffness": _six("stiffness", stiffness, ROTATIONAL_SHARE), "inertia": _six("inertia", inertia)}
        if damping is None:
            gains["damping_ratio"] = _six("damping_ratio", damping_ratio)
        else:
            gains["fixed_damping"] = _six("damping", damping, ROTATIONAL_SHARE)
        for name, value in gains.items():
            log = value.log()
            if learnable and name != "inertia":
                self.register_parameter(f"log_{name}", nn.Parameter(log))
            else:
                self.register_buffer(f"log_{name}", log)

    def _gain(self, name: str) -> Tensor:
        log: Tensor = getattr(self, f"log_{name}")
        return log.exp()

    @property
    def stiffness(self) -> Tensor:
        """``(6,)`` diagonal of K [N/m, N m/rad]."""
        return self._gain("stiffness")

    @property
    def damping(self) -> Tensor:
        """``(6,)`` diagonal of D [N s/m, N m s/rad]."""
        return self._damping(self.stiffness)

    @property
    def inertia(self) -> Tensor:
        """``(6,)`` diagonal of M, the apparent inertia [kg, kg m^2]."""
        return self._gain("inertia")

    def _damping(self, stiffness: Tensor) -> Tensor:
        if hasattr(self, "log_fixed_damping"):
            return self._gain("fixed_damping")
        ratio, inertia = self._gain("damping_ratio"), self._gain("inertia")
        return critical_damping(stiffness, ratio.to(stiffness.dtype), inertia.to(stiffness.dtype))

    def _constant_gains(self, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        """Stiffness and damping ``(6,)`` that nobody learns, computed anew where what they follow from has changed."""
        logs = tuple(self._buffers.values())
        if any(log.is_inference() for log in logs):  # type: ignore[union-attr]  # nobody can tell whether they changed
            return self.stiffness.to(dtype), self.damping.to(dtype)
        source = (dtype, *(log._version for log in logs))  # type: ignore[union-attr]
        known = self.__dict__.get("_known_gains")
        if known is None or known[0] != source or any(a is not b for a, b in zip(known[1], logs, strict=True)):
            with torch.inference_mode(False):  # cached, so used outside of it too
                stiffness = self.stiffness.to(dtype)
                known = self.__dict__["_known_gains"] = source, logs, (stiffness, self._damping(stiffness).to(dtype))
        return known[2]

    def forward(
        self,
        pose: Tensor,
        twist: Tensor,
        reference_pose: Tensor,
        reference_twist: Tensor,
        stiffness: Tensor | None = None,
        damping: Tensor | None = None,
    ) -> Tensor:
        """Compute the wrench that drives the end effector towards the reference.

        Args:
            pose: ``(*B, 7)`` end-effector pose in world [m, -].
            twist: ``(*B, 6)`` end-effector twist in world axes [m/s, rad/s].
            reference_pose: ``(*B, 7)`` desired pose in world [m, -].
            reference_twist: ``(*B, 6)`` desired twist in world axes [m/s, rad/s]; with zero, the arm lags behind a
                moving reference.
            stiffness: ``(*B, 6)``, in place of the controller's own [N/m, N m/rad].
            damping: ``(*B, 6)``, in place of the one derived from the stiffness [N s/m, N m s/rad].

        Returns:
            ``(*B, 6)`` wrench applied by the robot at the end-effector point, in world axes [N, N m].

        Raises:
            ValueError: if a last dimension is wrong.
        """
        require_last_dim("pose", pose, 7)
        if stiffness is None and damping is None and not self._parameters and not torch.compiler.is_compiling():
            stiffness, damping = self._constant_gains(pose.dtype)
        stiffness = self.stiffness.to(pose.dtype) if stiffness is None else stiffness
        damping = self._damping(stiffness).to(pose.dtype) if damping is None else damping
        return cartesian_impedance(pose, twist, reference_pose, reference_twist, stiffness, damping)


def _six(name: str, value: float | Sequence[float], share: float = 1.0) -> Tensor:
    """Gains of the six axes; of one number, rotation gets a share."""
    try:
        gains = torch.as_tensor(value, dtype=torch.get_default_dtype())
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} is {value!r}; expected 1 or 6 positive finite numbers.") from error
    if gains.numel() not in (1, 6):
        raise ValueError(f"{name} has {gains.numel()} numbers; expected 1 or 6 (three linear, three angular).")
    if not bool((gains > 0).all()) or not bool(torch.isfinite(gains).all()):
        raise ValueError(f"{name} is {value}; expected positive finite numbers.")
    if gains.numel() == 6:
        return gains.reshape(6).clone()
    return gains.reshape(1) * gains.new_tensor((1.0, 1.0, 1.0, share, share, share))

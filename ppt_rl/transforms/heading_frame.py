"""What the tool feels, seen along its heading: so that a turn looks like a straight corridor entered at an angle."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded

from ppt_rl.functional.checks import require_positive
from ppt_rl.functional.contact import wall_contact
from ppt_rl.functional.heading import follow_heading, to_heading
from ppt_rl.transforms.base import StatefulTransform
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["HeadingFrameTransform"]


class HeadingFrameTransform(TimedTransform, StatefulTransform):
    r"""Keeps the heading of a sliding tool and writes its twist and wrench in heading axes.

    .. math:: \nu_h = R_z(-\psi)\,\nu, \qquad \lambda_h = R_z(-\psi)\,\bar\lambda

    The heading follows the way made lately, and the wall where the tool is held up
    (:func:`~ppt_rl.functional.heading.follow_heading`); it begins at the observation ``start_heading``. ``\bar\lambda``
    is the wrench through a first-order low-pass. Append it at control rate, before a :class:`MacroStepTransform`.

    State and observations: ``heading`` ``(*B, 1)`` [rad], ``smooth_wrench`` ``(*B, 6)`` world axes [N, N m].
    Observations: ``heading_twist`` [m/s, rad/s] and ``heading_wrench`` [N, N m], ``(*B, 6)``, axes ahead, left, up.

    Args:
        distance: over which the heading forgets [m].
        patience: in which a tool that is held up turns along the wall [s].
        slow: speed of a tool that is held up [m/s].
        friction: estimate of walls and floor on the tool [-].
        min_force: a wall presses with more than this [N].
        smoothing: time constant of the wrench's low-pass [s].
        dt: control step [s]; None takes it from the environment, and needs one.
        twist_key: measured twist.
        wrench_key: measured wrench on the world.
        start_key: heading at the start, as the robot is told.

    Raises:
        KeyError: if an observation is missing.
        ValueError: if a number is not positive.

    Source:
        Ours; the paper gives observations in world axes.
    """

    def __init__(
        self,
        *,
        distance: float = 0.02,
        patience: float = 0.3,
        slow: float = 0.01,
        friction: float = 0.25,
        min_force: float = 1.0,
        smoothing: float = 0.05,
        dt: float | None = None,
        twist_key: NestedKey = "twist",
        wrench_key: NestedKey = "wrench",
        start_key: NestedKey = "start_heading",
    ) -> None:
        super().__init__(in_keys=[twist_key, wrench_key, start_key], out_keys=["heading_twist", "heading_wrench"])
        self.distance = require_positive("distance", distance, "m")
        self.patience = require_positive("patience", patience, "s")
        self.slow = require_positive("slow", slow, "m/s")
        self.friction = require_positive("friction", friction)
        self.min_force = require_positive("min_force", min_force, "N")
        self.smoothing = require_positive("smoothing", smoothing, "s")
        self.dt = dt

    def _read(self, tensordict: TensorDictBase) -> list[Tensor]:
        values = [tensordict.get(key, None) for key in self.in_keys]
        missing = [key for key, value in zip(self.in_keys, values, strict=True) if value is None]
        if missing:
            raise KeyError(f"HeadingFrameTransform needs {missing}; the tensordict holds {sorted(tensordict.keys())}.")
        return values

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        twist, wrench, start = self._read(next_tensordict)
        old = tensordict.get("heading", None), tensordict.get("smooth_wrench", None)
        heading, smooth = (start, wrench) if old[0] is None or old[1] is None else self._next(old, twist, wrench)
        step = tensordict.get("_step", None)
        if step is not None and old[0] is not None and old[1] is not None:
            rows = step.reshape(tensordict.batch_size)
            heading = torch.where(expand_as_right(rows, heading), heading, old[0])
            smooth = torch.where(expand_as_right(rows, smooth), smooth, old[1])
        return self._write(next_tensordict, twist, heading, smooth)

    def _next(self, old: tuple[Tensor, Tensor], twist: Tensor, wrench: Tensor) -> tuple[Tensor, Tensor]:
        (heading, smooth), dt = old, self.dt
        smooth = smooth + (wrench - smooth) * (dt / (self.smoothing + dt))
        velocity = twist[..., :2]
        wall = wall_contact(smooth[..., :3], velocity, heading, friction=self.friction, slow=self.slow)
        touching = torch.linalg.vector_norm(wall.force, dim=-1, keepdim=True) > self.min_force
        heading = follow_heading(
            heading, velocity, wall.tangent, touching,
            dt=dt, distance=self.distance, patience=self.patience, slow=self.slow,
        )  # fmt: skip
        return heading, smooth

    @staticmethod
    def _write(tensordict: TensorDictBase, twist: Tensor, heading: Tensor, smooth: Tensor) -> TensorDictBase:
        tensordict.set("heading", heading)
        tensordict.set("smooth_wrench", smooth)
        tensordict.set("heading_twist", to_heading(twist, heading))
        return tensordict.set("heading_wrench", to_heading(smooth, heading))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        twist, wrench, start = self._read(tensordict_reset)
        self._restart(tensordict, tensordict_reset, "heading", start)
        self._restart(tensordict, tensordict_reset, "smooth_wrench", wrench)
        return self._write(tensordict_reset, twist, tensordict_reset["heading"], tensordict_reset["smooth_wrench"])

    def _like(self) -> TensorSpec:
        return self.parent.full_observation_spec[self.in_keys[0]]

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        def real(size: int) -> Unbounded:
            return Unbounded(shape=(*batch, size), dtype=like.dtype, device=like.device)

        return {"heading": real(1), "smooth_wrench": real(6)}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare heading, and twist and wrench along it."""
        observation_spec = super().transform_observation_spec(observation_spec)
        like, batch = self._like(), self.parent.batch_size
        for key in self.out_keys:
            observation_spec[key] = Unbounded(shape=(*batch, 6), dtype=like.dtype, device=like.device)
        return observation_spec

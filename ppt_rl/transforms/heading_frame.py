"""Twist and wrench in heading axes, in which a turn looks like a straight corridor that is entered at an angle."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.contact import WallTouch, wall_contact
from ppt_rl.functional.heading import follow_heading, to_heading
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["HeadingFrameTransform"]


class HeadingFrameTransform(TimedTransform, ObserverTransform):
    r"""Tracks the heading of a sliding tool and writes its twist and wrench in heading axes.

    .. math:: \nu_h = R_z(-\psi)\,\nu, \qquad \lambda_h = R_z(-\psi)\,\bar\lambda

    The heading follows the recent motion and, where the tool is held up, the wall
    (:func:`~ppt_rl.functional.heading.follow_heading`). An episode starts with the observed ``start_heading``.
    ``\bar\lambda`` is the wrench after a first-order low-pass. Append this transform at control rate, before a
    :class:`MacroStepTransform`.

    State and observations: ``heading`` ``(*B, 1)`` [rad], ``smooth_wrench`` ``(*B, 6)``, world axes [N, N m].
    Observations: ``heading_twist`` [m/s, rad/s] and ``heading_wrench`` [N, N m], ``(*B, 6)``, axes ahead, left, up.

    Args:
        distance: distance of travel over which the heading adapts [m].
        patience: time in which a tool that is held up turns along the wall [s].
        smoothing: time constant of the low-pass on the wrench [s].
        touch: how a wall is recognised: by a force above ``touch.on``. None takes the defaults.
        dt: control step [s]; None takes it from the environment, and needs one.
        twist_key: measured twist.
        wrench_key: measured wrench on the world.
        start_key: heading that the robot is given at the start of an episode.

    Raises:
        KeyError: if an observation is missing.
        ValueError: if a number is not positive.

    Source:
        Ours; the paper gives observations in world axes.
    """

    _at_control_rate = True
    state_keys = ("heading", "smooth_wrench")

    def __init__(
        self,
        *,
        distance: float = 0.02,
        patience: float = 0.3,
        smoothing: float = 0.05,
        touch: WallTouch | None = None,
        dt: float | None = None,
        twist_key: NestedKey = "twist",
        wrench_key: NestedKey = "wrench",
        start_key: NestedKey = "start_heading",
    ) -> None:
        super().__init__(in_keys=[twist_key, wrench_key, start_key], out_keys=["heading_twist", "heading_wrench"])
        self.distance = require_positive("distance", distance, "m")
        self.patience = require_positive("patience", patience, "s")
        self.smoothing = require_positive("smoothing", smoothing, "s")
        self.touch = WallTouch() if touch is None else touch
        require_instance("touch", self.touch, WallTouch)
        self.dt = dt

    def _begin(self, *readings: Tensor) -> Entries:
        twist, wrench, start = readings
        for key, value, size in zip(self.in_keys, (twist, wrench, start), (6, 6, 1), strict=True):
            require_last_dim(str(key), value, size)
        return {"heading": start, "smooth_wrench": wrench}

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        twist, wrench, _ = readings
        heading, smooth, touch, dt = state["heading"], state["smooth_wrench"], self.touch, self.dt
        smooth = smooth + (wrench - smooth) * (dt / (self.smoothing + dt))
        velocity = twist[..., :2]
        wall = wall_contact(smooth[..., :3], velocity, heading, friction=touch.friction, slow=touch.slow)
        touching = torch.linalg.vector_norm(wall.force, dim=-1, keepdim=True) > touch.on
        heading = follow_heading(
            heading, velocity, wall.tangent, touching,
            dt=dt, distance=self.distance, patience=self.patience, slow=touch.slow,
        )  # fmt: skip
        return {"heading": heading, "smooth_wrench": smooth}

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        heading = state["heading"]
        return {
            "heading_twist": to_heading(readings[0], heading),
            "heading_wrench": to_heading(state["smooth_wrench"], heading),
        }

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {"heading": real(like, *batch, 1), "smooth_wrench": real(like, *batch, 6)}

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {key: real(like, *batch, 6) for key in self.out_keys}

"""Control barriers: the smallest change of a wrench that keeps the tool's motion within limits."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec

from ppt_rl.arms import PANDA
from ppt_rl.functional.argument_checks import require_numbers, shown
from ppt_rl.functional.barrier import Barrier
from ppt_rl.functional.checks import require_finite, require_last_dim, require_positive
from ppt_rl.functional.half_spaces import MOST_HALF_SPACES, nearest_in_ball, project_half_spaces
from ppt_rl.transforms.base import ActionTransform, Entries
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["BarrierTransform"]


class BarrierTransform(TimedTransform, ActionTransform):
    r"""Changes the force of a wrench ``(*B, 6)`` as little as possible, so that the tool keeps to some limits.

    .. math:: \min_{f'} \lVert f' - f \rVert^2 \quad \text{so that} \quad a_i(x, v)^\top f' \le b_i(x, v), \quad
        \lVert f' - f'_{last} \rVert \le r\,\Delta t

    Each :class:`~ppt_rl.functional.barrier.Barrier` gives one constraint: a
    :class:`~ppt_rl.functional.barrier.SpeedBarrier` or a :class:`~ppt_rl.functional.barrier.PlaneBarrier`. The solution
    is exact (:mod:`ppt_rl.functional.half_spaces`), the torque passes unchanged, and so does a force that satisfies
    all constraints, bit by bit. Where no force satisfies all of them, the barriers go before the force rate.

    The limits hold for a tool with the given apparent inertia on which nothing else acts. The real inertia depends on
    the posture of the arm, and contacts and the posture torque act as well, so the barriers hold up to an error. On the
    simulated Panda, a tool that is led upwards at 0.4 m/s reaches 0.25 m/s under a limit of 0.2 m/s, and passes a plane
    by 2 mm. A tank nearer to the robot may scale down the force that brakes.

    Append it after the :class:`JointTorqueTransform` and the paper's tank, and before an :class:`ImpedanceTransform`.
    State and observations: ``barrier_change`` ``(*B, 1)``, the length of the change of the force in the last control
    step [N], and with a force rate ``barrier_force`` ``(*B, 3)``, the last force, zero at the start of an episode [N].

    Args:
        barriers: one to four limits.
        force_rate: largest rate of change of the force, r [N/s]; None sets no limit.
        inertia: apparent inertia along the world's x, y and z axes [kg]: the first three numbers of the arm's
            ``apparent_inertia``; the default is the Panda's.
        dt: control step [s]; None takes it from the environment, and needs one.
        action_key: the action: a wrench.
        reading_keys: end-effector pose and twist observations.

    Raises:
        ValueError: if there are no barriers or more than four, a number is out of range, a barrier's rate is above
            ``1 / dt``, the wrench has another size than 6 or is not finite, or the transform stands after a macro step.
        KeyError: if an observation is missing.

    Source:
        Ames et al. 2019, "Control barrier functions: theory and applications", European Control Conference.

    Examples:
        >>> from tensordict import TensorDict
        >>> from ppt_rl.functional import SpeedBarrier
        >>> limit = BarrierTransform([SpeedBarrier(0.25)], dt=0.01)
        >>> pose, twist = torch.zeros(7), torch.tensor([0.25, 0.0, 0.0, 0.0, 0.0, 0.0])
        >>> limit.inv(TensorDict(action=torch.full((6,), 8.0), pose=pose, twist=twist))["action"]
        tensor([0., 8., 8., 8., 8., 8.])
    """

    _at_control_rate = True

    def __init__(
        self,
        barriers: Sequence[Barrier],
        *,
        force_rate: float | None = None,
        inertia: Sequence[float] = PANDA.apparent_inertia[:3],
        dt: float | None = None,
        action_key: NestedKey = "action",
        reading_keys: tuple[NestedKey, NestedKey] = ("pose", "twist"),
    ) -> None:
        super().__init__(action_key)
        sequence = isinstance(barriers, Sequence) and not isinstance(barriers, str)
        if not sequence or not all(hasattr(barrier, "half_space") for barrier in barriers):
            raise ValueError(f"barriers is {shown(barriers)}; expected a list of them, such as [SpeedBarrier(0.25)].")
        if not 1 <= len(barriers) <= MOST_HALF_SPACES:
            raise ValueError(f"there are {len(barriers)} barriers; expected 1 to {MOST_HALF_SPACES}.")
        if not isinstance(reading_keys, tuple) or len(reading_keys) != 2:
            raise ValueError(f"reading_keys is {reading_keys!r}; expected two keys, of pose and twist.")
        self.barriers = tuple(barriers)
        self.force_rate = None if force_rate is None else require_positive("force_rate", force_rate, "N/s")
        masses = require_numbers("inertia", inertia, (3,), low=1e-9, unit="kg")
        self.register_buffer("inertia", masses, persistent=False)
        self.pose_key, self.twist_key = reading_keys
        self.dt = dt

    def _accept_dt(self, dt: float) -> None:
        fast = [barrier for barrier in self.barriers if barrier.rate * dt > 1 + 1e-9]
        if fast:
            raise ValueError(
                f"{fast[0]} has a rate above 1 / dt, which is {1 / dt:g} 1/s; expected at most that. Lower its rate."
            )

    @property
    def _readings(self) -> tuple[NestedKey, ...]:
        return self.pose_key, self.twist_key

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (wrench,) = self._require(tensordict, self.action_key)
        require_last_dim("wrench", wrench, 6)
        require_finite("wrench", wrench)
        pose, twist = (value.to(wrench.dtype) for value in self._recall(tensordict, self.pose_key, self.twist_key))
        force = wrench[..., :3]
        inertia = self.inertia.to(wrench)
        spaces = [barrier.half_space(pose[..., :3], twist[..., :3], inertia, self.dt) for barrier in self.barriers]
        normals = torch.stack([normal for normal, _ in spaces], -2)
        offsets = torch.cat([offset for _, offset in spaces], -1)
        allowed = self._allowed(tensordict, force, normals, offsets)
        change = torch.linalg.vector_norm(allowed - force, dim=-1, keepdim=True)
        for key, value in self._entries(change, allowed).items():
            self._stash(tensordict, key, value)
        return tensordict.set(self.action_key, torch.cat([allowed, wrench[..., 3:]], -1))

    def _allowed(self, tensordict: TensorDictBase, force: Tensor, normals: Tensor, offsets: Tensor) -> Tensor:
        if self.force_rate is None:
            return project_half_spaces(force, normals, offsets)
        last = self._known(tensordict, "barrier_force")
        last = torch.zeros_like(force) if last is None else last
        return nearest_in_ball(force, normals, offsets, last, self.force_rate * self.dt)

    def _entries(self, change: Tensor, force: Tensor) -> Entries:
        return {"barrier_change": change} | ({} if self.force_rate is None else {"barrier_force": force})

    def _after_step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in self._state_specs(self.parent.batch_size, self._like()):
            self._unstash(tensordict, next_tensordict, key)
        return next_tensordict

    def _after_reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key, zero in self._zeros(self._state_specs(self.parent.batch_size, self._like()), tensordict_reset).items():
            self._restart(tensordict, tensordict_reset, key, zero)
        return tensordict_reset

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        specs: dict[NestedKey, TensorSpec] = {"barrier_change": real(like, *like.shape[:-1], 1)}
        return specs if self.force_rate is None else specs | {"barrier_force": real(like, *like.shape[:-1], 3)}

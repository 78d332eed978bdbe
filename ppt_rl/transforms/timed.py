"""The control step of a transform: taken from its environment, or given and compared with the environment's."""

from __future__ import annotations

import math

from torchrl.data import Composite
from torchrl.envs import EnvBase, Transform
from torchrl.envs.batched_envs import BatchedEnvBase

from ppt_rl.functional.checks import require_positive
from ppt_rl.transforms.workers import base_environment

__all__ = ["TimedTransform", "control_step"]

#: Largest relative difference between a given control step and the environment's [-].
_TOLERANCE = 1e-6
#: Where the step is stored on the parent, which belongs to one transform alone.
_CACHE = "_dt_of_transform"


class TimedTransform(Transform):
    """A transform that needs the control step: the time from one action of the base environment to the next [s].

    A subclass accepts ``dt: float | None = None``, assigns it at the end of its constructor (``self.dt = dt``) and
    reads ``self.dt`` [s].

    * In an environment, ``dt`` is the attribute ``control_dt`` [s] of the base environment (:func:`control_step`). A
      given ``dt`` that differs from it is refused. Where the environment lacks the attribute, the given ``dt`` holds.
    * Without an environment (``inv``, ``forward``, replay buffers), ``dt`` has to be given.

    The check runs when the specs of the environment are computed, before its first reset. The value is stored on
    :attr:`parent`, which TorchRL makes anew whenever the transform or its chain moves.

    Args:
        in_keys: as for :class:`torchrl.envs.Transform`.
        out_keys: likewise.
        in_keys_inv: likewise.
        out_keys_inv: likewise.
    """

    #: Whether this transform needs the control step with the arguments it was given; if not, none may be missing.
    _needs_dt: bool = True
    _given_dt: float | None = None

    @property
    def dt(self) -> float:
        """Control step [s]."""
        parent = self.parent
        if parent is None:
            return self._resolved_dt(None, "it is in no environment")
        known = parent.__dict__.get(_CACHE)
        if known is None:
            lacking = f"{type(base_environment(parent)).__name__} has no attribute `control_dt`"
            known = parent.__dict__[_CACHE] = self._resolved_dt(control_step(parent), lacking)
        return known

    @dt.setter
    def dt(self, value: float | None) -> None:
        self._given_dt = None if value is None else require_positive("dt", value, "s")
        if self._given_dt is not None:
            self._accept_dt(self._given_dt)
        if self.parent is not None:
            self.parent.__dict__.pop(_CACHE, None)

    def _accept_dt(self, dt: float) -> None:
        """Raise a ``ValueError`` where the transform cannot work with this control step [s]."""

    def _resolved_dt(self, theirs: float | None, lacking: str) -> float:
        """The environment's control step, or the given one if the environment has none."""
        name, given = type(self).__name__, self._given_dt
        if theirs is None:
            if given is None:
                raise ValueError(
                    f"{name} needs the control step, but {lacking}. Pass dt= [s], or give the environment an attribute "
                    "`control_dt` [s]."
                )
            return given
        if given is not None and not math.isclose(given, theirs, rel_tol=_TOLERANCE):
            raise ValueError(
                f"{name} has dt={given} s, but its environment has control_dt={theirs} s; expected the same. Leave dt "
                "out, or correct the environment's `control_dt`."
            )
        self._accept_dt(theirs)
        return theirs

    def _check_dt(self) -> None:
        if self.parent is not None and (self._needs_dt or self._given_dt is not None):
            _ = self.dt

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Check the control step, then transform the spec."""
        self._check_dt()
        return super().transform_input_spec(input_spec)

    def transform_output_spec(self, output_spec: Composite) -> Composite:
        """Check the control step, then transform the spec."""
        self._check_dt()
        return super().transform_output_spec(output_spec)


def control_step(env: EnvBase) -> float | None:
    """The control step of an environment: the attribute ``control_dt`` of its base environment [s].

    Every environment of this library has the attribute; any other may define it. ``TransformedEnv`` is looked through,
    at any depth. ``SerialEnv`` and ``ParallelEnv`` are not, because a worker of the latter dies when it is asked for an
    attribute that it lacks: set ``control_dt`` on the batched environment itself, pass ``dt=`` to the transform, or put
    the transform into the workers.

    Args:
        env: any environment.

    Returns:
        The control step [s]; None if the environment has no such attribute.

    Raises:
        ValueError: if ``control_dt`` is no positive finite number.
    """
    env = base_environment(env)
    value = env.__dict__.get("control_dt") if isinstance(env, BatchedEnvBase) else getattr(env, "control_dt", None)
    return None if value is None else require_positive(f"control_dt of {type(env).__name__}", value, "s")

"""Safety and smoothness metrics of an episode, measured every control step."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs import RandomTruncationTransform, StepCounter, TerminateTransform, Transform

from ppt_rl.functional.argument_checks import require_instance
from ppt_rl.functional.checks import none_true
from ppt_rl.functional.metrics import (
    MEMORY_SIZE,
    METRICS,
    MetricsConfig,
    begin_metrics,
    low_pass,
    summarise_metrics,
    update_metrics,
)
from ppt_rl.transforms.base import Entries
from ppt_rl.transforms.chain import transforms_after
from ppt_rl.transforms.joint_torque import JointTorqueTransform
from ppt_rl.transforms.observer import ObserverTransform
from ppt_rl.transforms.power_limit import PowerLimitTransform
from ppt_rl.transforms.specs import real
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["EpisodeMetricsTransform"]

_MEMORY = "metrics_memory"


class EpisodeMetricsTransform(TimedTransform, ObserverTransform):
    """Measures an episode at control rate and writes ``("metrics", name)``, each ``(*B, 1)``, where it ends.

    ``max_power`` [W] and ``work`` [J] are those of the commanded power, or of the measured one where no ``power`` is
    observed. The others are ``max_power_measured`` [W], ``jerk_rms`` [m/s^3], ``wrench_p95`` [N], ``overload_ratio``
    and ``contact_continuity`` [0-1]; docs/metrics.md defines them. All are zero until ``done``.

    Append this transform after whatever writes ``power`` or ends episodes, such as a :class:`JointTorqueTransform` or
    torchrl's ``StepCounter(max_steps)``, and before a :class:`MacroStepTransform`; another order is refused.

    Args:
        config: thresholds and filter; None takes the defaults.
        dt: control step [s]; None takes it from the environment, and needs one.
        twist_key: measured twist.
        wrench_key: measured wrench on the world.
        power_key: commanded power.

    Raises:
        KeyError: if twist or wrench are not observed.
        ValueError: if the filter's cut-off is not below half the control rate, or a transform after this one writes
            ``power`` or ends episodes, so that this one would miss it.
    """

    _at_control_rate = True
    state_keys = (_MEMORY,)

    def __init__(
        self,
        config: MetricsConfig | None = None,
        *,
        dt: float | None = None,
        twist_key: NestedKey = "twist",
        wrench_key: NestedKey = "wrench",
        power_key: NestedKey = "power",
    ) -> None:
        super().__init__(in_keys=[twist_key, wrench_key], out_keys=[("metrics", name) for name in METRICS])
        self.power_key = power_key
        self.config = MetricsConfig() if config is None else config
        require_instance("config", self.config, MetricsConfig)
        self.dt = dt

    def _check_place(self) -> None:
        super()._check_place()
        if _MEMORY in self.parent.full_observation_spec.keys():
            raise ValueError(
                "the environment has metrics already; expected one EpisodeMetricsTransform. Remove the others."
            )
        missed = [type(other).__name__ for other in transforms_after(self) if _is_missed(other)]
        if missed:
            raise ValueError(
                f"EpisodeMetricsTransform stands before {missed}, so it would miss the power that they write or the "
                "episodes that they end; append it after them."
            )

    def _accept_dt(self, dt: float) -> None:
        low_pass(self.config.cutoff, dt)

    def _read(self, tensordict: TensorDictBase) -> list[Tensor]:
        twist, wrench = super()._read(tensordict)
        power = tensordict.get(self.power_key, None)
        return [twist, wrench, (twist * wrench).sum(-1, keepdim=True) if power is None else power]

    def _begin(self, *readings: Tensor) -> Entries:
        twist, wrench, _ = readings
        return {_MEMORY: begin_metrics(twist, wrench, self.config, dt=self.dt)}

    def _update(self, state: Entries, *readings: Tensor) -> Entries:
        twist, wrench, power = readings
        return {_MEMORY: update_metrics(state[_MEMORY], twist, wrench, power, self.config, dt=self.dt)}

    def _outputs(self, tensordict: TensorDictBase, state: Entries, *readings: Tensor) -> Entries:
        memory, done = state[_MEMORY], tensordict.get("done", None)
        if done is not None and none_true(done):
            values = dict.fromkeys(METRICS, torch.zeros_like(memory[..., :1]))
        else:
            values = summarise_metrics(memory)
            if done is not None:
                values = {name: value * done for name, value in values.items()}
        metrics = tensordict.empty()
        for name, value in values.items():
            metrics.set(name, value)
        return {"metrics": metrics}

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {_MEMORY: real(like, *batch, MEMORY_SIZE)}

    def _output_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {key: real(like, *batch, 1) for key in self.out_keys}


def _is_missed(other: Transform) -> bool:
    """Whether a transform writes what the metrics must see: the commanded power, or the end of an episode."""
    if isinstance(other, StepCounter):
        return other.max_steps is not None
    if isinstance(other, PowerLimitTransform):
        return other.terminate
    return isinstance(other, JointTorqueTransform | RandomTruncationTransform | TerminateTransform)

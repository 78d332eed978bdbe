"""Safety and smoothness metrics of an episode, measured every control step."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded

from ppt_rl.functional.metrics import (
    MEMORY_SIZE,
    METRICS,
    MetricsConfig,
    begin_metrics,
    low_pass,
    summarise_metrics,
    update_metrics,
)
from ppt_rl.transforms.base import StatefulTransform
from ppt_rl.transforms.timed import TimedTransform

__all__ = ["EpisodeMetricsTransform"]

_MEMORY = "metrics_memory"


class EpisodeMetricsTransform(TimedTransform, StatefulTransform):
    """Measures an episode at control rate and writes ``("metrics", name)``, ``(*B, 1)`` each, where it ends.

    Names: ``max_power`` [W] and ``work`` [J] of the commanded power (the measured one where no ``power`` is observed),
    ``max_power_measured`` [W], ``jerk_rms`` [m/s^3], ``wrench_p95`` [N], ``overload_ratio`` and ``contact_continuity``
    [0-1]; docs/metrics.md defines them. They are zero until ``done``. Append it before a :class:`MacroStepTransform`.

    Args:
        config: thresholds and filter; None takes the defaults.
        dt: control step [s]; None takes it from the environment, and needs one.
        twist_key: measured twist.
        wrench_key: measured wrench on the world.
        power_key: commanded power.

    Raises:
        KeyError: if twist or wrench are not observed.
        ValueError: if the filter's cut-off is not below half the control rate.
    """

    def __init__(
        self,
        config: MetricsConfig | None = None,
        *,
        dt: float | None = None,
        twist_key: NestedKey = "twist",
        wrench_key: NestedKey = "wrench",
        power_key: NestedKey = "power",
    ) -> None:
        super().__init__(in_keys=[twist_key, wrench_key, power_key], out_keys=[("metrics", name) for name in METRICS])
        self.config = MetricsConfig() if config is None else config
        self.dt = dt

    def _accept_dt(self, dt: float) -> None:
        low_pass(self.config.cutoff, dt)

    def _readings(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        twist, wrench = (tensordict.get(key, None) for key in self.in_keys[:2])
        if twist is None or wrench is None:
            raise KeyError(
                f"EpisodeMetricsTransform needs {self.in_keys[:2]}; the tensordict holds {sorted(tensordict.keys())}."
            )
        return twist, wrench

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        twist, wrench = self._readings(next_tensordict)
        old = tensordict.get(_MEMORY, None)
        if old is None:
            old = begin_metrics(*self._readings(tensordict), self.config, dt=self.dt)
        power = next_tensordict.get(self.in_keys[2], None)
        if power is None:
            power = (twist * wrench).sum(-1, keepdim=True)
        memory = update_metrics(old, twist, wrench, power, self.config, dt=self.dt)
        step = tensordict.get("_step", None)
        if step is not None:
            memory = torch.where(expand_as_right(step.reshape(tensordict.batch_size), memory), memory, old)
        next_tensordict.set(_MEMORY, memory)
        return self._write(next_tensordict, memory)

    def _write(self, next_tensordict: TensorDictBase, memory: Tensor) -> TensorDictBase:
        done = next_tensordict.get("done", None)
        if done is not None and not bool(done.any()):
            zero = torch.zeros_like(memory[..., :1])
            values = dict.fromkeys(METRICS, zero)
        else:
            values = summarise_metrics(memory)
            if done is not None:
                values = {name: value * done for name, value in values.items()}
        metrics = next_tensordict.empty()
        for name, value in values.items():
            metrics.set(name, value)
        return next_tensordict.set("metrics", metrics)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        memory = begin_metrics(*self._readings(tensordict_reset), self.config, dt=self.dt)
        self._restart(tensordict, tensordict_reset, _MEMORY, memory)
        for key in self.out_keys:
            tensordict_reset.set(key, torch.zeros_like(memory[..., :1]))
        return tensordict_reset

    def _like(self) -> TensorSpec:
        return self.parent.full_observation_spec[self.in_keys[0]]

    def _state_specs(self, batch: torch.Size, like: TensorSpec) -> dict[NestedKey, TensorSpec]:
        return {_MEMORY: Unbounded(shape=(*batch, MEMORY_SIZE), dtype=like.dtype, device=like.device)}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Declare memory and metrics."""
        observation_spec = super().transform_observation_spec(observation_spec)
        like, batch = self._like(), self.parent.batch_size
        observation_spec["metrics"] = Composite(
            {name: Unbounded(shape=(*batch, 1), dtype=like.dtype, device=like.device) for name in METRICS},
            shape=batch,
            device=like.device,
        )
        return observation_spec

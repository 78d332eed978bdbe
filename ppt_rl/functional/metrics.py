"""Metrics of an episode, computed step by step: the same numbers for step-wise and for episode-level policies.

``docs/metrics.md`` defines them. The memory is one packed tensor ``(*B, MEMORY_SIZE)``, so that it takes one entry of a
tensordict.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
from scipy import signal
from torch import Tensor

from ppt_rl.functional.checks import require_last_dim, require_positive
from ppt_rl.functional.constants import constant
from ppt_rl.functional.shape_checks import require_same_batch

__all__ = [
    "MEMORY_SIZE",
    "METRICS",
    "MetricsConfig",
    "begin_metrics",
    "low_pass",
    "summarise_metrics",
    "update_metrics",
]

#: Names of the metrics, in the order of the summary.
METRICS = (
    "max_power", "max_power_measured", "jerk_rms", "wrench_p95", "overload_ratio", "contact_continuity", "work",
)  # fmt: skip

# The memory: sums, maxima, first and last contact, state of the filter, the last two velocities, histogram of force.
_COUNT, _OVERLOAD, _CONTACT, _JERK, _WORK, _POWER, _MEASURED, _FIRST, _LAST = range(9)
_Z1, _Z2, _V1, _V2 = slice(9, 15), slice(15, 21), slice(21, 24), slice(24, 27)
_BINS = 256
_HISTOGRAM = slice(27, 27 + _BINS)
#: Sizes of the parts of the memory: sums, maxima, first and last contact, state of the filter, velocities, histogram.
_PARTS = (5, 2, 1, 1, 6, 6, 3, 3, _BINS)
#: Width of the packed memory.
MEMORY_SIZE = 27 + _BINS
#: First edge of the histogram [N] and its range in decades: 256 logarithmic bins, each 3.7 % wide.
_FLOOR, _DECADES = 0.01, 4.0


@dataclass(frozen=True)
class MetricsConfig:
    """Thresholds and filter of the metrics.

    Attributes:
        p_max: a control step counts as overload above this power [W].
        contact_force: a control step counts as contact above this force [N].
        cutoff: cut-off frequency of the second-order Butterworth low-pass on velocity and force [Hz].
    """

    p_max: float = 2.0
    contact_force: float = 0.05
    cutoff: float = 10.0

    def __post_init__(self) -> None:
        """Refuse impossible numbers."""
        for name, unit in (("p_max", "W"), ("contact_force", "N"), ("cutoff", "Hz")):
            require_positive(name, getattr(self, name), unit)


@lru_cache
def low_pass(cutoff: float, dt: float) -> tuple[float, float, float, float, float]:
    """Coefficients of a second-order Butterworth low-pass.

    Args:
        cutoff: cut-off frequency [Hz], below half the control rate.
        dt: control step [s].

    Returns:
        ``b0, b1, b2, a1, a2`` of the transfer function, with ``a0 = 1``.

    Raises:
        ValueError: if a number is not positive, or the cut-off not below half the control rate.
    """
    require_positive("cutoff", cutoff, "Hz")
    require_positive("dt", dt, "s")
    if cutoff * dt >= 0.5:
        raise ValueError(f"cutoff is {cutoff} Hz; expected a frequency below half the control rate, {0.5 / dt} Hz.")
    b, a = signal.butter(2, cutoff, fs=1.0 / dt)
    return float(b[0]), float(b[1]), float(b[2]), float(a[1]), float(a[2])


def begin_metrics(twist: Tensor, wrench: Tensor, config: MetricsConfig, *, dt: float) -> Tensor:
    """Memory at the start of an episode; the filters are at rest at the first reading.

    Args:
        twist: ``(*B, 6)`` measured twist of the end effector, world axes [m/s, rad/s].
        wrench: ``(*B, 6)`` measured wrench of the robot on the world, same axes [N, N m].
        config: thresholds and filter.
        dt: control step [s].

    Returns:
        ``(*B, MEMORY_SIZE)`` memory.

    Raises:
        ValueError: if a shape does not fit, or ``dt`` is too long for the filter.
    """
    require_last_dim("twist", twist, 6)
    require_last_dim("wrench", wrench, 6)
    require_same_batch(twist=twist, wrench=wrench)
    x = torch.cat([twist[..., :3], wrench[..., :3]], -1)
    b0, _, b2, _, a2 = low_pass(config.cutoff, dt)
    memory = x.new_zeros(*x.shape[:-1], MEMORY_SIZE)
    memory[..., _Z1] = (1 - b0) * x
    memory[..., _Z2] = (b2 - a2) * x
    memory[..., _V1] = memory[..., _V2] = x[..., :3]
    memory[..., _FIRST] = memory[..., _LAST] = -1
    return memory


def update_metrics(
    memory: Tensor, twist: Tensor, wrench: Tensor, power: Tensor, config: MetricsConfig, *, dt: float
) -> Tensor:
    """Memory after one more control step.

    Args:
        memory: ``(*B, MEMORY_SIZE)``.
        twist: ``(*B, 6)`` measured twist of the end effector, world axes [m/s, rad/s].
        wrench: ``(*B, 6)`` measured wrench of the robot on the world, same axes [N, N m].
        power: ``(*B, 1)`` commanded power [W].
        config: thresholds and filter.
        dt: control step [s].

    Returns:
        ``(*B, MEMORY_SIZE)`` new memory; the old one is not changed.

    Raises:
        ValueError: if a shape does not fit, or ``dt`` is too long for the filter.
    """
    for name, value, size in (
        ("memory", memory, MEMORY_SIZE), ("twist", twist, 6), ("wrench", wrench, 6), ("power", power, 1),
    ):  # fmt: skip
        require_last_dim(name, value, size)
    require_same_batch(memory=memory, twist=twist, wrench=wrench, power=power)
    b0, b1, b2, a1, a2 = low_pass(config.cutoff, dt)
    x = torch.cat([twist[..., :3], wrench[..., :3]], -1)
    sums, maxima, first, last, z1, z2, v1, v2, histogram = memory.split_with_sizes(_PARTS, -1)
    y = torch.add(z1, x, alpha=b0)
    z1 = z2.add(x, alpha=b1).add_(y, alpha=-a1)
    z2 = (constant(b2, x) * x).add_(y, alpha=-a2)
    velocity, filtered = y.split_with_sizes((3, 3), -1)
    force = torch.linalg.vector_norm(filtered, dim=-1, keepdim=True)
    jerk = torch.add(velocity, v1, alpha=-2).add_(v2) / constant(dt**2, x)  # [m/s^3]
    measured = (twist * wrench).sum(-1, keepdim=True).abs()  # [W]
    contact = force > constant(config.contact_force, force)
    count = sums[..., :1]
    first = torch.where(contact & (first < constant(0.0, first)), count, first)
    last = torch.where(contact, count, last)
    flags = torch.cat([torch.ones_like(contact), measured > constant(config.p_max, measured), contact], -1).to(x.dtype)
    power = power.abs()  # [W]
    sums = sums + torch.cat([flags, jerk.square_().sum(-1, keepdim=True), constant(dt, power) * power], -1)
    maxima = torch.maximum(maxima, torch.cat([power, measured], -1))
    index = torch.bucketize(force, _bin_edges(force.dtype, force.device), right=True)
    histogram = histogram.scatter_add(-1, index, torch.ones_like(force))
    return torch.cat([sums, maxima, first, last, z1, z2, velocity, v1, histogram], -1)


def summarise_metrics(memory: Tensor) -> dict[str, Tensor]:
    """Metrics of the episode so far.

    Args:
        memory: ``(*B, MEMORY_SIZE)``.

    Returns:
        A tensor ``(*B, 1)`` for each name of :data:`METRICS`: max_power and max_power_measured [W], jerk_rms [m/s^3],
        wrench_p95 [N], overload_ratio and contact_continuity [0-1], work [J].

    Raises:
        ValueError: if the memory has another size.
    """
    require_last_dim("memory", memory, MEMORY_SIZE)
    count = memory[..., _COUNT].clamp_min(1.0)
    cumulative = memory[..., _HISTOGRAM].cumsum(-1)
    below = (cumulative < 0.95 * memory[..., _COUNT : _COUNT + 1]).sum(-1).to(memory.dtype)
    p95 = _FLOOR * 10.0 ** ((below + 0.5) * (_DECADES / _BINS))
    p95 = torch.where(below == 0, torch.zeros_like(p95), p95)
    span = memory[..., _LAST] - memory[..., _FIRST] + 1.0
    touched = memory[..., _FIRST] >= 0
    continuity = torch.where(touched, memory[..., _CONTACT] / span.clamp_min(1.0), torch.zeros_like(span))
    values = {
        "max_power": memory[..., _POWER],
        "max_power_measured": memory[..., _MEASURED],
        "jerk_rms": (memory[..., _JERK] / count).sqrt(),
        "wrench_p95": p95,
        "overload_ratio": memory[..., _OVERLOAD] / count,
        "contact_continuity": continuity,
        "work": memory[..., _WORK],
    }
    return {name: value.unsqueeze(-1) for name, value in values.items()}


@lru_cache
def _bin_edges(dtype: torch.dtype, device: torch.device) -> Tensor:
    """Upper edges of all bins of the histogram but the last [N]."""
    with torch.inference_mode(False):  # cached, so used outside of it too
        edges = _FLOOR * 10.0 ** (torch.arange(1, _BINS, dtype=torch.float64) * (_DECADES / _BINS))
        return edges.to(device, dtype)

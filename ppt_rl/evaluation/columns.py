"""Metrics of the reports with their units."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["COLUMNS", "POWER_AND_WORK", "Column"]


@dataclass(frozen=True)
class Column:
    """A metric in a table.

    Attributes:
        unit: its unit; ``0-1`` for shares.
        is_rate: whether an episode has zero or one: then the mean is a rate of successes, with Wilson's interval.
    """

    unit: str
    is_rate: bool = False


#: Metrics of every task, in order.
COLUMNS = {
    "success": Column("0-1", is_rate=True),
    "max_power": Column("W"),
    "jerk_rms": Column("m/s^3"),
    "wrench_p95": Column("N"),
    "overload_ratio": Column("0-1"),
    "contact_continuity": Column("0-1"),
    "progress": Column("0-1"),
}
#: Power and work of an audited episode with their units: at control rate, then over every physics substep (``audit_``).
POWER_AND_WORK = {
    "max_power": "W",
    "audit_commanded_power": "W",
    "max_power_measured": "W",
    "audit_measured_power": "W",
    "work": "J",
    "audit_commanded_work": "J",
    "work_gap": "-",
    "audit_measured_work": "J",
}

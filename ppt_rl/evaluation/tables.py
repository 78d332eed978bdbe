"""Markdown tables and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppt_rl.evaluation.columns import COLUMNS, POWER_AND_WORK, Column

__all__ = ["as_csv", "from_csv", "markdown", "mean_and_interval", "metrics_table", "power_table", "spread"]


def markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table.

    Args:
        head: titles of the columns.
        lines: cells of each line.

    Returns:
        The table.

    Raises:
        ValueError: if a line has another number of cells than the head.
    """
    for index, line in enumerate(lines):
        if len(line) != len(head):
            raise ValueError(f"line {index} has {len(line)} cells; expected {len(head)}, as many as the head.")
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def mean_and_interval(summary: Mapping[str, Any], sign: str = "") -> str:
    """A mean with its 95 % interval.

    Args:
        summary: ``mean`` and ``ci95`` (``[low, high]`` or None).
        sign: ``"+"`` prints the sign of positive numbers too.

    Returns:
        ``0.953 (0.940, 0.966)``.
    """
    mean = f"{summary['mean']:{sign}.3f}"
    interval = summary["ci95"]
    return mean if interval is None else f"{mean} ({interval[0]:{sign}.3f}, {interval[1]:{sign}.3f})"


def spread(values: Mapping[str, float]) -> str:
    """Mean, 95th percentile and maximum.

    Args:
        values: ``mean``, ``p95`` and ``max``.

    Returns:
        ``0.660 / 1.203 / 1.871``.
    """
    return f"{values['mean']:.3f} / {values['p95']:.3f} / {values['max']:.3f}"


def metrics_table(summaries: Mapping[str, Mapping[str, Any]], columns: Mapping[str, Column] = COLUMNS) -> str:
    """Means and intervals, a line per metric and a column per actor.

    Args:
        summaries: by actor, what :func:`~ppt_rl.evaluation.statistics.summarise` returned.
        columns: metrics in order.

    Returns:
        The table.
    """
    lines = [
        [f"{metric} [{column.unit}]", *(mean_and_interval(summary[metric]) for summary in summaries.values())]
        for metric, column in columns.items()
    ]
    return markdown(["mean (95 % interval)", *summaries], lines)


def power_table(audits: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """Power and work, a line per quantity and a column per actor.

    Args:
        audits: by actor, what :func:`~ppt_rl.evaluation.statistics.distribution` returned.

    Returns:
        The table.
    """
    lines = [
        [f"{name} [{unit}]", *(spread(audit[name]) for audit in audits.values())]
        for name, unit in POWER_AND_WORK.items()
    ]
    return markdown(["mean / P95 / max over episodes", *audits], lines)


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV text.

    Args:
        rows: at least one; all with the same keys.

    Returns:
        The text, with a line of names first.

    Raises:
        ValueError: if there is no row, or the rows differ in their keys.
    """
    if not rows:
        raise ValueError("rows are empty; expected at least one.")
    for index, row in enumerate(rows):
        if row.keys() != rows[0].keys():
            raise ValueError(f"row {index} has the keys {list(row)}; expected {list(rows[0])}, as in the first row.")
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def from_csv(text: str) -> dict[str, NDArray[np.float64]]:
    """Columns of numbers from CSV text.

    Args:
        text: what :func:`as_csv` returned.

    Returns:
        Arrays by name.

    Raises:
        ValueError: if there is no line of names, or a line is torn or holds something else than numbers.
    """
    names, *rows = list(csv.reader(io.StringIO(text))) or [[]]
    if not names:
        raise ValueError("the text is empty; expected a line of names, then lines of numbers.")
    for number, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise ValueError(f"line {number} has {len(row)} cells; expected {len(names)}, one for each name.")
    data = np.asarray([_floats(row, number) for number, row in enumerate(rows, start=2)]).reshape(-1, len(names))
    return {name: data[:, index] for index, name in enumerate(names)}


def _floats(row: Sequence[str], number: int) -> list[float]:
    try:
        return [float(cell) for cell in row]
    except ValueError as error:
        raise ValueError(f"{row} in line {number} are no numbers; expected numbers in every cell.") from error

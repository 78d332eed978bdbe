"""Live plots of power, tank level and force."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from ppt_rl.view.episodes import Reading

__all__ = ["LivePlots"]

#: How much of the past the plots show [s].
_SPAN = 6.0


class LivePlots:
    """Three plots over the last six seconds; those of power and tank with their limits.

    Args:
        gui: the ``gui`` of a ``viser.ViserServer``.
        dt: control step [s].
        has_tank: whether there is a tank.
    """

    def __init__(self, gui: Any, *, dt: float, has_tank: bool) -> None:
        self._readings: deque[tuple[float, float, float, float]] = deque(maxlen=round(_SPAN / dt))
        self._limits = {"power": float("nan"), "tank_energy": float("nan")}
        self._plots: dict[str, Any] = {}
        blank = np.zeros(1)
        for name, label, colour, limited in (
            ("power", "power [W]", "#1f77d0", has_tank),
            ("tank_energy", "tank level [J]", "#2a9d4a", has_tank),
            ("force", "force [N]", "#d9701a", False),
        ):
            if name == "tank_energy" and not has_tank:
                continue
            series: list[Any] = [{"label": "time [s]"}, {"label": label, "stroke": colour, "width": 2}]
            if limited:
                series.append({"label": "limit", "stroke": "#555555", "width": 1, "dash": [6, 4]})
            self._plots[name] = gui.add_uplot(
                data=(blank,) * len(series),
                series=tuple(series),
                title=label,
                scales={"x": {"time": False, "auto": True}, "y": {"auto": True}},
                legend={"show": False},
                height=120,
            )

    def limits(self, *, p_max: float, e_max: float) -> None:
        """Set the limits that are drawn from now on.

        Args:
            p_max: power limit [W].
            e_max: capacity of the tank [J].
        """
        self._limits = {"power": p_max, "tank_energy": e_max}

    def add(self, reading: Reading) -> None:
        """Remember a reading; :meth:`draw` shows it.

        Args:
            reading: the reading.
        """
        self._readings.append((reading.time, reading.power, reading.tank_energy, reading.force))

    def draw(self) -> None:
        """Show what was remembered."""
        if not self._readings:
            return
        time, power, tank, force = np.asarray(self._readings).T
        for name, values in (("power", power), ("tank_energy", tank), ("force", force)):
            plot = self._plots.get(name)
            if plot is not None:
                limit = [np.full_like(time, self._limits[name])] if len(plot.data) == 3 else []
                plot.data = (time, np.nan_to_num(values), *limit)

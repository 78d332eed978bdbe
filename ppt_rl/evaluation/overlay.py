"""What is written over the frames of a film: time, outcome, and bars of power, tank level and force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

__all__ = ["Gauge", "Overlay", "gauges_of"]

Picture = NDArray[np.uint8]
_BLUE, _ORANGE, _GREEN, _RED, _WHITE, _SHADE = "#3d9be0", "#f0913d", "#4fc06b", "#e0564b", "#ffffff", (18, 24, 32, 175)
#: Height of a picture at which text has its nominal size, that size, and the width of what is written [pixels].
_HEIGHT, _TEXT, _WIDTH = 480, 17, 256
#: Smallest force at the end of its bar [N].
_LEAST_FORCE = 1.0


@dataclass(frozen=True)
class Gauge:
    """A bar of one quantity over an episode.

    Attributes:
        label: name of the quantity.
        unit: its unit.
        values: ``(T,)`` values by control step; the bar shows their size, the text their sign as well.
        full: value at which the bar is full.
        colour: of the bar.
        limit: whether ``full`` is a limit, which the text then names.
    """

    label: str
    unit: str
    values: NDArray[np.float64]
    full: float
    colour: str
    limit: bool = True


def gauges_of(
    trace: Mapping[str, NDArray[np.float64]], *, p_max: float | None, e_max: float | None, top_force: float
) -> list[Gauge]:
    """The gauges of a recorded episode: those of power, tank level and force of which there is a record.

    Args:
        trace: arrays over control steps: ``power`` (T, 1) [W], ``tank_energy`` (T, 1) [J], ``wrench`` (T, 6) [N, N m].
        p_max: power limit [W]; None where nothing limits it.
        e_max: capacity of the tank [J]; None where there is none.
        top_force: force at which the bar is full [N].

    Returns:
        The gauges, from top to bottom.
    """
    gauges = []
    if "power" in trace:
        power = trace["power"][:, 0]
        full = p_max if p_max is not None else max(1.0, float(np.abs(power).max()))
        gauges.append(Gauge("power", "W", power, full, _BLUE, p_max is not None))
    if "tank_energy" in trace and e_max is not None:
        gauges.append(Gauge("tank", "J", trace["tank_energy"][:, 0], e_max, _GREEN))
    if "wrench" in trace:
        force = np.linalg.norm(trace["wrench"][:, :3], axis=-1)
        gauges.append(Gauge("force", "N", force, max(top_force, _LEAST_FORCE), _ORANGE, False))
    return gauges


@dataclass(frozen=True)
class Overlay:
    """Writes over the pictures of one episode.

    Attributes:
        gauges: bars, from top to bottom.
        dt: control step [s].
        outcome: what is said at the end, and whether it is good news; None says nothing.
    """

    gauges: Sequence[Gauge]
    dt: float
    outcome: tuple[str, bool] | None = None

    def on(self, picture: Picture, step: int, *, last: bool = False) -> Picture:
        """A picture with time and gauges in its upper right corner.

        Args:
            picture: ``(height, width, 3)`` RGB image, which is left as it is.
            step: control step that it shows, from 0.
            last: whether the episode has ended, so that the outcome is said.

        Returns:
            ``(height, width, 3)`` RGB image.
        """
        image = Image.fromarray(picture).convert("RGB")
        unit = max(0.5, image.height / _HEIGHT)
        font, row, rim = _font(round(_TEXT * unit)), round(27 * unit), 6 * unit
        left, top = image.width - round(_WIDTH * unit), 2 * rim
        draw = ImageDraw.Draw(image, "RGBA")
        box = (left - rim, rim, image.width - rim, top + row * (1 + len(self.gauges)))
        draw.rounded_rectangle(box, rim, fill=_SHADE)
        draw.text((left, top), f"t = {(step + 1) * self.dt:.2f} s", font=font, fill=_WHITE)
        if last and self.outcome is not None:
            text, good = self.outcome
            draw.text((left + 144 * unit, top), text, font=font, fill=_GREEN if good else _RED)
        for number, gauge in enumerate(self.gauges, start=1):
            self._bar(draw, gauge, float(gauge.values[step]), left, top + number * row, unit, font)
        return np.asarray(image)

    @staticmethod
    def _bar(
        draw: ImageDraw.ImageDraw, gauge: Gauge, value: float, left: float, top: float, unit: float,
        font: ImageFont.FreeTypeFont,
    ) -> None:  # fmt: skip
        draw.text((left, top), gauge.label, font=font, fill=_WHITE)
        begin, width, height = left + 58 * unit, 78 * unit, 14 * unit
        box = (begin, top + 4 * unit, begin + width, top + 4 * unit + height)
        draw.rectangle(box, outline=_WHITE)
        filled = width * min(1.0, abs(value) / gauge.full)
        if filled >= 2:
            draw.rectangle((box[0] + 1, box[1] + 1, box[0] + filled - 1, box[3] - 1), fill=gauge.colour)
        limit = f" / {gauge.full:g}" if gauge.limit else ""
        draw.text((begin + width + 8 * unit, top), f"{value:.2f}{limit} {gauge.unit}", font=font, fill=_WHITE)


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings along."""
    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)

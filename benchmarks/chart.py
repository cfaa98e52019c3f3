"""Line charts for people: panels under each other over one axis of time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from wcsim.errors import ConfigError
from wcsim.types import F64, U8

INK_RGB = (40, 44, 50)
_GRID_RGB = (226, 229, 233)
_COLOURS_RGB = ((31, 84, 176), (220, 110, 20), (20, 140, 80), (170, 40, 120), (110, 110, 110))
LEFT_PX, _RIGHT_PX, TOP_PX, BOTTOM_PX = 64, 12, 22, 20
TICKS = 4  # about so many lines of the grid in a panel
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT = 4  # fractional bits of OpenCV's coordinates


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One curve."""

    label: str
    x: F64  # (n,)
    y: F64  # (n,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Curves with one scale."""

    title: str
    lines: tuple[Line, ...]


def chart(panels: Sequence[Panel], x_label: str, width_px: int = 960, panel_px: int = 170) -> U8:
    """Panels under each other, (H, W, 3) uint8; later lines are drawn over earlier ones.

    Raises:
        ConfigError: There is nothing to draw, or a number is not finite.
    """
    numbers = [axis for panel in panels for line in panel.lines for axis in (line.x, line.y)]
    if not numbers or any(len(axis) == 0 or not np.isfinite(axis).all() for axis in numbers):
        raise ConfigError("a chart got no lines, or numbers that are not finite; expected some, all finite")
    low = min(float(line.x.min()) for panel in panels for line in panel.lines)
    high = max(float(line.x.max()) for panel in panels for line in panel.lines)
    out = [_panel(panel, low, max(high, low + 1e-9), width_px, panel_px) for panel in panels]
    foot = np.full((18, width_px, 3), 255, np.uint8)
    _write(foot, x_label, (width_px // 2 - 4 * len(x_label), 12), INK_RGB)
    return np.vstack([*out, foot])


def steps(low: float, high: float) -> list[float]:
    """Round numbers between two bounds for the lines of a grid.

    >>> steps(-0.2, 10.3)
    [0.0, 2.5, 5.0, 7.5, 10.0]
    """
    rough = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * k for k in (1.0, 2.0, 2.5, 5.0, 10.0) if power * k >= 0.9 * rough)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]


def _panel(panel: Panel, left: float, right: float, width_px: int, height_px: int) -> U8:
    image = np.full((height_px, width_px, 3), 255, np.uint8)
    values = np.concatenate([line.y for line in panel.lines])
    span = max(float(np.ptp(values)), 1e-6)
    bottom, top = float(values.min()) - 0.06 * span, float(values.max()) + 0.06 * span
    across, up = width_px - LEFT_PX - _RIGHT_PX, height_px - TOP_PX - BOTTOM_PX

    def place(x: F64, y: F64) -> F64:
        return np.stack(
            [LEFT_PX + (x - left) / (right - left) * across, TOP_PX + (top - y) / (top - bottom) * up], axis=-1
        )

    for x in steps(left, right):
        (at, _) = place(np.array(x), np.array(top))
        cv2.line(image, (round(at), TOP_PX), (round(at), TOP_PX + up), _GRID_RGB, 1)
        _write(image, f"{x:g}", (round(at) - 8, height_px - 6), INK_RGB)
    for y in steps(bottom, top):
        (_, at) = place(np.array(left), np.array(y))
        cv2.line(image, (LEFT_PX, round(at)), (width_px - _RIGHT_PX, round(at)), _GRID_RGB, 1)
        _write(image, f"{y:g}", (6, round(at) + 4), INK_RGB)
    for number, line in enumerate(panel.lines):
        colour = _COLOURS_RGB[number % len(_COLOURS_RGB)]
        points = np.rint(place(line.x, line.y) * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(image, [points], False, colour, 1, cv2.LINE_AA, _SHIFT)
    _legend(image, panel)
    return image


def _legend(image: U8, panel: Panel) -> None:
    _write(image, panel.title, (LEFT_PX, 15), INK_RGB)
    x = LEFT_PX + 8 * len(panel.title) + 24
    for number, line in enumerate(panel.lines):
        colour = _COLOURS_RGB[number % len(_COLOURS_RGB)]
        cv2.line(image, (x, 11), (x + 18, 11), colour, 2)
        _write(image, line.label, (x + 24, 15), colour)
        x += 24 + 8 * len(line.label) + 18


def _write(image: U8, text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
    cv2.putText(image, text, at, _FONT, 0.42, colour, 1, cv2.LINE_AA)

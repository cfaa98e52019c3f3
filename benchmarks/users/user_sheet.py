"""One sheet with the joysticks of all users: what each wanted, and what its hand made of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from benchmarks.users.hand_habits import HandLog
from wcsim.errors import ConfigError
from wcsim.types import F64, U8

_WIDTH_PX, _HEIGHT_PX = 700, 150
LEFT_PX, _GAP_PX, TOP_PX, BOTTOM_PX = 120, 30, 46, 34
_PAPER, _LINES, _INK = (255, 255, 255), (225, 225, 225), (60, 60, 60)
_STICK, _INTENT = (40, 40, 40), (0, 120, 235)  # BGR
_SHIFT = 4  # fractional bits of OpenCV's coordinates


def user_sheet(hands: Mapping[str, HandLog], seconds: float) -> U8:
    """A picture (H, W, 3), blue first: a row for each user, x to the left and y to the right, over `seconds`."""
    rows = len(hands)
    width = LEFT_PX + 2 * (_WIDTH_PX + _GAP_PX)
    sheet = np.full((TOP_PX + rows * (_HEIGHT_PX + _GAP_PX) + BOTTOM_PX, width, 3), _PAPER, np.uint8)
    _text(sheet, "stick (dark) and clean intent (orange): x, right", (LEFT_PX, 28))
    _text(sheet, "y, forward", (LEFT_PX + _WIDTH_PX + _GAP_PX, 28))
    for row, (name, hand) in enumerate(hands.items()):
        top = TOP_PX + row * (_HEIGHT_PX + _GAP_PX)
        _text(sheet, name, (8, top + _HEIGHT_PX // 2))
        ticks, steps = hand.sticks.shape[:2]
        for axis in (0, 1):
            corner = (LEFT_PX + axis * (_WIDTH_PX + _GAP_PX), top)
            _frame(sheet, corner, seconds)
            wanted = np.repeat(hand.intents[:, axis], steps)
            times_s = hand.dt_s * np.arange(1, ticks * steps + 1)
            _curve(sheet, corner, times_s / seconds, wanted, _INTENT)
            _curve(sheet, corner, times_s / seconds, hand.flat[:, axis], _STICK)
    return sheet


def write_sheet(path: Path, hands: Mapping[str, HandLog], seconds: float) -> None:
    """Write the sheet as PNG. Raises ConfigError when the place cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(".png", user_sheet(hands, seconds))
        if done:
            path.write_bytes(data.tobytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); choose another place") from None


def _frame(sheet: U8, corner: tuple[int, int], seconds: float) -> None:
    left, top = corner
    for value in (-1.0, -0.5, 0.0, 0.5, 1.0):
        y = _row(top, value)
        cv2.line(sheet, (left, y), (left + _WIDTH_PX, y), _LINES, 1)
        if value in (-1.0, 0.0, 1.0):
            _text(sheet, f"{value:g}", (left - 24, y + 4), 0.38)
    for second in range(0, round(seconds) + 1, 5):
        x = left + round(_WIDTH_PX * second / seconds)
        cv2.line(sheet, (x, top), (x, top + _HEIGHT_PX), _LINES, 1)
        _text(sheet, f"{second} s", (x - 8, top + _HEIGHT_PX + 14), 0.36)


def _curve(sheet: U8, corner: tuple[int, int], share: F64, values: F64, colour: tuple[int, int, int]) -> None:
    seen = share <= 1.0
    x = corner[0] + _WIDTH_PX * share[seen]
    y = corner[1] + 0.5 * _HEIGHT_PX * (1.0 - values[seen])
    points = np.rint(np.stack([x, y], axis=1) * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(sheet, [points], False, colour, 1, cv2.LINE_AA, _SHIFT)


def _row(top: int, value: float) -> int:
    return top + round(0.5 * _HEIGHT_PX * (1.0 - value))


def _text(sheet: U8, text: str, at: tuple[int, int], scale: float = 0.5) -> None:
    cv2.putText(sheet, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, 1, cv2.LINE_AA)

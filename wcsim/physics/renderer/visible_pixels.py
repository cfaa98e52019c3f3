"""How much of each actor a picture of instances shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from wcsim.core.jit import kernel
from wcsim.types import I32

_STATED_PX = 320 * 240
"""The picture for which numbers of pixels are stated; in one of another size they are scaled by its share of this."""


@kernel
def _count(instance: I32, counts: npt.NDArray[np.int64]) -> None:
    for row in range(instance.shape[0]):
        for i in instance[row]:
            if 0 <= i < len(counts):
                counts[i] += 1


def shown_px(instance: I32, names: Sequence[str]) -> dict[str, float]:
    """Pixels of each actor that is in the picture, by its name, as they would be in one of 320x240.

    Args:
        instance: (H, W) int32, the row of the instance that each pixel shows, -1 where it shows none.
        names: of the actors in the first rows, not necessarily different ones: those of one name are added up. The
            rows behind them are nobody's.
    """
    counts = np.zeros(len(names), np.int64)
    _count(instance, counts)
    scale = _STATED_PX / instance.size
    shown: dict[str, float] = {}
    for i in np.flatnonzero(counts).tolist():
        shown[names[i]] = shown.get(names[i], 0.0) + scale * float(counts[i])
    return shown

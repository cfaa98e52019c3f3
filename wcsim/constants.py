"""Numbers of the physical world that several layers share, each in this one place with its reason."""

from __future__ import annotations

from typing import Final

KERB_STEP_CM: Final = 5
"""What a wheel takes up or down, in the whole centimetres of the street's raster; a higher step is a kerb.

A chair of `plants/` climbs 4 to 5 cm and is stopped by less than a kerb of 12 cm (`wcsim bench chair`).
"""
KERB_STEP_M: Final = 0.01 * KERB_STEP_CM

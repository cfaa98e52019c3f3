"""Numbers of the physical world, and a word, that several layers share; each with its reason."""

from typing import Final

KERB_STEP_CM: Final = 5
"""The highest step that a wheel takes, in whole centimetres of the street's raster.

The chairs of `plants/` climb it with a run-up, and are stopped by less than a kerb of 12 cm (`wcsim
chair check`).
"""
KERB_STEP_M: Final = 0.01 * KERB_STEP_CM
"""A kerb that is no higher counts as lowered: the chair takes it, and may come close to it."""

OTHER_LEVEL_M: Final = 2.5
"""What is so much higher or lower than a chair is on a bridge or in a tunnel.

It is less than the headroom of any.
"""

GRAVITY_MPS2: Final = 9.81

SIDESTEP_MPS: Final = 0.8
"""People step aside for a wheelchair, and back, no faster than this; the oracle relies on it."""

RECORDED: Final = "recorded:"
"""Prefix of the file of a recorded joystick, in place of the name of a user's profile."""

"""The colours of the shaded picture: the paint of every surface of street and actors (RGB only)."""

from enum import IntEnum
from pathlib import Path

import numpy as np

from wcsim.core.reading import read_module_toml
from wcsim.types import F32, F64, ClassId, Mark

VARIANTS = 16  # colours a paint can take; a power of two, as the rasteriser masks the seed with it
_SUN_W = -0.42, -0.55, 0.72
SUN_W = np.array(_SUN_W) / np.linalg.norm(_SUN_W)  # unit vector towards the sun
AMBIENT = 0.60
DIFFUSE = 0.46
HORIZON_RGB = np.array([214.0, 225.0, 234.0])
ZENITH_RGB = np.array([112.0, 160.0, 214.0])
MARK_CLASS = 200  # and on: classes of marks
STONE_CLASS = 210  # and on, in the order of STONES_M: classes of the stones of kerbs
STONES_M = (0.015, 0.05, 0.08)  # a stone of each colour is at least so high; lower ones have none
_COLOURS = read_module_toml(Path(__file__).with_name("colours"))
WALL_RGB, ROOF_RGB, LEAF_RGB, TRUNK_RGB = (
    _COLOURS["things"][name] for name in ("walls", "roofs", "leaves", "trunks")
)


class Paint(IntEnum):
    """What a face of an actor is made of; some paints differ from actor to actor."""

    BODY = 0
    GLASS = 1
    TYRE = 2
    HEADLIGHT = 3
    TAILLIGHT = 4
    METAL = 5
    SKIN = 6
    SHIRT = 7
    TROUSERS = 8
    HAIR = 9
    SHOE = 10
    DARK = 11
    CARGO = 12
    BUS = 13
    TRAM = 14
    TAXI = 15
    WHITE = 16
    BLUE = 17
    RED = 18
    LEFT_LAMP = 19
    RIGHT_LAMP = 20
    UNLIT = 21
    # From here on a face shines: it has no shade.
    BRAKING = 22  # a TAILLIGHT while its driver brakes
    TURNING = 23  # a lamp of the side that its driver turns to
    RED_LIGHT = 24
    AMBER_LIGHT = 25
    GREEN_LIGHT = 26
    BLUE_LIGHT = 27


def paint_table() -> F32:
    """Colours (paints, VARIANTS, 3) float32 in 0..255."""
    # Fewer colours than variants repeat, so that every number that is drawn has one.
    rows = [np.resize(_COLOURS["paints"][paint.name], (VARIANTS, 3)) for paint in Paint]
    return np.array(rows, np.float32)


def class_paint_table() -> F64:
    """Plain colour (256, 3) in 0..255 of a standing surface, by class id; grey without one."""
    table = np.full((256, 3), 150.0)
    for name, colour in _COLOURS["ground"].items():
        table[ClassId[name]] = colour
    for number, colour in enumerate(_COLOURS["stones"].values()):
        table[STONE_CLASS + number] = colour
    for name, colour in _COLOURS["marks"].items():
        table[MARK_CLASS + Mark[name]] = colour
    return table

"""The colours of the shaded picture: what every surface of the street and of an actor is painted with (RGB only)."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wcsim.types import F32, F64, ClassId, Mark

VARIANTS = 16  # colours a paint can take; a power of two, the rasteriser masks the seed with it

SUN_W = np.array([-0.42, -0.55, 0.72]) / np.linalg.norm([-0.42, -0.55, 0.72])  # unit vector towards the sun
AMBIENT = 0.60
DIFFUSE = 0.46

HORIZON_RGB = np.array([214.0, 225.0, 234.0])
ZENITH_RGB = np.array([112.0, 160.0, 214.0])


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


_GROUND_RGB: tuple[tuple[ClassId, tuple[int, int, int]], ...] = (
    (ClassId.ROAD, (104, 105, 110)),
    (ClassId.CROSSWALK, (108, 109, 113)),
    (ClassId.SIDEWALK, (178, 172, 164)),
    (ClassId.KERB, (206, 203, 197)),
    (ClassId.LOWERED_KERB, (194, 189, 180)),
    (ClassId.PARKING, (132, 130, 130)),
    (ClassId.RAIL_TRACK, (122, 112, 104)),
    (ClassId.GROUND, (160, 152, 138)),
    (ClassId.TERRAIN, (134, 160, 98)),
    (ClassId.VEGETATION, (86, 132, 66)),
    (ClassId.BUILDING, (190, 170, 150)),
    (ClassId.WALL, (168, 160, 150)),
    (ClassId.FENCE, (132, 112, 92)),
    (ClassId.POLE, (112, 118, 122)),
    (ClassId.TRAFFIC_LIGHT, (70, 74, 70)),
    (ClassId.TRAFFIC_SIGN, (205, 190, 60)),
    (ClassId.STATIC, (150, 128, 104)),
    (ClassId.DYNAMIC, (124, 96, 128)),
)

MARK_CLASS = 200  # and on: what marks have in place of a class
_MARK_RGB = ((Mark.LINE, (224, 226, 222)), (Mark.CYCLE_LANE, (138, 92, 82)))

TRUNK_RGB = (112, 86, 62)

BUILDING_RGB = (
    (196, 120, 92), (214, 190, 152), (182, 104, 84), (226, 210, 178), (204, 164, 118), (170, 126, 104),
    (222, 198, 166), (188, 178, 160), (210, 144, 110), (232, 222, 202), (160, 112, 94), (202, 186, 142),
    (216, 172, 134), (176, 160, 146), (198, 136, 104), (224, 206, 160),
)  # fmt: skip
ROOF_RGB = ((124, 92, 82), (108, 106, 108), (146, 98, 78), (92, 98, 104))
LEAF_RGB = ((86, 134, 66), (98, 144, 70), (76, 122, 62), (110, 150, 78), (92, 128, 58), (80, 132, 80))

_BODIES = (
    (196, 38, 40), (236, 236, 236), (36, 38, 44), (52, 92, 168), (168, 172, 178), (28, 60, 112), (222, 222, 216),
    (110, 116, 124), (62, 110, 84), (210, 180, 60), (120, 36, 40), (84, 88, 94), (190, 196, 202), (44, 46, 50),
    (214, 110, 50), (70, 130, 170),
)  # fmt: skip
_SKINS = ((236, 196, 168), (224, 178, 146), (196, 146, 112), (158, 108, 78), (112, 76, 56), (84, 58, 44))
_SHIRTS = (
    (202, 62, 58), (64, 104, 176), (236, 228, 210), (72, 132, 96), (226, 170, 60), (94, 72, 130), (60, 64, 72),
    (224, 124, 70), (110, 170, 190), (180, 92, 124), (140, 150, 90), (214, 214, 218), (48, 78, 110), (160, 60, 50),
    (120, 120, 128), (238, 200, 110),
)  # fmt: skip
_TROUSERS = ((46, 56, 86), (62, 62, 66), (104, 92, 76), (38, 38, 42), (84, 98, 124), (140, 126, 102), (70, 60, 56))
_HAIRS = ((46, 36, 30), (92, 64, 40), (28, 26, 26), (168, 130, 80), (120, 112, 108), (140, 76, 44))
_SHOES = ((40, 38, 38), (90, 62, 44), (222, 220, 216), (60, 66, 80))
_CARGOS = ((236, 234, 226), (206, 210, 214), (72, 110, 160), (228, 188, 70), (178, 64, 56), (98, 146, 100))
_BUSES = ((206, 60, 52), (44, 104, 172), (236, 190, 60), (60, 140, 110), (232, 232, 228))
_TRAMS = ((58, 128, 84), (228, 214, 160), (188, 52, 50), (60, 108, 168))


def paint_table() -> F32:
    """Colours (paints, VARIANTS, 3) float32 in 0..255."""
    choices: dict[Paint, tuple[tuple[int, int, int], ...]] = {
        Paint.BODY: _BODIES,
        Paint.GLASS: ((58, 72, 84),),
        Paint.TYRE: ((36, 36, 38),),
        Paint.HEADLIGHT: ((250, 246, 226),),
        Paint.TAILLIGHT: ((190, 30, 34),),
        Paint.METAL: ((138, 142, 148),),
        Paint.SKIN: _SKINS,
        Paint.SHIRT: _SHIRTS,
        Paint.TROUSERS: _TROUSERS,
        Paint.HAIR: _HAIRS,
        Paint.SHOE: _SHOES,
        Paint.DARK: ((52, 54, 60),),
        Paint.CARGO: _CARGOS,
        Paint.BUS: _BUSES,
        Paint.TRAM: _TRAMS,
        Paint.TAXI: ((242, 196, 30),),
        Paint.WHITE: ((238, 238, 236),),
        Paint.BLUE: ((34, 66, 150),),
        Paint.RED: ((202, 40, 36),),
        Paint.LEFT_LAMP: ((176, 104, 40),),
        Paint.RIGHT_LAMP: ((176, 104, 40),),
        Paint.UNLIT: ((34, 36, 38),),
        Paint.BRAKING: ((255, 40, 32),),
        Paint.TURNING: ((255, 170, 20),),
        Paint.RED_LIGHT: ((255, 36, 30),),
        Paint.AMBER_LIGHT: ((255, 184, 20),),
        Paint.GREEN_LIGHT: ((30, 230, 110),),
        Paint.BLUE_LIGHT: ((60, 120, 255),),
    }
    table = np.zeros((len(Paint), VARIANTS, 3), np.float32)
    for paint, colours in choices.items():
        for variant in range(VARIANTS):
            # Round and round: fewer colours than variants repeat, so every number that is drawn has one.
            table[paint, variant] = colours[variant % len(colours)]
    return table


def class_paint_table() -> F64:
    """Plain colour (256, 3) in 0..255 of a standing surface, by class id; grey for a class without one."""
    table = np.full((256, 3), 150.0)
    for class_id, colour in _GROUND_RGB:
        table[class_id] = colour
    for mark, colour in _MARK_RGB:
        table[MARK_CLASS + mark] = colour
    return table

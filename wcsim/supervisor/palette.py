"""Colours of the pixel classes, and how wcsim's own classes fold into those of Cityscapes."""

from typing import Final

import numpy as np

from wcsim.types import U8, ClassId

COLOURS: Final[dict[ClassId, tuple[int, int, int]]] = {
    ClassId.VOID: (0, 0, 0),
    ClassId.STATIC: (0, 0, 0),
    ClassId.DYNAMIC: (111, 74, 0),
    ClassId.GROUND: (81, 0, 81),
    ClassId.ROAD: (128, 64, 128),
    ClassId.SIDEWALK: (244, 35, 232),
    ClassId.PARKING: (250, 170, 160),
    ClassId.RAIL_TRACK: (230, 150, 140),
    ClassId.BUILDING: (70, 70, 70),
    ClassId.WALL: (102, 102, 156),
    ClassId.FENCE: (190, 153, 153),
    ClassId.POLE: (153, 153, 153),
    ClassId.TRAFFIC_LIGHT: (250, 170, 30),
    ClassId.TRAFFIC_SIGN: (220, 220, 0),
    ClassId.VEGETATION: (107, 142, 35),
    ClassId.TERRAIN: (152, 251, 152),
    ClassId.SKY: (70, 130, 180),
    ClassId.PERSON: (220, 20, 60),
    ClassId.RIDER: (255, 0, 0),
    ClassId.CAR: (0, 0, 142),
    ClassId.TRUCK: (0, 0, 70),
    ClassId.BUS: (0, 60, 100),
    ClassId.TRAIN: (0, 80, 100),
    ClassId.MOTORCYCLE: (0, 0, 230),
    ClassId.BICYCLE: (119, 11, 32),
    ClassId.KERB: (255, 255, 255),
    ClassId.LOWERED_KERB: (255, 200, 90),
    ClassId.CROSSWALK: (200, 128, 200),
}


def make_class_palette() -> U8:
    """Table (256, 3) uint8 from class id to red, green, blue; ids without a class are black.

    >>> make_class_palette()[ClassId.ROAD].tolist()
    [128, 64, 128]
    """
    table = np.zeros((256, 3), np.uint8)
    for class_id, colour in COLOURS.items():
        table[class_id] = colour
    return table


def make_cityscapes_class_table() -> U8:
    """Table (256,) uint8 that folds wcsim's own classes: kerbs to sidewalk, crosswalk to road.

    >>> int(make_cityscapes_class_table()[ClassId.CROSSWALK]) == ClassId.ROAD
    True
    """
    table = np.arange(256, dtype=np.uint8)
    table[ClassId.KERB] = ClassId.SIDEWALK
    table[ClassId.LOWERED_KERB] = ClassId.SIDEWALK
    table[ClassId.CROSSWALK] = ClassId.ROAD
    return table

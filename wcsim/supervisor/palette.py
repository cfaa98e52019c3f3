"""Colours of the pixel classes, and how wcsim's own classes fold into those of Cityscapes."""

from typing import Final

import numpy as np

from wcsim.core.reading import read_module_toml
from wcsim.types import U8, ClassId

COLOURS: Final[dict[ClassId, tuple[int, int, int]]] = {
    ClassId[name]: tuple(colour) for name, colour in read_module_toml(__file__).items()
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

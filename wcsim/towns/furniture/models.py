"""What each kind of street furniture looks like, in a frame of its own: x along its long side, y its front, z up.

Height 0 is the ground; whatever stands on it reaches a little deeper, because ground falls at crossings and on hills.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.types import ClassId

FOOT_M = -0.25  # how deep things reach into the ground

Make = Callable[[np.random.Generator], list[Solid]]
_HERE = np.zeros(2)


@dataclass(frozen=True, slots=True, kw_only=True)
class _FurnitureModel:
    """How one kind of thing is made."""

    size_lwh_m: tuple[float, float, float]  # as it is made; its length and width are its footprint
    pieces: list[Solid] = field(default_factory=list)
    make: Make | None = None  # instead, where no two are alike
    round: bool = False  # takes a disc of the ground, not a rectangle


def _box(
    size: tuple[float, float, float],
    class_id: int = ClassId.STATIC,
    at: tuple[float, float] = (0.0, 0.0),
    low_m: float | None = None,
) -> Solid:
    """A box on the ground, or with a floor when it hangs at `low_m`."""
    if low_m is None:
        return solid_shapes.box(np.array(at), (size[0], size[1], size[2] - FOOT_M), FOOT_M, 0.0, class_id)
    return solid_shapes.box(np.array(at), size, low_m, 0.0, class_id, floor=True)


def _post(
    radius_m: float, high_m: float, class_id: int = ClassId.POLE, at: tuple[float, float] = (0.0, 0.0), sides: int = 6
) -> Solid:
    return solid_shapes.post(np.array(at), radius_m, FOOT_M, high_m, class_id, sides)


def _tree(rng: np.random.Generator) -> list[Solid]:
    radius_m, top_m = rng.uniform(1.3, 2.4), rng.uniform(5.5, 9.0)
    middle_m = 2.5 + 0.4 * (top_m - 2.5)
    levels = ((0.0, 2.4), (radius_m, middle_m), (0.6 * radius_m, 0.8 * top_m), (0.0, top_m))
    return [_post(0.15, 2.6, ClassId.VEGETATION), solid_shapes.spindle(_HERE, levels, ClassId.VEGETATION)]


def _shrub(rng: np.random.Generator) -> list[Solid]:
    high_m = rng.uniform(0.7, 1.2)
    levels = ((0.35, FOOT_M), (0.5, 0.5 * high_m), (0.0, high_m))
    return [solid_shapes.spindle(_HERE, levels, ClassId.VEGETATION, sides=6)]


def _rack(rng: np.random.Generator) -> list[Solid]:
    """Four hoops side by side, some with a bicycle."""
    pieces: list[Solid] = []
    for x in (-1.3, -0.5, 0.3, 1.1):
        pieces += [_box((0.05, 0.05, 0.8), ClassId.STATIC, (x, y)) for y in (-0.35, 0.35)]
        pieces.append(_box((0.05, 0.75, 0.05), ClassId.STATIC, (x, 0.0), 0.8))
        if rng.random() < 0.6:
            turned_rad = np.pi / 2 * (1.0 if rng.random() < 0.5 else -1.0)
            pieces.append(solid_shapes.moved(_PLAIN_BICYCLE, np.array([x + 0.2, 0.0]), turned_rad))
    return pieces


def _leaning(side: float) -> Solid:
    """One of the two boards that lean on each other, as shops put them on the pavement."""
    board = _box((0.62, 0.05, 1.0))
    corners = board.vertices_W_m.copy()
    corners[:, 1] += side * np.where(corners[:, 2] > 0.5, 0.04, 0.26)
    return replace(board, vertices_W_m=corners)


_BIKE, _LYING, _SHED = ClassId.BICYCLE, ClassId.MOTORCYCLE, ClassId.BUILDING
_HANDLEBAR = _box((0.06, 0.5, 0.05), _BIKE, (0.42, 0.0), 0.98)
_PLAIN_BICYCLE = solid_shapes.joined(
    [
        *(solid_shapes.disc(x, 0.34, 0.05, _BIKE, sides=6) for x in (-0.54, 0.54)),
        _box((0.7, 0.06, 0.08), _BIKE, (0.0, 0.0), 0.6),
        _box((0.05, 0.05, 0.5), _BIKE, (0.4, 0.0), 0.5),
        _HANDLEBAR,
    ]
)
"""One of many: few triangles."""
_BARRIER = [
    *(_box((0.1, 0.4, 0.08), ClassId.FENCE, (x, 0.0)) for x in (-0.8, 0.8)),
    *(_box((0.06, 0.06, 1.0), ClassId.FENCE, (x, 0.0)) for x in (-0.8, 0.8)),
    *(_box((2.0, 0.05, high), ClassId.FENCE, low_m=low) for low, high in ((0.1, 0.2), (0.75, 0.25))),
]


def _look(size: tuple[float, float, float], *pieces: Solid, round: bool = False) -> _FurnitureModel:
    return _FurnitureModel(size_lwh_m=size, pieces=list(pieces), round=round)


def _solid(size: tuple[float, float, float], class_id: int = ClassId.STATIC) -> _FurnitureModel:
    return _look(size, _box(size, class_id))


def _pillar(radius_m: float, high_m: float, class_id: int = ClassId.POLE, sides: int = 6) -> _FurnitureModel:
    wide = 2.0 * radius_m
    return _look((wide, wide, high_m), _post(radius_m, high_m, class_id, sides=sides), round=True)


LOOKS: dict[str, _FurnitureModel] = {
    "barrier": _look((2.0, 0.4, 1.0), *_BARRIER),
    "bench": _look(
        (1.6, 0.55, 0.85),
        *(_box((0.08, 0.42, 0.4), at=(x, 0.0)) for x in (-0.62, 0.62)),
        _box((1.6, 0.46, 0.07), low_m=0.4),
        _box((1.6, 0.06, 0.36), at=(0.0, -0.22), low_m=0.49),
    ),
    "bicycle": _look(
        (1.8, 0.5, 1.05),
        *(solid_shapes.disc(x, 0.34, 0.04, _BIKE) for x in (-0.54, 0.54)),
        _box((1.0, 0.05, 0.07), _BIKE, low_m=0.38),
        _box((0.75, 0.05, 0.06), _BIKE, (0.0, 0.0), 0.74),
        *(_box((0.05, 0.05, 0.62), _BIKE, (x, 0.0), 0.36) for x in (-0.2, 0.4)),
        _box((0.26, 0.16, 0.07), _BIKE, (-0.25, 0.0), 0.94),
        _HANDLEBAR,
    ),
    "billboard": _look(
        (3.8, 0.3, 4.9), *(_post(0.1, 3.0, at=(x, 0.0)) for x in (-1.2, 1.2)), _box((3.8, 0.2, 2.7), low_m=2.2)
    ),
    "bin": _pillar(0.22, 0.95, ClassId.STATIC, 8),
    "block": _solid((0.9, 0.6, 0.6)),
    "board": _look((0.62, 0.6, 1.0), _leaning(-1.0), _leaning(1.0)),
    "bollard": _pillar(0.09, 0.95),
    "box": _solid((0.6, 0.6, 0.6), ClassId.DYNAMIC),
    "cabinet": _solid((1.0, 0.4, 1.3)),
    "column": _pillar(0.6, 3.0, ClassId.STATIC, 10),
    "cone": _look(
        (0.38, 0.38, 0.76),
        _box((0.38, 0.38, 0.04), ClassId.DYNAMIC),
        solid_shapes.spindle(_HERE, ((0.14, 0.03), (0.03, 0.75), (0.0, 0.76)), ClassId.DYNAMIC, sides=6),
    ),
    "container": _solid((6.06, 2.44, 2.6)),
    "cycle_barrier": _look(
        (1.08, 0.1, 1.0),
        *(_post(0.04, 1.0, ClassId.FENCE, (x, 0.0), 5) for x in (-0.5, 0.5)),
        *(_box((1.0, 0.05, 0.06), ClassId.FENCE, low_m=low) for low in (0.5, 0.94)),
    ),
    "fence": _solid((2.0, 0.08, 1.2), ClassId.FENCE),
    "flagpole": _pillar(0.06, 8.0),
    "fountain": _look(
        (2.2, 2.2, 1.4), _post(1.1, 0.45, ClassId.STATIC, sides=10), _post(0.2, 1.4, ClassId.STATIC), round=True
    ),
    "gate": _look(
        (2.0, 0.15, 1.2),
        *(_post(0.07, 1.2, ClassId.FENCE, (x, 0.0), 5) for x in (-0.95, 0.95)),
        *(_box((1.8, 0.06, 0.1), ClassId.FENCE, low_m=low) for low in (0.15, 0.5, 0.95)),
    ),
    "hedge": _solid((2.0, 0.6, 1.3), ClassId.VEGETATION),
    "hydrant": _pillar(0.15, 0.8, ClassId.STATIC),
    "info": _look(
        (1.2, 0.1, 2.0),
        *(_post(0.04, 2.0, at=(x, 0.0), sides=5) for x in (-0.55, 0.55)),
        _box((1.1, 0.08, 1.1), ClassId.STATIC, low_m=0.8),
    ),
    "kiosk": _solid((2.5, 2.0, 2.6), ClassId.BUILDING),
    "lamp": _look(
        (0.16, 0.16, 5.15), _post(0.08, 5.0, sides=5), _box((0.3, 0.6, 0.15), ClassId.POLE, (0.0, 0.2), 5.0), round=True
    ),
    "lift_gate": _look(
        (0.4, 0.4, 4.3), _box((0.4, 0.4, 1.1), ClassId.FENCE), _box((0.1, 0.08, 3.2), ClassId.FENCE, (0.0, 0.1), 1.1)
    ),
    "machine": _solid((0.9, 0.7, 1.8)),
    "meter": _solid((0.35, 0.3, 1.5)),
    "phone": _look(
        (0.95, 0.95, 2.3),
        _box((0.9, 0.04, 2.2), at=(0.0, -0.43)),
        *(_box((0.04, 0.86, 2.2), at=(x, 0.0)) for x in (-0.43, 0.43)),
        _box((0.95, 0.95, 0.12), low_m=2.2),
        _box((0.3, 0.2, 0.6), at=(0.0, -0.3), low_m=0.9),
    ),
    "planter": _look((1.2, 0.6, 0.9), _box((1.2, 0.6, 0.5)), _box((1.1, 0.5, 0.9), ClassId.VEGETATION)),
    "pole": _pillar(0.12, 6.0),
    "post_box": _solid((0.5, 0.45, 1.3)),
    "poster": _solid((1.4, 0.3, 2.6)),
    "rack": _FurnitureModel(size_lwh_m=(3.1, 1.8, 1.05), make=_rack),
    "recycling": _solid((1.6, 1.0, 1.5)),
    "roadworks": _look(
        (2.0, 1.2, 1.0),
        *(solid_shapes.moved(piece, np.array([0.0, y])) for y in (-0.4, 0.4) for piece in _BARRIER),
        _box((0.9, 0.4, 0.45), ClassId.DYNAMIC),
    ),
    "scooter": _look(  # a kick scooter lying on its side: deck, wheels, stem and handlebar flat on the ground
        (1.2, 0.75, 0.3),
        _box((0.85, 0.12, 0.2), _LYING, (-0.05, -0.3)),
        _box((0.2, 0.1, 0.22), _LYING, (-0.48, -0.3)),
        _box((0.2, 0.1, 0.22), _LYING, (0.48, -0.3)),
        _box((0.08, 0.75, 0.12), _LYING, (0.45, 0.05)),
        _box((0.3, 0.08, 0.3), _LYING, (0.42, 0.34)),
    ),
    "shelter": _look(  # back and side panes, a roof, and a bench inside; Cityscapes counts shelters as buildings
        (3.6, 1.3, 2.4),
        _box((3.6, 0.05, 2.3), _SHED, (0.0, -0.6)),
        *(_box((0.05, 1.1, 2.3), _SHED, (x, -0.05)) for x in (-1.77, 1.77)),
        _box((3.9, 1.6, 0.1), _SHED, (0.0, 0.0), 2.3),
        _box((1.8, 0.35, 0.07), at=(-0.4, -0.38), low_m=0.42),
        *(_box((0.07, 0.3, 0.42), at=(x, -0.38)) for x in (-1.1, 0.3)),
    ),
    "shrub": _FurnitureModel(size_lwh_m=(1.0, 1.0, 1.0), make=_shrub, round=True),
    "sign": _look(
        (0.1, 0.1, 2.75),
        _post(0.04, 2.75, sides=5),
        _box((0.6, 0.03, 0.6), ClassId.TRAFFIC_SIGN, (0.0, 0.06), 2.1),
        round=True,
    ),
    "skip": _solid((3.4, 1.7, 1.3)),
    "statue": _look(
        (1.0, 1.0, 3.1),
        _box((1.0, 1.0, 1.2)),
        solid_shapes.spindle(
            _HERE, ((0.25, 1.2), (0.3, 2.0), (0.15, 2.7), (0.16, 2.9), (0.0, 3.1)), ClassId.STATIC, sides=6
        ),
    ),
    "stop_pole": _look(
        (0.1, 0.1, 2.75),
        _post(0.03, 2.3, sides=5),
        _box((0.45, 0.04, 0.5), ClassId.TRAFFIC_SIGN, (0.0, 0.05), 2.25),
        round=True,
    ),
    "table": _look(
        (1.8, 1.5, 0.78),
        *(_box((0.1, 1.4, 0.4), at=(x, 0.0)) for x in (-0.6, 0.6)),
        *(_box((1.7, 0.3, 0.06), at=(0.0, y), low_m=0.42) for y in (-0.62, 0.62)),
        _box((1.8, 0.7, 0.06), low_m=0.72),
        _box((0.1, 0.3, 0.72)),
    ),
    "tap": _pillar(0.18, 1.0, ClassId.STATIC),
    "tree": _FurnitureModel(size_lwh_m=(0.3, 0.3, 7.0), make=_tree, round=True),
    "wall": _solid((2.0, 0.2, 1.5), ClassId.WALL),
}

_KINDS_OF_CLASS = {
    ClassId.BICYCLE: "bicycle",
    ClassId.POLE: "bollard lamp pole",
    ClassId.FENCE: "barrier fence roadworks",
    ClassId.DYNAMIC: "box cone",
    ClassId.VEGETATION: "hedge planter tree",
    ClassId.BUILDING: "kiosk shelter",
    ClassId.MOTORCYCLE: "scooter",
    ClassId.TRAFFIC_SIGN: "sign",
    ClassId.WALL: "wall",
}
CLASS_OF_AREA = {kind: class_id for class_id, kinds in _KINDS_OF_CLASS.items() for kind in kinds.split()}
"""Class of things of a kind that are drawn as an outline or a line; others are STATIC."""

"""What each kind of street furniture looks like, in a frame of its own.

x is along its long side, y its front, z up. Height 0 is the ground. Whatever stands on it reaches a
little deeper, because ground falls at crossings and on hills.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wcsim.core.reading import read_module_toml
from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.types import ClassId

FOOT_M = -0.25  # how deep things reach into the ground

Make = Callable[[np.random.Generator], list[Solid]]
_HERE = np.zeros(2)
_BIKE = ClassId.BICYCLE


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
        return solid_shapes.box(
            np.array(at), (size[0], size[1], size[2] - FOOT_M), FOOT_M, 0.0, class_id
        )
    return solid_shapes.box(np.array(at), size, low_m, 0.0, class_id, floor=True)


def _post(
    radius_m: float,
    high_m: float,
    class_id: int = ClassId.POLE,
    at: tuple[float, float] = (0.0, 0.0),
    sides: int = 6,
) -> Solid:
    return solid_shapes.post(np.array(at), radius_m, FOOT_M, high_m, class_id, sides)


def _tree(rng: np.random.Generator) -> list[Solid]:
    radius_m, top_m = rng.uniform(1.3, 2.4), rng.uniform(5.5, 9.0)
    middle_m = 2.5 + 0.4 * (top_m - 2.5)
    levels = ((0.0, 2.4), (radius_m, middle_m), (0.6 * radius_m, 0.8 * top_m), (0.0, top_m))
    return [
        _post(0.15, 2.6, ClassId.VEGETATION),
        solid_shapes.spindle(_HERE, levels, ClassId.VEGETATION),
    ]


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


_PLAIN_BICYCLE = solid_shapes.joined(
    [
        *(solid_shapes.disc(x, 0.34, 0.05, _BIKE, sides=6) for x in (-0.54, 0.54)),
        _box((0.7, 0.06, 0.08), _BIKE, (0.0, 0.0), 0.6),
        _box((0.05, 0.05, 0.5), _BIKE, (0.4, 0.0), 0.5),
        _box((0.06, 0.5, 0.05), _BIKE, (0.42, 0.0), 0.98),
    ]
)
"""One of many: few triangles."""


def _read_looks() -> Iterator[tuple[str, _FurnitureModel]]:
    """The models of `models.toml` with their kinds."""
    for kind, look in read_module_toml(__file__).items():
        length_m, width_m, height_m = look["size"]
        pieces: list[Solid] = []
        for row in look["pieces"]:
            pieces += [_placed(row, (x, y)) for x, y in row.get("at", [(0.0, 0.0)])]
        size_lwh_m = (length_m, width_m, height_m)
        is_round = look.get("round", False)
        yield kind, _FurnitureModel(size_lwh_m=size_lwh_m, pieces=pieces, round=is_round)


def _placed(row: dict[str, Any], at: tuple[float, float]) -> Solid:
    """A piece of a row of `models.toml` at one of its places."""
    if "post" in row:
        radius_m, high_m = row["post"]
        return _post(radius_m, high_m, ClassId[row.get("class", "POLE")], at, row.get("sides", 6))
    if "disc" in row:
        x_m, radius_m, thick_m = row["disc"]
        return solid_shapes.disc(x_m, radius_m, thick_m, ClassId[row["class"]])
    class_id = ClassId[row.get("class", "STATIC")]
    if "spindle" in row:
        return solid_shapes.spindle(np.array(at), row["spindle"], class_id, sides=6)
    length_m, width_m, height_m = row["box"]
    return _box((length_m, width_m, height_m), class_id, at, row.get("low_m"))


LOOKS = dict(_read_looks())
LOOKS |= {
    "board": _FurnitureModel(size_lwh_m=(0.62, 0.6, 1.0), pieces=[_leaning(-1.0), _leaning(1.0)]),
    "rack": _FurnitureModel(size_lwh_m=(3.1, 1.8, 1.05), make=_rack),
    "roadworks": _FurnitureModel(
        size_lwh_m=(2.0, 1.2, 1.0),
        pieces=[
            *(
                solid_shapes.moved(piece, np.array([0.0, y]))
                for y in (-0.4, 0.4)
                for piece in LOOKS["barrier"].pieces
            ),
            _box((0.9, 0.4, 0.45), ClassId.DYNAMIC),
        ],
    ),
    "shrub": _FurnitureModel(size_lwh_m=(1.0, 1.0, 1.0), make=_shrub, round=True),
    "tree": _FurnitureModel(size_lwh_m=(0.3, 0.3, 7.0), make=_tree, round=True),
}
"""The model of each kind."""

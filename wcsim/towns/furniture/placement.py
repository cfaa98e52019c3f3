"""Things in the street: what they look like, which ground they take, and how high they stand."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.seeding import make_rng
from wcsim.towns.furniture.models import LOOKS
from wcsim.towns.ground import solid_shapes
from wcsim.towns.ground.solid_shapes import Solid
from wcsim.types import F64, Bool, SignalHead

CLEAR_M = 0.75  # free space beside the walking line
_CELL_M = 8.0

HeightAt = Callable[[F64], F64]
"""Ground height (n,) at points (n, 2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StandingObject:
    """A piece that stands in the street, and the ground below 2 m height that it takes.

    Heights are above the ground at `base_m`, or, where it follows the ground, above the ground
    below each vertex.
    """

    piece: Solid
    footprint: Polygon  # empty for what hangs over the street
    base_m: F64  # (2,)
    follows: bool = False
    heads: tuple[SignalHead, ...] = ()


class Taken:
    """The ground that things take already."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], list[Polygon]] = defaultdict(list)

    def add(self, footprint: Polygon) -> None:
        """Take this ground; what hangs over the street takes none."""
        if footprint.is_empty:
            return
        for cell in self._over(footprint):
            self._cells[cell].append(footprint)

    def free(self, footprint: Polygon, gap_m: float = 0.0) -> bool:
        """True when nothing that was added comes nearer to a footprint than the gap."""
        wide = footprint.buffer(gap_m, quad_segs=1) if gap_m > 0.0 else footprint
        return not any(
            wide.intersects(other) for cell in self._over(wide) for other in self._cells[cell]
        )

    def _over(self, footprint: Polygon) -> list[tuple[int, int]]:
        x0, y0, x1, y1 = (int(v) for v in np.floor(np.array(footprint.bounds) / _CELL_M))
        return [(x, y) for x in range(x0, x1 + 1) for y in range(y0, y1 + 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeGround:
    """Where things may stand, and what stands there already."""

    low: BaseGeometry  # carriageway and crossings, with a little margin
    solids: BaseGeometry  # buildings
    lines: BaseGeometry  # walking lines
    hull: BaseGeometry
    taken: Taken = field(default_factory=Taken)

    def __post_init__(self) -> None:
        """Make many questions cheap."""
        for geometry in (self.low, self.solids, self.lines, self.hull):
            shapely.prepare(geometry)

    def take(self, things: Iterable[StandingObject]) -> None:
        """Things stand there from now on."""
        for thing in things:
            self.taken.add(thing.footprint)

    def free(self, footprint: Polygon) -> bool:
        """True when a footprint is in the town, off the road, and clear of things and walkers."""
        return bool(
            self.hull.contains(footprint)
            and not self.low.intersects(footprint)
            and not self.solids.intersects(footprint)
            and not shapely.dwithin(self.lines, footprint, CLEAR_M)
            and self.taken.free(footprint)
        )

    def room_for(
        self, kind: str, places_m: Iterable[F64], facing_rad: float
    ) -> list[StandingObject]:
        """One thing of a kind at the first of some places with room for it, if there is one."""
        yaw_rad = facing_rad - np.pi / 2
        for xy_m in places_m:
            if self.free(_footprint_of(kind, xy_m, yaw_rad, LOOKS[kind].size_lwh_m)):
                return [standing_object(kind, xy_m, yaw_rad)]
        return []

    def put(self, kind: str, places_m: Iterable[F64], facing_rad: float) -> list[StandingObject]:
        """The same, and its ground is taken."""
        things = self.room_for(kind, places_m, facing_rad)
        self.take(things)
        return things

    def free_spots(self, xy_m: F64, radius_m: float) -> Bool:
        """The same (n,) for discs about points (n, 2), whatever stands there already."""
        points = shapely.points(xy_m)
        free: Bool = shapely.contains(self.hull, points)
        for area, gap_m in ((self.low, 0.0), (self.lines, CLEAR_M), (self.solids, 0.0)):
            free[free] = ~shapely.dwithin(area, points[free], radius_m + gap_m)
        return free


def standing_object(
    kind: str, xy_m: F64, yaw_rad: float, size_lwh_m: tuple[float, float, float] | None = None
) -> StandingObject:
    """One thing of a kind of `LOOKS`, its long side along yaw and its front to the left of it."""
    look = LOOKS[kind]
    size_m = size_lwh_m or look.size_lwh_m
    pieces = look.pieces
    # A thing may lie a millimetre aside on another machine, and must look the same on both.
    if look.make:
        pieces = look.make(make_rng(0, kind, *(int(abs(c) * 10) for c in xy_m)))
    piece = solid_shapes.joined(pieces)
    if size_lwh_m is not None:
        l0, w0, h0 = look.size_lwh_m
        piece = solid_shapes.scaled(piece, (size_m[0] / l0, size_m[1] / w0, size_m[2] / h0))
    return StandingObject(
        piece=solid_shapes.moved(piece, xy_m, yaw_rad),
        footprint=_footprint_of(kind, xy_m, yaw_rad, size_m),
        base_m=np.asarray(xy_m),
    )


def set_on_ground(
    things: Iterable[StandingObject], height_at: HeightAt
) -> tuple[list[Solid], tuple[SignalHead, ...]]:
    """The pieces of all things, and the heads of all signals, at the height of their ground."""
    pieces: list[Solid] = []
    heads: list[SignalHead] = []
    for thing in things:
        base_m = float(height_at(thing.base_m[None])[0])
        lift_m = height_at(thing.piece.vertices_W_m[:, :2]) if thing.follows else base_m
        pieces.append(solid_shapes.raised(thing.piece, lift_m))
        up_m = np.array([0.0, 0.0, base_m])
        heads += [replace(head, p_W_m=head.p_W_m + up_m) for head in thing.heads]
    return pieces, tuple(heads)


def _footprint_of(
    kind: str, xy_m: F64, yaw_rad: float, size_lwh_m: tuple[float, float, float]
) -> Polygon:
    """The ground that a thing takes."""
    length_m, width_m, _ = size_lwh_m
    if LOOKS[kind].round and length_m == width_m:
        return shapely.Point(xy_m).buffer(length_m / 2, quad_segs=2)
    return solid_shapes.rectangle(xy_m, length_m, width_m, yaw_rad)

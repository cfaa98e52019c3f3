"""The static street: mesh, raster, walking network, and the tiles in which a large town is loaded.

Import these types from `wcsim.types`. World frame W: x east, y north, z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from wcsim.types.arrays import F32, F64, I32, U8, Bool, ComparesArrays

TileKey = tuple[int, int]
AROUND_M: Final = 16.0
AT_EDGE: Final = 128  # the least `edge_cm` of raised ground


class ClassId(IntEnum):
    """Pixel classes: Cityscapes labelIds, and three classes of wcsim from 34 on.

    `make_cityscapes_class_table` folds them.
    """

    VOID = 0
    STATIC = 4
    DYNAMIC = 5
    GROUND = 6
    ROAD = 7
    SIDEWALK = 8
    PARKING = 9
    RAIL_TRACK = 10
    BUILDING = 11
    WALL = 12
    FENCE = 13
    POLE = 17
    TRAFFIC_LIGHT = 19
    TRAFFIC_SIGN = 20
    VEGETATION = 21
    TERRAIN = 22
    SKY = 23
    PERSON = 24
    RIDER = 25
    CAR = 26
    TRUCK = 27
    BUS = 28
    TRAIN = 31
    MOTORCYCLE = 32
    BICYCLE = 33
    KERB = 34
    LOWERED_KERB = 35
    CROSSWALK = 36


class Mark(IntEnum):
    """Kinds of road markings."""

    LINE = 0
    CYCLE_LANE = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundPaint(ComparesArrays):
    """Road markings as flat pieces a little above the road; only colour images show them."""

    # (M, 4, 3) counter-clockwise from above.
    quads_W_m: F32 = field(default_factory=lambda: np.zeros((0, 4, 3), np.float32))
    mark: U8 = field(default_factory=lambda: np.zeros(0, np.uint8))  # (M,) Mark

    def part(self, which: Bool) -> GroundPaint:
        """The pieces for which the mask (M,) is true."""
        return GroundPaint(quads_W_m=self.quads_W_m[which], mark=self.mark[which])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetMesh(ComparesArrays):
    """All static geometry as one triangle mesh, for wheels and cameras.

    Triangles are sorted by chunk. Chunk c owns faces `chunk_faces[c]:chunk_faces[c + 1]` and uses
    only vertices `chunk_vertices[c]:chunk_vertices[c + 1]`, so that it can be culled (camera) and
    merged (collision) on its own.
    """

    vertices_W_m: F32  # (V, 3)
    # (F, 3) indices into vertices_W_m, counter-clockwise seen from outside (up for ground).
    faces: I32
    face_class: U8  # (F,) ClassId
    chunk_vertices: I32  # (C + 1,)
    chunk_faces: I32  # (C + 1,)
    paint: GroundPaint = field(default_factory=GroundPaint)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relief(ComparesArrays):
    """Terrain heights without kerbs, on a square grid.

    They are interpolated linearly on two triangles per square. Square (row, col) has its lower left
    corner at origin_W_m + cell_m * (col, row) and is cut from there to its upper right corner.
    Beyond the grid the height of its border continues.
    """

    origin_W_m: tuple[float, float]
    cell_m: float
    z_m: F32  # (rows, cols) at least (2, 2)

    @property
    def flat(self) -> bool:
        """True if all heights are 0."""
        return not self.z_m.any()

    def at(self, p_W_m: F64) -> F64:
        """Height in metres at the points (..., 2 or 3)."""
        rows, cols = self.z_m.shape
        u = np.clip((p_W_m[..., 0] - self.origin_W_m[0]) / self.cell_m, 0.0, cols - 1.0)
        v = np.clip((p_W_m[..., 1] - self.origin_W_m[1]) / self.cell_m, 0.0, rows - 1.0)
        col, row = np.minimum(u.astype(np.intp), cols - 2), np.minimum(v.astype(np.intp), rows - 2)
        u, v = u - col, v - row
        low = self.z_m[row, col].astype(np.float64)
        high = self.z_m[row + 1, col + 1].astype(np.float64)
        side = np.where(u >= v, self.z_m[row, col + 1], self.z_m[row + 1, col]).astype(np.float64)
        big, small = np.maximum(u, v), np.minimum(u, v)
        return np.asarray(low + big * (side - low) + small * (high - side), np.float64)


FLAT = Relief(origin_W_m=(0.0, 0.0), cell_m=1.0, z_m=np.zeros((2, 2), np.float32))


class Ground(Protocol):
    """The street seen from above, for fast lookups (oracle, spawn, pedestrians)."""

    def height_at(self, p_W_m: F64) -> F64:
        """Ground height in metres under the points (..., 2 or 3)."""

    def raised_at(self, p_W_m: F64) -> F64:
        """Height in metres of the ground above the terrain: 0 on a road, a kerb's on a pavement."""

    def clearance_at(self, p_W_m: F64) -> F64:
        """Distance in metres from points (..., 2 or 3) to the nearest obstacle, at most 25.5."""

    def class_at(self, p_W_m: F64) -> U8:
        """ClassId of the ground under the points (..., 2 or 3)."""

    def height_here(self, x_W_m: float, y_W_m: float) -> float:
        """Ground height in metres at one place, without arrays.

        It is for the few places that every tick looks up.
        """

    def class_here(self, x_W_m: float, y_W_m: float) -> int:
        """ClassId of the ground at one place."""

    def around(self, p_W_m: F64) -> StreetGrid:
        """One raster that covers at least AROUND_M around the point (2 or 3,)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetGrid(ComparesArrays):
    """A `Ground` made of rasters.

    Cell (row, col) covers x from origin_W_m[0] + col * cell_m, y from origin_W_m[1] + row * cell_m.
    """

    origin_W_m: tuple[float, float]
    cell_m: float
    height_cm: U8  # (rows, cols) ground height above the relief, centimetres
    ground_class: U8  # (rows, cols) ClassId of the ground surface
    # (rows, cols) distance to the nearest obstacle (wall, trunk, pole), decimetres, 255 = far.
    clearance_dm: U8
    # (rows, cols) distance of the cell's middle to the nearest kerb's edge, centimetres: from
    # AT_EDGE up on raised ground, and down on low ground. One cell alone: no kerb is known.
    edge_cm: U8 = field(default_factory=lambda: np.zeros((1, 1), np.uint8))
    relief: Relief = field(default_factory=lambda: FLAT)

    def __post_init__(self) -> None:
        """Where no kerb is known, one may be near, but it cuts no cell."""
        if self.edge_cm.shape == (1, 1):
            object.__setattr__(
                self, "edge_cm", np.full(self.height_cm.shape, AT_EDGE + 20, np.uint8)
            )

    def cells(self, p_W_m: F64) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Rows and columns of the points (..., 2 or 3); points outside get the border cell."""
        rows, cols = self.height_cm.shape
        col = np.floor((p_W_m[..., 0] - self.origin_W_m[0]) / self.cell_m).astype(np.intp)
        row = np.floor((p_W_m[..., 1] - self.origin_W_m[1]) / self.cell_m).astype(np.intp)
        return np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)

    def height_at(self, p_W_m: F64) -> F64:
        """See `Ground`."""
        raised = self.raised_at(p_W_m)
        return raised if self.relief is FLAT else raised + self.relief.at(p_W_m)

    def raised_at(self, p_W_m: F64) -> F64:
        """See `Ground`."""
        return np.asarray(self.height_cm[self.cells(p_W_m)] * 0.01, np.float64)

    def clearance_at(self, p_W_m: F64) -> F64:
        """See `Ground`."""
        return np.asarray(self.clearance_dm[self.cells(p_W_m)] * 0.1, np.float64)

    def class_at(self, p_W_m: F64) -> U8:
        """See `Ground`."""
        return self.ground_class[self.cells(p_W_m)]

    def height_here(self, x_W_m: float, y_W_m: float) -> float:
        """See `Ground`."""
        raised_m = 0.01 * int(self.height_cm[self._cell(x_W_m, y_W_m)])
        if self.relief is FLAT:
            return raised_m
        return raised_m + float(self.relief.at(np.array([x_W_m, y_W_m])))

    def class_here(self, x_W_m: float, y_W_m: float) -> int:
        """See `Ground`."""
        return int(self.ground_class[self._cell(x_W_m, y_W_m)])

    def _cell(self, x_W_m: float, y_W_m: float) -> tuple[int, int]:
        rows, cols = self.height_cm.shape
        col = math.floor((x_W_m - self.origin_W_m[0]) / self.cell_m)
        row = math.floor((y_W_m - self.origin_W_m[1]) / self.cell_m)
        return min(max(row, 0), rows - 1), min(max(col, 0), cols - 1)

    def around(self, p_W_m: F64) -> StreetGrid:
        """See `Ground`: this very raster."""
        return self


class WayKind(Enum):
    """Kind of ground under a piece of a walking route."""

    SIDEWALK = "sidewalk"
    WALKINGAREA = "walkingarea"
    CROSSING = "crossing"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkEdge(ComparesArrays):
    """One edge of the walking network, passable in both directions."""

    sumo_id: str
    kind: WayKind
    start: int  # node index
    end: int
    points_W_m: F64  # (K, 2), from start to end
    width_m: float
    tls_id: str = ""  # its traffic light, "" for none
    tls_links: tuple[int, ...] = ()  # indices of its signals in that light's state string
    never_green: bool = False  # no phase of that light's programs lets people over


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkGraph(ComparesArrays):
    """Where a wheelchair may drive: pavements, walking areas and crossings, as nodes and edges."""

    nodes_W_m: F64  # (N, 2)
    edges: tuple[WalkEdge, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Route(ComparesArrays):
    """A route for the simulated user: a polyline over the walk graph."""

    points_W_m: F64  # (K, 2)
    arc_m: F64  # (K,) distance from the start
    edge_index: I32  # (K,) index into WalkGraph.edges of the piece that starts at this point


class StreetTiles(Protocol):
    """The mesh of a street in square tiles; only those near a wheelchair need to be in memory."""

    @property
    def keys(self) -> tuple[TileKey, ...]:
        """All tiles, sorted."""

    def near(self, points_W_m: F64, reach_m: float) -> tuple[TileKey, ...]:
        """Tiles within reach of any of the points (n, 2 or 3), sorted."""

    def mesh(self, key: TileKey) -> StreetMesh:
        """The mesh of one tile."""


@dataclass(frozen=True, slots=True)
class OneTile:
    """A street that is small enough to be loaded as one tile."""

    whole: StreetMesh

    @property
    def keys(self) -> tuple[TileKey, ...]:
        """See `StreetTiles`."""
        return ((0, 0),)

    def near(self, points_W_m: F64, reach_m: float) -> tuple[TileKey, ...]:
        """See `StreetTiles`."""
        return self.keys if len(points_W_m) else ()

    def mesh(self, key: TileKey) -> StreetMesh:
        """See `StreetTiles`."""
        return self.whole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalHead(ComparesArrays):
    """One head of a traffic light: its lamps, and its index in the light's state."""

    tls_id: str
    link: int  # index into the light's state string
    p_W_m: F64  # (3,) middle of the head
    yaw_rad: float  # the direction in which the lamps shine
    pedestrian: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Street:
    """A town as the other packages use it: mesh, raster, walking network, signals."""

    tiles: StreetTiles
    grid: Ground
    walk: WalkGraph
    signal_heads: tuple[SignalHead, ...] = ()
    net_origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # W's origin in SUMO's net

    @property
    def mesh(self) -> StreetMesh:
        """All tiles as one mesh, for tools and tests; a world loads single tiles."""
        return join_meshes([self.tiles.mesh(key) for key in self.tiles.keys])


def join_meshes(parts: Sequence[StreetMesh]) -> StreetMesh:
    """Join several meshes into one, in their order."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.vertices_W_m) for part in parts)]).astype(np.int32)
    first_faces = np.cumsum([0, *(len(part.faces) for part in parts)]).astype(np.int32)
    # Empty arrays lead, so that no parts at all are joined too.
    vertices = [np.zeros((0, 3), np.float32)]
    faces = [np.zeros((0, 3), np.int32)]
    face_class = [np.zeros(0, np.uint8)]
    chunk_vertices = [np.zeros(0, np.int32)]
    chunk_faces = [np.zeros(0, np.int32)]
    quads, marks = [GroundPaint().quads_W_m], [GroundPaint().mark]
    for part, start, first_face in zip(parts, starts, first_faces, strict=False):
        vertices.append(part.vertices_W_m)
        faces.append(part.faces + start)
        face_class.append(part.face_class)
        chunk_vertices.append(part.chunk_vertices[:-1] + start)
        chunk_faces.append(part.chunk_faces[:-1] + first_face)
        quads.append(part.paint.quads_W_m)
        marks.append(part.paint.mark)
    return StreetMesh(
        vertices_W_m=np.concatenate(vertices),
        faces=np.concatenate(faces),
        face_class=np.concatenate(face_class),
        chunk_vertices=np.concatenate([*chunk_vertices, starts[-1:]]),
        chunk_faces=np.concatenate([*chunk_faces, first_faces[-1:]]),
        paint=GroundPaint(quads_W_m=np.concatenate(quads), mark=np.concatenate(marks)),
    )

"""A street in square tiles, of which only those near chairs are in memory."""

from __future__ import annotations

import math
import mmap
import zipfile
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import zstandard

from wcsim.errors import TownError
from wcsim.types import F64, U8, GroundPaint, Relief, StreetGrid, StreetMesh, TileKey
from wcsim.types.street import AROUND_M

if TYPE_CHECKING:  # what makes streets is heavy, and no world needs it where a street is built
    from wcsim.towns.ground.mesh import GridMaker

CELL_M = 0.1  # of the rasters
CHUNK_M = 40.0  # side of the mesh's chunks
TILE_M = 3 * CHUNK_M
# The side of a raster. Its margin is stored as well, so a large one is read for little.
RASTER_M = 0.5 * TILE_M
_RASTERS = ("height_cm", "ground_class", "clearance_dm", "edge_cm")  # 0.85 MB each
_HEIGHTS = _RASTERS[:1]
_NONE: U8 = np.zeros((0, 0), np.uint8)
_CACHED = 24  # rasters in memory at any time; a chair and those around it request seven
_MOST_CACHED = 448  # 32 chairs apart unpacked 23 rasters a tick with a fourth of it
# What was requested since stays, up to _MOST_CACHED. Six chairs request 80 rasters a tick, one 27.
_RECENT_REQUESTS = 4_000
_MESH = ("vertices_W_m", "faces", "face_class", "chunk_vertices", "chunk_faces")
_PAINT = ("quads_W_m", "mark")

Box = tuple[float, float, float, float]  # west, south, east, north
Packed = Mapping[str, np.ndarray]
T = TypeVar("T")


def pack_tiles(mesh: StreetMesh, grid: GridMaker) -> dict[str, np.ndarray]:
    """All tiles of a street as named arrays; the rasters are compressed."""
    # 1. Find the tile (n, 2) in which the middle of each chunk and of each mark lies.
    west, south, east, north = grid.bounds()
    first = np.floor(np.array([west, south]) / TILE_M).astype(int)
    last = np.floor(np.array([east, north]) / TILE_M - 1e-9).astype(int)
    starts = mesh.chunk_vertices[:-1]
    xy_m = mesh.vertices_W_m[:, :2].astype(np.float64)
    middle_m = 0.5 * (np.minimum.reduceat(xy_m, starts) + np.maximum.reduceat(xy_m, starts))
    owner = np.clip(np.floor(middle_m / TILE_M).astype(int), first, last)
    middle_m = mesh.paint.quads_W_m[:, :, :2].mean(axis=1)
    painted = np.clip(np.floor(middle_m / TILE_M).astype(int), first, last)

    # 2. Pack the mesh of each tile. Its span is that of its square and its mesh together, as a
    # building may reach over the border.
    arrays: dict[str, np.ndarray] = {"tile_range": np.array([*first, *last])}
    spans = []
    keys = [(x, y) for x in range(first[0], last[0] + 1) for y in range(first[1], last[1] + 1)]
    for key in keys:
        part = _chunks_of(mesh, np.flatnonzero((owner == key).all(axis=1)))
        paint = mesh.paint.part((painted == key).all(axis=1))
        arrays |= {_name(key, name): getattr(part, name) for name in _MESH}
        arrays |= {_name(key, name): getattr(paint, name) for name in _PAINT}
        x, y = key[0] * TILE_M, key[1] * TILE_M
        square = [(x, y), (x + TILE_M, y + TILE_M)]
        xy_m = np.concatenate([part.vertices_W_m[:, :2].astype(np.float64), square])
        spans.append((*xy_m.min(axis=0).tolist(), *xy_m.max(axis=0).tolist()))
    arrays["tile_spans"] = np.array(spans)

    # 3. Pack the rasters, each as a copy: the packer's own bytes hold as much memory as a raster.
    columns = range(math.floor(west / RASTER_M), math.floor(east / RASTER_M - 1e-9) + 1)
    rows = range(math.floor(south / RASTER_M), math.floor(north / RASTER_M - 1e-9) + 1)
    arrays["raster_range"] = np.array([columns[0], rows[0], columns[-1], rows[-1]])
    packer = zstandard.ZstdCompressor(level=1)
    for key in [(x, y) for x in columns for y in rows]:
        piece = grid.piece(_box(key))
        for name in _RASTERS:
            packed = packer.compress(getattr(piece, name).tobytes())
            arrays[_name(key, name)] = np.frombuffer(packed, np.uint8).copy()
    return arrays


class TileStore:
    """The tiles of one street; the rasters of the last few places stay in memory.

    It is both the street's `Ground` and its `StreetTiles`. Places outside the town have the ground
    of its border.
    """

    def __init__(self, packed: Packed, relief: Relief) -> None:
        self._packed = packed
        self._relief = relief
        west, south, east, north = (int(number) for number in packed["tile_range"])
        corners = [int(number) for number in packed["raster_range"]]
        self._first, self._last = (corners[0], corners[1]), (corners[2], corners[3])
        self.keys = tuple((x, y) for x in range(west, east + 1) for y in range(south, north + 1))
        self._spans = packed["tile_spans"]  # (tiles, 4) what the mesh of each tile covers
        # The grid used last is the last. Many have heights alone.
        self._cached: OrderedDict[TileKey, StreetGrid] = OrderedDict()
        self._used: dict[TileKey, int] = {}  # the number of the last request of each
        self._requests = 0

    def near(self, points_W_m: F64, reach_m: float) -> tuple[TileKey, ...]:
        """See `StreetTiles`."""
        points = points_W_m[:, None, :2]
        below, above = self._spans[:, :2] - points, points - self._spans[:, 2:]  # (n, tiles, 2)
        out = np.maximum(np.maximum(below, above), 0.0)
        close = ((out**2).sum(-1) <= reach_m**2).any(axis=0)
        return tuple(self.keys[i] for i in np.flatnonzero(close))

    def mesh(self, key: TileKey) -> StreetMesh:
        """See `StreetTiles`."""

        def arrays(names: tuple[str, ...]) -> dict[str, np.ndarray]:
            return {name: self._packed[_name(key, name)] for name in names}

        def read() -> StreetMesh:
            return StreetMesh(**arrays(_MESH), paint=GroundPaint(**arrays(_PAINT)))

        return self._guarded(read)

    def height_at(self, p_W_m: F64) -> F64:
        """See `Ground`."""
        return self._look_up(p_W_m, StreetGrid.height_at, _HEIGHTS)

    def raised_at(self, p_W_m: F64) -> F64:
        """See `Ground`."""
        return self._look_up(p_W_m, StreetGrid.raised_at, _HEIGHTS)

    def clearance_at(self, p_W_m: F64) -> F64:
        """See `Ground`."""
        return self._look_up(p_W_m, StreetGrid.clearance_at)

    def class_at(self, p_W_m: F64) -> U8:
        """See `Ground`."""
        classes: U8 = self._look_up(p_W_m, StreetGrid.class_at).astype(np.uint8, copy=False)
        return classes

    def height_here(self, x_W_m: float, y_W_m: float) -> float:
        """See `Ground`."""
        return self._grid(x_W_m, y_W_m, _HEIGHTS).height_here(x_W_m, y_W_m)

    def class_here(self, x_W_m: float, y_W_m: float) -> int:
        """See `Ground`."""
        return self._grid(x_W_m, y_W_m).class_here(x_W_m, y_W_m)

    def around(self, p_W_m: F64) -> StreetGrid:
        """See `Ground`."""
        return self._grid(float(p_W_m[0]), float(p_W_m[1]))

    def _grid(self, x_W_m: float, y_W_m: float, names: tuple[str, ...] = _RASTERS) -> StreetGrid:
        key = math.floor(x_W_m / RASTER_M), math.floor(y_W_m / RASTER_M)
        if not self._first <= key <= self._last or not self._first[1] <= key[1] <= self._last[1]:
            (west, south), (east, north) = self._first, self._last
            key = min(max(key[0], west), east), min(max(key[1], south), north)
        return self._rasters(key, names)

    def _look_up(
        self,
        p_W_m: F64,
        question: Callable[[StreetGrid, F64], np.ndarray],
        names: tuple[str, ...] = _RASTERS,
    ) -> np.ndarray:
        """The answer for points (..., 2 or 3), tile by tile."""
        if p_W_m.ndim == 1:
            return question(self._grid(float(p_W_m[0]), float(p_W_m[1]), names), p_W_m)
        tiles = np.floor(p_W_m[..., :2] / RASTER_M).astype(int)
        tiles = np.clip(tiles, self._first, self._last).reshape(-1, 2)
        if not len(tiles):
            return question(self._rasters(self._first, names), p_W_m)
        # Nearly always one tile holds them all.
        if (tiles == tiles[0]).all():
            return question(self._rasters((int(tiles[0, 0]), int(tiles[0, 1])), names), p_W_m)
        points = p_W_m.reshape(-1, p_W_m.shape[-1])
        found = np.empty(len(points))
        for x, y in np.unique(tiles, axis=0).tolist():
            own = (tiles == (x, y)).all(axis=1)
            found[own] = question(self._rasters((x, y), names), points[own])
        return found.reshape(p_W_m.shape[:-1])

    def _rasters(self, key: TileKey, names: tuple[str, ...]) -> StreetGrid:
        """A grid that has the rasters of these names, and maybe not the others."""
        self._requests += 1
        grid = self._cached.get(key)
        missing = grid is None or (names is _RASTERS and grid.ground_class is _NONE)
        if grid is None or missing:
            grid = self._cached[key] = self._guarded(lambda: self._unpacked(key, names))
        self._cached.move_to_end(key)
        self._used[key] = self._requests
        if missing:
            self._forget()
        return grid

    def _forget(self) -> None:
        """Drop rasters that were not requested for a while, and those above the limit."""
        count = sum(_raster_count(grid) for grid in self._cached.values())
        for key in list(self._cached):
            recent = self._used[key] > self._requests - _RECENT_REQUESTS
            if count <= (_MOST_CACHED if recent else _CACHED):
                return
            count -= _raster_count(self._cached.pop(key))
            del self._used[key]

    def _guarded(self, read: Callable[[], T]) -> T:
        """What `read` returns. Raises TownError where the street's file is broken."""
        try:
            return read()
        except (OSError, ValueError, zipfile.BadZipFile, zlib.error, zstandard.ZstdError) as error:
            raise TownError(
                f"the built street cannot be read any more ({error}); "
                "delete ~/.cache/wcsim and start again"
            ) from None

    def _unpacked(self, key: TileKey, names: tuple[str, ...]) -> StreetGrid:
        x0, y0, x1, y1 = _box(key)
        shape = (round((y1 - y0) / CELL_M), round((x1 - x0) / CELL_M))
        found = {name: _raster_of(self._packed[_name(key, name)], shape) for name in names}
        rasters = dict.fromkeys(_RASTERS, _NONE) | found
        return StreetGrid(origin_W_m=(x0, y0), cell_m=CELL_M, relief=self._relief, **rasters)


def _raster_count(grid: StreetGrid) -> int:
    return 1 if grid.ground_class is _NONE else len(_RASTERS)


def _raster_of(packed: U8, shape: tuple[int, int]) -> U8:
    """A raster of that shape. Raises ValueError for one of another size."""
    # It has pages of its own: they go back when it goes, where the heap would keep a hole.
    pages = mmap.mmap(-1, shape[0] * shape[1], mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    raster = np.frombuffer(pages, np.uint8)
    with zstandard.ZstdDecompressor().stream_reader(packed.tobytes()) as reader:
        if reader.readinto(raster.data) != raster.size or reader.read(1):
            raise ValueError(f"a raster is not of {shape} cells")
    raster.flags.writeable = False
    return raster.reshape(shape)


def _name(key: TileKey, name: str) -> str:
    return f"tile {key[0]} {key[1]} {name}"


def _box(key: TileKey) -> Box:
    """The ground that a raster covers: its square and AROUND_M more on each side."""
    x, y = key[0] * RASTER_M, key[1] * RASTER_M
    return x - AROUND_M, y - AROUND_M, x + RASTER_M + AROUND_M, y + RASTER_M + AROUND_M


def _chunks_of(mesh: StreetMesh, chunks: np.ndarray) -> StreetMesh:
    """Some chunks of a mesh as a mesh of its own."""
    # Without any chunk there are still arrays, of no numbers.
    none = np.arange(0)
    vertices = [none, *(np.arange(*mesh.chunk_vertices[c : c + 2]) for c in chunks)]
    faces = [none, *(np.arange(*mesh.chunk_faces[c : c + 2]) for c in chunks)]
    chunk_vertices = np.cumsum([len(part) for part in vertices]).astype(np.int32)
    chunk_faces = np.cumsum([len(part) for part in faces]).astype(np.int32)
    # The vertices of each chunk get lower numbers, all of them by as much.
    lower = np.repeat(mesh.chunk_vertices[chunks] - chunk_vertices[:-1], np.diff(chunk_faces))
    own = np.concatenate(faces)
    return StreetMesh(
        vertices_W_m=mesh.vertices_W_m[np.concatenate(vertices)],
        faces=(mesh.faces[own] - lower[:, None]).astype(np.int32),
        face_class=mesh.face_class[own],
        chunk_vertices=chunk_vertices,
        chunk_faces=chunk_faces,
    )

"""The triangles of a street: ground without gaps or slivers, kerb walls, mesh and raster."""

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from wcsim.core.constants import KERB_STEP_M
from wcsim.core.jit import compile_exact_kernel
from wcsim.towns.ground.kerb_heights import STEEPEST, Kerbing
from wcsim.towns.ground.plane_geometry import WHOLE_M, Patches, buffered, cross_z
from wcsim.towns.ground.solid_shapes import Solid, joined, triangles_of
from wcsim.towns.ground.surfaces import GRID_M, Surfaces
from wcsim.towns.ground.tiles import CELL_M, CHUNK_M, Box
from wcsim.types import F64, I32, U8, Bool, ClassId, Relief, StreetGrid, StreetMesh
from wcsim.types.street import AT_EDGE, FLAT

BLOCK_M = 5 * CHUNK_M  # of a large town that is cut at a time
BESIDE_M = 2.0
# A point goes whose triangle with its neighbours is smaller than half of this squared.
THIN_M = 0.06
LOW_CLASSES = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK)  # at the height of the road
_HAIR_M = 1e-6
_FAR_DM = 255
_EDGE_CELLS = 8.0  # farther kerbs are not measured
# Solid things so far outside a piece still count for its clearances, which end at 25.5 m.
_LOOK_M = 26.0
_SHIFT = 4  # bits of sub-cell precision for cv2


@dataclass(frozen=True, slots=True, kw_only=True)
class _GroundMesh:
    """Triangles of the ground, counter-clockwise from above.

    Low and raised ground have vertices of their own.
    """

    vertices_W_m: F64  # (V, 3)
    faces: I32  # (F, 3)
    face_class: U8  # (F,) ClassId
    low: Bool  # (F,) carriageway and crossings
    cell: I32  # (F, 2) the chunk that a face belongs to


def build_ground(surfaces: Surfaces, kerbing: Kerbing, relief: Relief = FLAT) -> _GroundMesh:
    """Cut, classify and triangulate the ground.

    Where the land is not level, no triangle crosses a fold of it.
    """
    # 1. Cut it along all borders.
    faces = _faces(surfaces, kerbing, relief)

    # 2. Classify the faces. A later area covers an earlier one; what no area covers is no ground.
    xy_m = shapely.get_coordinates(shapely.point_on_surface(faces))
    classes = np.zeros(len(xy_m), np.uint8)
    for area, class_id in (
        (surfaces.hull, ClassId.TERRAIN),
        (surfaces.paved, ClassId.GROUND),
        (surfaces.parking, ClassId.PARKING),
        (surfaces.pavement, ClassId.SIDEWALK),
        (surfaces.low, ClassId.ROAD),
        (surfaces.rail, ClassId.RAIL_TRACK),
        (surfaces.crossing, ClassId.CROSSWALK),
        (surfaces.unpainted, ClassId.ROAD),
    ):
        shapely.prepare(area)
        classes[shapely.contains_xy(area, xy_m)] = class_id
    inside = classes != ClassId.VOID
    faces, classes = faces[inside], classes[inside]

    # 3. Triangulate them.
    triangles, owner, twice_area = triangles_of(faces)
    triangles, face_class = triangles[twice_area > 0], classes[owner[twice_area > 0]]

    # 4. Share vertices. The raised side of a kerb has its own, so that a wall fits between.
    low = np.isin(face_class, LOW_CLASSES)
    keys = np.empty((len(triangles), 3, 3), dtype=np.int64)
    keys[:, :, :2] = np.rint(triangles / GRID_M)
    keys[:, :, 2] = ~low[:, None]
    unique, inverse = np.unique(keys.reshape(-1, 3), axis=0, return_inverse=True)
    indices = inverse.reshape(-1, 3).astype(np.int32)
    vertices = np.zeros((len(unique), 3))
    vertices[:, :2] = unique[:, :2] * GRID_M

    # 5. Raise what is raised.
    raised = unique[:, 2] == 1
    vertices[raised, 2] = kerbing.height_m(vertices[raised, :2])
    vertices[:, 2] = _limit_slopes(vertices, indices[~low])
    return _GroundMesh(
        vertices_W_m=vertices,
        faces=indices,
        face_class=face_class,
        low=low,
        cell=np.floor(triangles.mean(axis=1) / CHUNK_M).astype(np.int32),
    )


def kerb_walls(ground: _GroundMesh) -> tuple[F64, I32, I32]:
    """The walls between road and raised ground.

    The corners are those of the ground's own vertices, so nothing gapes. Where both sides are level
    there is no wall.

    Returns:
        Triangles (T, 3, 3), counter-clockwise seen from the road, their class (T,) and chunk
        (T, 2).
    """
    # 1. Find the edges that road and raised ground share. The other side runs the other way.
    road = _borders(ground, ground.low)
    bank = _borders(ground, ~ground.low)
    key_road, key_bank = _key(ground, road[:, :2]), _key(ground, bank[:, [1, 0]])
    _, at_road, at_bank = np.intersect1d(
        key_road, key_bank, assume_unique=False, return_indices=True
    )
    # 2. Leave out those that are level. The road is on the left of its edges, (K, 2, 3).
    foot = ground.vertices_W_m[road[at_road, :2]]
    top = ground.vertices_W_m[bank[at_bank][:, [1, 0]]]
    rise_m = top[:, :, 2] - foot[:, :, 2]
    walls = rise_m.max(axis=1) > 0.0
    foot, top, rise_m = foot[walls], top[walls], rise_m[walls]
    cell = ground.cell[road[at_road, 2]][walls]
    # 3. Make two triangles of each. A wall that runs out is one triangle.
    first = np.stack([foot[:, 1], foot[:, 0], top[:, 0]], axis=1)
    second = np.stack([foot[:, 1], top[:, 0], top[:, 1]], axis=1)
    lowered = rise_m.max(axis=1) <= KERB_STEP_M + _HAIR_M
    kind = np.where(lowered, ClassId.LOWERED_KERB, ClassId.KERB).astype(np.int32)
    flat = np.concatenate([rise_m[:, 0] <= 0.0, rise_m[:, 1] <= 0.0])
    triangles = np.concatenate([first, second])[~flat]
    return triangles, np.concatenate([kind, kind])[~flat], np.concatenate([cell, cell])[~flat]


def build_mesh(
    ground: _GroundMesh,
    walls: tuple[F64, I32, I32],
    large: list[Solid],
    small: list[Solid],
    relief: Relief = FLAT,
) -> StreetMesh:
    """One chunk for each ground cell with its kerbs, each large piece, and each cell's small ones.

    Ground and kerbs are lifted by the relief; the other pieces stand at their height already.
    """
    # 1. Lift ground and kerbs, and group their triangles (T, 3, 3) by cell.
    triangles = np.concatenate([ground.vertices_W_m[ground.faces], walls[0]])
    triangles[:, :, 2] += relief.at(triangles)
    classes = np.concatenate([ground.face_class, walls[1]]).astype(np.uint8)
    cells, owner = np.unique(np.concatenate([ground.cell, walls[2]]), axis=0, return_inverse=True)
    order = np.argsort(owner.reshape(-1), kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(owner.reshape(-1), minlength=len(cells)))[:-1])

    # 2. Make a piece of each group, in which shared corners are stored once.
    pieces: list[Solid] = []
    for group in groups:
        corners = triangles[group].reshape(-1, 3)
        vertices, index = np.unique(corners, axis=0, return_inverse=True)
        faces = index.reshape(-1, 3).astype(np.int32)
        pieces.append(Solid(vertices_W_m=vertices, faces=faces, face_class=classes[group]))

    # 3. Add what stands there.
    pieces += large
    beside: dict[tuple[int, int], list[Solid]] = defaultdict(list)
    for piece in small:
        x, y = np.floor(piece.vertices_W_m[:, :2].mean(axis=0) / CHUNK_M)
        beside[int(x), int(y)].append(piece)
    pieces += [joined(beside[cell]) for cell in sorted(beside)]
    vertex_counts = [0, *(len(piece.vertices_W_m) for piece in pieces)]
    return StreetMesh(
        vertices_W_m=np.concatenate([piece.vertices_W_m for piece in pieces]).astype(np.float32),
        faces=joined(pieces).faces,
        face_class=np.concatenate([piece.face_class for piece in pieces]),
        chunk_vertices=np.cumsum(vertex_counts).astype(np.int32),
        chunk_faces=np.cumsum([0, *(len(piece.faces) for piece in pieces)]).astype(np.int32),
    )


class GridMaker:
    """Draws pieces of one town's raster; finds the triangles and footprints of a piece quickly."""

    def __init__(
        self, ground: _GroundMesh, walls: F64, footprints: list[Polygon], relief: Relief
    ) -> None:
        # Seen from above, a wall's first two corners span its edge: (T, 2, 2).
        self._edges = walls[:, :2, :2]
        self._triangles = ground.vertices_W_m[ground.faces]  # (F, 3, 3), heights above the relief
        self._classes = ground.face_class
        corners = self._triangles[:, :, :2]
        self._low, self._high = corners.min(axis=1), corners.max(axis=1)
        self._footprints = footprints
        self._tree = shapely.STRtree(footprints)
        self._relief = relief

    def bounds(self) -> Box:
        """West, south, east, north of all ground, metres in W."""
        (west, south), (east, north) = self._low.min(axis=0), self._high.max(axis=0)
        return float(west), float(south), float(east), float(north)

    def piece(self, box: Box) -> StreetGrid:
        """The raster of a box with corners on whole cells; values are those at a cell's middle."""
        # 1. Fill it with the triangles near it, in cells: a cell's middle is an integer.
        origin_m = np.array(box[:2])
        sides_m = zip(box[:2], box[2:], strict=True)
        cols, rows = (round((high - low) / CELL_M) for low, high in sides_m)
        height_cm = np.zeros((rows, cols), np.uint8)
        ground_class = np.full((rows, cols), ClassId.VOID, dtype=np.uint8)
        near = ((self._low < box[2:]) & (self._high > box[:2])).all(axis=1)
        triangles = self._triangles[near]
        triangles[:, :, :2] = (triangles[:, :, :2] - origin_m) / CELL_M - 0.5
        _fill(triangles, self._classes[near], height_cm, ground_class)

        # 2. Measure to the nearest kerb. Values are `AT_EDGE` and more on raised ground.
        low = np.isin(ground_class, LOW_CLASSES)
        far_cells = np.full(low.shape, _EDGE_CELLS)
        edges = (self._edges - np.array(box[:2])) / CELL_M - 0.5
        reach = np.array(low.shape[::-1]) + _EDGE_CELLS
        near = ((edges.min(axis=1) < reach) & (edges.max(axis=1) > -_EDGE_CELLS)).all(axis=1)
        _near_edges(edges[near], far_cells)
        far_cm = np.floor(100.0 * CELL_M * far_cells)
        edge_cm = np.where(low, AT_EDGE - 1 - far_cm, AT_EDGE + far_cm).astype(np.uint8)
        return StreetGrid(
            origin_W_m=(float(origin_m[0]), float(origin_m[1])),
            cell_m=CELL_M,
            height_cm=height_cm,
            ground_class=ground_class,
            clearance_dm=self._clearance_dm(box, (rows, cols)),
            edge_cm=edge_cm,
            relief=self._relief,
        )

    def _clearance_dm(self, box: Box, shape: tuple[int, int]) -> U8:
        """Distance (rows, cols) from a cell's middle to something solid, rounded down."""
        wide = (box[0] - _LOOK_M, box[1] - _LOOK_M, box[2] + _LOOK_M, box[3] + _LOOK_M)
        near = [self._footprints[i] for i in np.sort(self._tree.query(shapely.box(*wide)))]
        if not near:
            return np.full(shape, _FAR_DM, dtype=np.uint8)
        edge = round(_LOOK_M / CELL_M)
        free = np.ones((shape[0] + 2 * edge, shape[1] + 2 * edge), dtype=np.uint8)
        for footprint in near:
            rings = [footprint.exterior, *footprint.interiors]
            cells = [(shapely.get_coordinates(ring) - wide[:2]) / CELL_M - 0.5 for ring in rings]
            outlines = [np.rint(ring * (1 << _SHIFT)).astype(np.int32) for ring in cells]
            cv2.fillPoly(free, outlines, 0, shift=_SHIFT)
        if free.all():
            return np.full(shape, _FAR_DM, dtype=np.uint8)
        # cv2 measures in 32-bit numbers.
        far_cells = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_5)
        inner_cells = far_cells[edge:-edge, edge:-edge]
        far_dm = np.minimum(inner_cells * np.float32(CELL_M * 10.0), _FAR_DM)
        return cast(U8, far_dm.astype(np.uint8))


def _faces(surfaces: Surfaces, kerbing: Kerbing, relief: Relief) -> np.ndarray:
    """Polygons between all boundaries, ramp rings, chunk borders and folds of the land."""
    # 1. Collect the lines.
    areas = [surfaces.low, surfaces.crossing, surfaces.pavement, surfaces.rail, surfaces.hull]
    areas += [surfaces.unpainted, surfaces.paved, surfaces.parking]
    lines = [area.boundary for area in areas if not area.is_empty]
    for place in kerbing.lowered:
        ramp = buffered(place.lines, place.ramp_m, quad_segs=3)
        lines.append(ramp.boundary.difference(surfaces.low))
    x0, y0, x1, y1 = surfaces.hull.bounds
    sides_m = ((x0, x1), (y0, y1))
    xs, ys = (
        np.arange(np.ceil(low / CHUNK_M), np.floor(high / CHUNK_M) + 1) * CHUNK_M
        for low, high in sides_m
    )
    chunks = [[(x, y0 - 1), (x, y1 + 1)] for x in xs] + [[(x0 - 1, y), (x1 + 1, y)] for y in ys]
    lines.append(shapely.MultiLineString(chunks).intersection(surfaces.hull))
    if relief is not FLAT:
        lines.append(_folds(surfaces.hull, relief))

    # 2. Cut a small town as a whole.
    if max(x1 - x0, y1 - y0) <= WHOLE_M:
        return np.asarray(shapely.coverage_simplify(_between(lines), THIN_M))

    # 3. Cut a large one in squares. Their borders are those of chunks, at which neighbours have the
    # same points.
    patches = [Patches(line) for line in lines]
    corners = [
        np.arange(np.floor(low / BLOCK_M), np.ceil(high / BLOCK_M)) * BLOCK_M
        for low, high in sides_m
    ]
    blocks: list[np.ndarray] = []
    for x in corners[0]:
        for y in corners[1]:
            around = (x - BESIDE_M, y - BESIDE_M, x + BLOCK_M + BESIDE_M, y + BLOCK_M + BESIDE_M)
            faces = _between([line.near(around) for line in patches])
            middles_m = shapely.get_coordinates(shapely.point_on_surface(faces))
            square = np.floor(middles_m / BLOCK_M) * BLOCK_M
            own = faces[(square == (x, y)).all(axis=1)] if len(faces) else faces
            if len(own):
                own = np.asarray(shapely.coverage_simplify(own, THIN_M, simplify_boundary=False))
            blocks.append(own)
    return np.concatenate(blocks)


def _between(lines: list[BaseGeometry]) -> np.ndarray:
    """The polygons between lines."""
    noded = shapely.unary_union(lines, grid_size=GRID_M)
    return np.asarray(shapely.get_parts(shapely.polygonize(shapely.get_parts(noded))))


def _folds(hull: BaseGeometry, relief: Relief) -> BaseGeometry:
    """The lines along which the land may bend: its lattice, with diagonals from the lower left."""
    rows, cols = relief.z_m.shape
    x0, y0 = relief.origin_W_m
    x1, y1 = x0 + (cols - 1) * relief.cell_m, y0 + (rows - 1) * relief.cell_m
    xs, ys = x0 + relief.cell_m * np.arange(cols), y0 + relief.cell_m * np.arange(rows)
    lines = [[(x, y0), (x, y1)] for x in xs] + [[(x0, y), (x1, y)] for y in ys]
    for shift in range(1 - rows, cols - 1):
        first, last = max(0, shift), min(cols - 1, rows - 1 + shift)
        lines.append([(xs[first], ys[first - shift]), (xs[last], ys[last - shift])])
    return shapely.MultiLineString(lines).intersection(hull)


def _limit_slopes(vertices: F64, faces: I32) -> F64:
    """Heights (V,) lowered until no face is steeper than a ramp.

    A thin face may tilt though its corners are right.
    """
    height_m = vertices[:, 2].copy()
    a, b = (vertices[faces[:, k], :2] - vertices[faces[:, 0], :2] for k in (1, 2))
    twice_area = cross_z(a, b)
    for _ in range(300):
        h = height_m[faces]
        u, w = h[:, 1] - h[:, 0], h[:, 2] - h[:, 0]
        slope = np.hypot(u * b[:, 1] - w * a[:, 1], w * a[:, 0] - u * b[:, 0]) / twice_area
        steep = slope > STEEPEST
        if not steep.any():
            break
        foot = h[steep].min(axis=1, keepdims=True)
        eased = foot + (h[steep] - foot) * (0.98 * STEEPEST / slope[steep])[:, None]
        np.minimum.at(height_m, faces[steep], eased)
    return np.round(height_m, 5)


def _borders(ground: _GroundMesh, chosen: np.ndarray) -> I32:
    """Directed edges (E, 3) of the chosen faces that no other one shares: start, end, face."""
    faces = ground.faces[chosen]
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    owner = np.repeat(np.flatnonzero(chosen), 3)
    size = len(ground.vertices_W_m)
    forward = edges[:, 0].astype(np.int64) * size + edges[:, 1]
    backward = edges[:, 1].astype(np.int64) * size + edges[:, 0]
    alone = ~np.isin(forward, backward)
    return np.column_stack([edges[alone], owner[alone]]).astype(np.int32)


def _key(ground: _GroundMesh, edges: I32) -> I32:
    """One number for each directed edge, from where its ends lie in the plane."""
    xy_cm = np.rint(ground.vertices_W_m[:, :2] * 100.0).astype(np.int64)
    _, place = np.unique(xy_cm, axis=0, return_inverse=True)
    place = place.reshape(-1).astype(np.int64)
    return place[edges[:, 0]] * (int(place.max()) + 1) + place[edges[:, 1]]


@compile_exact_kernel
def _near_edges(edges: F64, far: F64) -> None:
    """Lower each cell's distance to that of the nearest of `edges` (n, 2, 2), all in cells."""
    rows, cols = far.shape
    for e in range(len(edges)):
        (ax, ay), (bx, by) = edges[e, 0], edges[e, 1]
        square = max((bx - ax) ** 2 + (by - ay) ** 2, 1e-12)
        first_row, last_row = int(min(ay, by) - _EDGE_CELLS), int(max(ay, by) + _EDGE_CELLS) + 1
        first_col, last_col = int(min(ax, bx) - _EDGE_CELLS), int(max(ax, bx) + _EDGE_CELLS) + 1
        for row in range(max(0, first_row), min(rows, last_row + 1)):
            for col in range(max(0, first_col), min(cols, last_col + 1)):
                along = ((col - ax) * (bx - ax) + (row - ay) * (by - ay)) / square
                along = min(max(along, 0.0), 1.0)
                off = math.hypot(col - ax - along * (bx - ax), row - ay - along * (by - ay))
                far[row, col] = min(far[row, col], off)


@compile_exact_kernel
def _fill(triangles: F64, classes: U8, height_cm: U8, ground_class: U8) -> None:
    """Write every cell whose middle lies in a triangle (borders belong to the later one)."""
    rows, cols = height_cm.shape
    for t in range(triangles.shape[0]):
        ax, ay, az = triangles[t, 0]
        bx, by, bz = triangles[t, 1]
        cx, cy, cz = triangles[t, 2]
        twice = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if twice <= 0.0:
            continue
        gx = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / twice
        gy = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / twice
        first = max(0, int(np.ceil(min(ay, by, cy))))
        last = min(rows - 1, int(np.floor(max(ay, by, cy))))
        for row in range(first, last + 1):
            low, high = 1e18, -1e18
            for k in range(3):
                px, py = triangles[t, k, 0], triangles[t, k, 1]
                qx, qy = triangles[t, (k + 1) % 3, 0], triangles[t, (k + 1) % 3, 1]
                if (py <= row <= qy) or (qy <= row <= py):
                    if py == qy:
                        low, high = min(low, px, qx), max(high, px, qx)
                    else:
                        x = px + (row - py) * (qx - px) / (qy - py)
                        low, high = min(low, x), max(high, x)
            for col in range(max(0, int(np.ceil(low))), min(cols - 1, int(np.floor(high))) + 1):
                z = az + gx * (col - ax) + gy * (row - ay)
                height_cm[row, col] = int(max(0.0, min(255.0, np.round(100.0 * z))))
                ground_class[row, col] = classes[t]

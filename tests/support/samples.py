"""A small synthetic street for tests: no SUMO, no files.

A road 8 m wide runs along x from 0 to 80 m (|y| < 4), pavements 3 m wide on both sides (4 < |y| < 7), terrain beyond,
kerb 0.12 m, lowered to 0 at a crossing at 38 < x < 42 (ramps 1:12), a house 20 m long behind the north pavement, a
pole on it.
"""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from wcsim.supervisor.actions import action_set
from wcsim.types import (
    F64,
    ClassId,
    OneTile,
    Outline,
    Route,
    Street,
    StreetGrid,
    StreetMesh,
    WalkEdge,
    WalkGraph,
    WayKind,
)

KERB_M = 0.12
ACTIONS = action_set("square81")
USUAL_OUTLINE = Outline(length_m=1.135, width_m=0.62, height_m=1.25, middle_x_m=0.2325)  # of plant rwd
X_M = np.array([-20.0, 0.0, 20.0, 36.56, 38.0, 42.0, 43.44, 60.0, 80.0, 100.0])
CELL_M = 0.1


def pavement_height_m(x_m: float) -> float:
    """Height of the pavement's road-side edge at x: 0 on the crossing, KERB_M beyond the ramps."""
    distance = max(38.0 - x_m, x_m - 42.0, 0.0)
    return min(KERB_M, distance / 12.0)


def strip_street() -> Street:
    """The street described above."""
    parts: list[tuple[np.ndarray, np.ndarray, int]] = []

    def quad(a, b, c, d, cls):
        parts.append((np.array([a, b, c, d], np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32), int(cls)))

    for x0, x1 in itertools.pairwise(X_M):
        crossing = 38.0 <= x0 < 42.0
        h0, h1 = pavement_height_m(x0), pavement_height_m(x1)
        quad((x0, -4, 0), (x1, -4, 0), (x1, 4, 0), (x0, 4, 0), ClassId.CROSSWALK if crossing else ClassId.ROAD)
        for side in (1, -1):

            def strip(y0, y1, za0, za1, zb0, zb1, cls, side=side, x0=x0, x1=x1):
                near0, near1 = (x0, side * y0, za0), (x1, side * y0, za1)
                far0, far1 = (x0, side * y1, zb0), (x1, side * y1, zb1)
                if side > 0:
                    quad(near0, near1, far1, far0, cls)
                else:
                    quad(near1, near0, far0, far1, cls)

            strip(4, 5.44, h0, h1, KERB_M, KERB_M, ClassId.SIDEWALK)
            strip(5.44, 7, KERB_M, KERB_M, KERB_M, KERB_M, ClassId.SIDEWALK)
            strip(7, 27, KERB_M, KERB_M, KERB_M, KERB_M, ClassId.TERRAIN)
            if h0 > 0 or h1 > 0:
                kerb = ClassId.KERB if min(h0, h1) >= KERB_M else ClassId.LOWERED_KERB
                low0, low1, top1, top0 = (x0, side * 4, 0), (x1, side * 4, 0), (x1, side * 4, h1), (x0, side * 4, h0)
                quad(*((low0, low1, top1, top0) if side > 0 else (low1, low0, top0, top1)), kerb)
    parts.append(_box((50.0, 9.0, 0.12), (70.0, 19.0, 9.0), ClassId.BUILDING))
    parts.append(_box((25.0, 6.6, 0.12), (25.2, 6.8, 5.0), ClassId.POLE))
    return Street(tiles=OneTile(_mesh(parts)), grid=_grid(), walk=strip_walk())


def _box(low, high, cls):
    sides = zip(low, high, strict=True)
    v = np.array(list(itertools.product(*sides)), np.float32)
    f = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [1, 5, 7], [1, 7, 3]]
    return v, np.array(f, np.int32), int(cls)


def _mesh(parts) -> StreetMesh:
    cv = np.cumsum([0, *[len(v) for v, _, _ in parts]]).astype(np.int32)
    cf = np.cumsum([0, *[len(f) for _, f, _ in parts]]).astype(np.int32)
    return StreetMesh(
        vertices_W_m=np.concatenate([v for v, _, _ in parts]),
        faces=np.concatenate([f + o for (_, f, _), o in zip(parts, cv, strict=False)]).astype(np.int32),
        face_class=np.concatenate([np.full(len(f), c, np.uint8) for _, f, c in parts]),
        chunk_vertices=cv,
        chunk_faces=cf,
    )


def cell_middles(grid: StreetGrid) -> tuple[F64, F64]:
    """x and y of the middles of a grid's cells."""
    rows, cols = np.indices(grid.height_cm.shape)
    return (cols + 0.5) * grid.cell_m + grid.origin_W_m[0], (rows + 0.5) * grid.cell_m + grid.origin_W_m[1]


def stacked(observations: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """A batch of observations."""
    return {key: np.stack([each[key] for each in observations]) for key in observations[0]}


def _grid() -> StreetGrid:
    x0, y0 = -20.0, -27.0
    xs, ys = x0 + CELL_M * (np.arange(1200) + 0.5), y0 + CELL_M * (np.arange(540) + 0.5)
    gx, gy = np.meshgrid(xs, ys)
    side = np.abs(gy)
    ramp = np.minimum(KERB_M, np.maximum(np.maximum(38.0 - gx, gx - 42.0), 0.0) / 12.0)
    height = np.where(side < 4, 0.0, np.maximum(ramp, np.minimum(KERB_M, (side - 4) / 12.0)))
    cls = np.where(side < 4, ClassId.ROAD, np.where(side < 7, ClassId.SIDEWALK, ClassId.TERRAIN))
    cls = np.where((side < 4) & (gx > 38) & (gx < 42), ClassId.CROSSWALK, cls)
    house = np.hypot(np.maximum(np.maximum(50 - gx, gx - 70), 0), np.maximum(np.maximum(9 - gy, gy - 19), 0))
    pole = np.hypot(np.maximum(np.abs(gx - 25.1) - 0.1, 0), np.maximum(np.abs(gy - 6.7) - 0.1, 0))
    clear = np.clip(np.minimum(house, pole) * 10.0, 0, 255)
    return StreetGrid(
        origin_W_m=(x0, y0),
        cell_m=CELL_M,
        height_cm=np.rint(height * 100).astype(np.uint8),
        ground_class=cls.astype(np.uint8),
        clearance_dm=clear.astype(np.uint8),
    )


def strip_walk() -> WalkGraph:
    """Both pavements and the crossing between them."""
    nodes = np.array([[0, 5.5], [40, 5.5], [80, 5.5], [0, -5.5], [40, -5.5], [80, -5.5]], float)

    def edge(name, kind, a, b):
        return WalkEdge(sumo_id=name, kind=kind, start=a, end=b, points_W_m=nodes[[a, b]], width_m=3.0)

    s, c = WayKind.SIDEWALK, WayKind.CROSSING
    edges = (edge("n0", s, 0, 1), edge("n1", s, 1, 2), edge("s0", s, 3, 4), edge("s1", s, 4, 5), edge("c", c, 1, 4))
    return WalkGraph(nodes_W_m=nodes, edges=edges)


def straight_route(y_m: float = 5.5) -> Route:
    """Along the northern pavement from x = 0 to 80 m."""
    xs = np.linspace(0.0, 80.0, 41)
    return Route(points_W_m=np.c_[xs, np.full(41, y_m)], arc_m=xs, edge_index=np.where(xs < 40, 0, 1).astype(np.int32))


def write_recording(path: Path, time_s: F64, sticks: F64) -> None:
    """A joystick (n, 2) over time (n,) as a table that `recorded:FILE` takes."""
    rows = [f"{t!r},{x!r},{y!r}\n" for t, (x, y) in zip(time_s.round(6).tolist(), sticks.tolist(), strict=True)]
    path.write_text("time_s,x,y\n" + "".join(rows))

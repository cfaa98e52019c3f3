"""The lie of the land, from the heights of a net: SUMO's slopes and the wheels share it.

A lattice runs close by the heights of all lanes, and bends as little as possible elsewhere. Where
one way passes over another, the lower one is the land, and the upper one is no ground.
"""

from dataclasses import dataclass, replace

import numpy as np
import shapely

from wcsim.towns.sumo.net import Lane, LaneKind, Net
from wcsim.types import F64, I32, Bool, Relief
from wcsim.types.street import FLAT

# Shorter pieces say nothing about a grade: coordinates are rounded to a centimetre.
SHORTEST_M = 0.5
CELL_M = 8.0  # a whole fraction of a ground chunk, so that both share their borders
REACH_M = 48.0  # of the lattice beyond the outermost street
_SAMPLE_M = 4.0  # along lanes
OVER_M = 2.5  # a way this much above another one at the same place is a bridge
BESIDE_M = 3.0  # samples of two ways that cross come as near to each other
BRIDGE_M = 40.0  # this far to both sides of where it passes over the other
_OFF_M = 2.0  # parts of bridges farther than this from the land are no ground
# No street is as steep: netconvert makes such heights on very short edges.
_ABSURD = 0.35
_STIFF_M3 = 60.0  # weight of bending against a metre of lane
LEVEL_M = 300.0  # the land turns level over this distance where no street holds it
AT_ONCE = 100_000  # samples
FAR_M = 1e6  # longer than any way
STEPS = 60  # of conjugate gradients a level


@dataclass(frozen=True, slots=True, kw_only=True)
class _Samples:
    """Points along all ways of a net."""

    p_m: F64  # (n, 2)
    z_m: F64  # (n,)
    weight_m: F64  # (n,) metres of way that it stands for, less where its height is absurd
    way: I32  # (n,) number of the way
    arc_m: F64  # (n,) distance along it


def fit_relief(net: Net) -> Relief:
    """The land of a net; `FLAT` where the net states no heights, or the same one everywhere."""
    # 1. Take the heights of all ways but the bridges.
    ways = _ways(net)
    if not any(way.z_m.any() for way in ways):
        return FLAT
    samples = _samples(ways)
    low = ~_on_bridge(samples)
    p_m, z_m, weight_m = samples.p_m[low], samples.z_m[low], samples.weight_m[low]

    # 2. Begin with a level land.
    origin_m = np.floor((samples.p_m.min(axis=0) - REACH_M) / CELL_M) * CELL_M
    cols, rows = np.ceil((samples.p_m.max(axis=0) + REACH_M - origin_m) / CELL_M).astype(int) + 1
    place = (float(origin_m[0]), float(origin_m[1]))
    level = np.full((2, 2), np.average(z_m, weights=weight_m), np.float32)
    land = Relief(origin_W_m=place, cell_m=CELL_M, z_m=level)

    # 3. Fit ever finer lattices. Each begins with the coarser one, so few gradients are enough.
    steps = [2**k for k in range(12) if k == 0 or 2 ** (k + 2) <= max(rows, cols)]
    for step in reversed(steps):
        shape = (-(-(rows - 1) // step) + 1, -(-(cols - 1) // step) + 1)
        cell_m = CELL_M * step
        nodes = np.stack(np.meshgrid(np.arange(shape[1]), np.arange(shape[0])), axis=-1)
        guess_m = land.at(place + cell_m * nodes)
        # The three lattice corners around each point, and their shares; cells as in `Relief.at`.
        at = (p_m - place) / cell_m
        cell = np.clip(at.astype(int), 0, (shape[1] - 2, shape[0] - 2))
        u, v = (np.clip(at - cell, 0.0, 1.0)).T
        first = cell[:, 1] * shape[1] + cell[:, 0]
        second = first + np.where(u >= v, 1, shape[1])
        corners = np.stack([first, second, first + shape[1] + 1], axis=1).astype(np.int32)
        big, small = np.maximum(u, v), np.minimum(u, v)
        share = np.stack([1.0 - big, big - small, small], axis=1)
        fitted = _fitted(guess_m, cell_m, corners, share, z_m, weight_m)
        land = Relief(origin_W_m=place, cell_m=cell_m, z_m=fitted.astype(np.float32))
    return replace(land, z_m=np.round(land.z_m, 3))


def on_land(net: Net, relief: Relief) -> Net:
    """The same net without the parts of bridges that lie far above or below the land."""
    # 1. Find the samples that are off the land.
    ways = _ways(net)
    if relief is FLAT:
        return net
    samples = _samples(ways)
    off = _on_bridge(samples) & (np.abs(samples.z_m - relief.at(samples.p_m)) > _OFF_M)
    if not off.any():
        return net

    # 2. Cut their ways. A walking area goes as a whole, as its shape is an outline.
    pieces: dict[int, list[Lane]] = {}
    for number in set(samples.way[off].tolist()):
        way, own = ways[number], samples.way == number
        found = pieces[id(way)] = []
        if way.kind is LaneKind.WALKINGAREA:
            continue
        good = np.diff(np.r_[False, ~off[own], False].astype(int))
        p_m, z_m = samples.p_m[own], samples.z_m[own]
        for a, b in zip(np.flatnonzero(good > 0), np.flatnonzero(good < 0), strict=True):
            if b - a > 1:
                found.append(replace(way, points_m=p_m[a:b], z_m=z_m[a:b]))
    edges = []
    for edge in net.edges:
        lanes = tuple(piece for lane in edge.lanes for piece in pieces.get(id(lane), [lane]))
        edges.append(replace(edge, lanes=lanes))

    # 3. Empty the junctions that lie up there.
    junctions = []
    for j in net.junctions:
        high = j.z_m.size > 0 and np.abs(j.z_m - relief.at(j.outline_m)).min() > _OFF_M
        junctions.append(replace(j, outline_m=j.outline_m[:0], z_m=j.z_m[:0]) if high else j)
    return replace(net, edges=tuple(edges), junctions=tuple(junctions))


def steepest_grade(net: Net) -> float:
    """The largest rise over run along any lane of a net."""
    lanes = net.every_lane
    runs_m = [np.hypot(*np.diff(lane.points_m, axis=0).T) for lane in lanes]
    return steepest_run([lane.z_m for lane in lanes], runs_m, [True] * len(lanes))


def steepest_run(heights_m: list[F64], runs_m: list[F64], driven: list[bool]) -> float:
    """The largest rise over run of those lines that are driven.

    Args:
        heights_m: Of each line, (n,).
        runs_m: The lengths between these, (n - 1,).
        driven: Whether a line counts.
    """
    worst = 0.0
    for z_m, run_m, counts in zip(heights_m, runs_m, driven, strict=True):
        if counts and len(run_m):
            grades = np.abs(np.diff(z_m)) / np.maximum(run_m, SHORTEST_M)
            worst = max(worst, float(grades.max()))
    return worst


def _ways(net: Net) -> list[Lane]:
    return [lane for lane in net.every_lane if lane.is_line]


def _samples(ways: list[Lane]) -> _Samples:
    """Points every few metres along all ways, corners among them."""
    parts: list[F64] = []
    for way in ways:
        step_m = np.hypot(*np.diff(way.points_m, axis=0).T)
        corner_m = np.r_[0.0, np.cumsum(step_m)]
        at_m = np.linspace(0.0, corner_m[-1], 2 + int(corner_m[-1] // _SAMPLE_M))
        grade = np.abs(np.diff(way.z_m)) / np.maximum(step_m, 1e-6)
        absurd = grade[np.clip(np.searchsorted(corner_m, at_m) - 1, 0, len(grade) - 1)] > _ABSURD
        columns = [np.interp(at_m, corner_m, column) for column in (*way.points_m.T, way.z_m)]
        weight_m = corner_m[-1] / len(at_m) * np.where(absurd, 0.02, 1.0) + 1e-3
        parts.append(np.stack([*columns, weight_m, at_m]))
    x, y, z_m, weight, arc_m = np.concatenate(parts, axis=1)
    owner = np.repeat(np.arange(len(ways), dtype=np.int32), [part.shape[1] for part in parts])
    return _Samples(p_m=np.stack([x, y], axis=1), z_m=z_m, weight_m=weight, way=owner, arc_m=arc_m)


def _on_bridge(samples: _Samples) -> Bool:
    """Which samples (n,) lie on a way near a place where it passes over another one, or itself."""
    # 1. Find the samples that lie above another one.
    places = shapely.points(samples.p_m)
    tree = shapely.STRtree(places)
    over: list[I32] = []
    for start in range(0, len(places), AT_ONCE):
        some = places[start : start + AT_ONCE]
        upper, lower = tree.query(some, predicate="dwithin", distance=BESIDE_M)
        tall = samples.z_m[upper + start] - samples.z_m[lower] > OVER_M
        over.append((upper[tall] + start).astype(np.int32))

    # 2. Mark their ways to both sides. The key is ascending, as ways follow each other.
    key_m = samples.way * FAR_M + samples.arc_m
    here_m = key_m[np.unique(np.concatenate(over))]
    ends = np.zeros(len(places) + 1, np.int64)
    np.add.at(ends, np.searchsorted(key_m, here_m - BRIDGE_M), 1)
    np.add.at(ends, np.searchsorted(key_m, here_m + BRIDGE_M), -1)
    return np.cumsum(ends)[:-1] > 0


def _fitted(z: F64, cell_m: float, corners: I32, share: F64, height_m: F64, weight_m: F64) -> F64:
    """The lattice (rows, cols) of least squares, by conjugate gradients from a first guess."""
    flat, weighted = corners.reshape(-1), share * weight_m[:, None]

    def spread(values: F64) -> F64:
        return _counted(flat, weighted * values[:, None], z.shape)

    def gradient(field: F64) -> F64:
        return spread((field.reshape(-1)[corners] * share).sum(axis=1)) + _stiffness(field, cell_m)

    scale = 1.0 / (_counted(flat, weighted * share, z.shape) + 20.0 * _STIFF_M3 / cell_m**2)
    rest = spread(height_m) - gradient(z)
    step = scale * rest
    power = float((rest * step).sum())
    for _ in range(STEPS):
        if power < 1e-9:
            break
        pushed = gradient(step)
        length = power / float((step * pushed).sum())
        z = z + length * step
        rest = rest - length * pushed
        fresh = scale * rest
        power, before = float((rest * fresh).sum()), power
        step = fresh + (power / before) * step
    return z


def _counted(nodes: I32, values: F64, shape: tuple[int, ...]) -> F64:
    """Sums of values, node by node of a lattice."""
    sums = np.bincount(nodes, values.reshape(-1), minlength=shape[0] * shape[1])
    return sums.astype(np.float64).reshape(shape)


def _stiffness(z: F64, cell_m: float) -> F64:
    """How bending and, much weaker, slope pull at the lattice's nodes (rows, cols)."""
    bend, level = _STIFF_M3 / cell_m**2, _STIFF_M3 / LEVEL_M**2
    pull = np.zeros_like(z)
    for field, out in ((z, pull), (z.T, pull.T)):
        slope = level * (field[1:] - field[:-1])
        out[1:] += slope
        out[:-1] -= slope
        if len(field) > 2:
            curve = bend * (field[2:] - 2.0 * field[1:-1] + field[:-2])
            out[2:] += curve
            out[1:-1] -= 2.0 * curve
            out[:-2] += curve
    twist = 2.0 * bend * (z[1:, 1:] - z[1:, :-1] - z[:-1, 1:] + z[:-1, :-1])
    pull[1:, 1:] += twist
    pull[1:, :-1] -= twist
    pull[:-1, 1:] -= twist
    pull[:-1, :-1] += twist
    return pull

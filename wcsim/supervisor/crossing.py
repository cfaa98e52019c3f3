"""Crossing a road: where the route does it, whether the light allows it, whether a vehicle comes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wcsim.types import F64, ActorState, Route, SignalState, WalkEdge, WalkGraph, WayKind

GAP_S = 3.0  # a vehicle that comes nearer than this in time is waited for
START_S, CROSSING_MPS = 1.5, 1.1  # how a chair at the kerb gets over the road
SIDE_M = 1.2  # added to half the vehicle's width: how near it must come to count
MOVING_MPS = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """A stretch of the route over a road."""

    start_m: float  # arc on the route
    end_m: float
    start_W_m: tuple[float, float]
    end_W_m: tuple[float, float]
    tls_id: str
    tls_links: tuple[int, ...]


def crossings(route: Route, walk: WalkGraph) -> tuple[Crossing, ...]:
    """The crossings on a route, in order; pieces of one crossing edge are one crossing."""
    found: list[Crossing] = []
    index = route.edge_index.tolist()
    arc = route.arc_m.tolist()
    points = [(float(x), float(y)) for x, y in route.points_W_m[:, :2].tolist()]
    i = 0
    while i < len(index) - 1:
        edge = walk.edges[index[i]]
        j = i + 1
        while j < len(index) - 1 and index[j] == index[i]:
            j += 1
        if edge.kind is WayKind.CROSSING and arc[j] > arc[i]:
            found.append(
                Crossing(
                    start_m=arc[i],
                    end_m=arc[j],
                    start_W_m=points[i],
                    end_W_m=points[j],
                    tls_id=edge.tls_id,
                    tls_links=edge.tls_links,
                )
            )
        i = j
    return tuple(found)


def is_red(crossing: Crossing | WalkEdge, signals: Iterable[SignalState]) -> bool:
    """Whether the pedestrian signal forbids to start; without a signal, or with it switched off, it never does."""
    for signal in signals:
        if signal.tls_id == crossing.tls_id and crossing.tls_id:
            colours = [signal.colours[link] for link in crossing.tls_links if link < len(signal.colours)]
            return any(colour in "rRyYu" for colour in colours)
    return False


def has_light(crossing: Crossing, signals: Iterable[SignalState]) -> bool:
    """Whether a signal that is switched on governs the crossing."""
    for signal in signals:
        if signal.tls_id == crossing.tls_id and crossing.tls_id:
            return any(signal.colours[i] in "rRyYuGg" for i in crossing.tls_links if i < len(signal.colours))
    return False


def vehicle_comes(crossing: Crossing, vehicles: Iterable[ActorState]) -> bool:
    """Whether a vehicle, driving on as it does, comes too near to a chair that starts to cross now.

    Too near: it is somewhere on the crossing within the next `GAP_S` seconds, or within `GAP_S` of the moment at which
    the chair gets to that place.
    """
    length_m = math.dist(crossing.start_W_m, crossing.end_W_m)
    needed_s = START_S + length_m / CROSSING_MPS
    later_s = np.arange(0.0, needed_s + GAP_S, 0.25)  # (T,)
    for vehicle in vehicles:
        v: F64 = vehicle.v_W_mps[:2]
        speed = float(np.hypot(v[0], v[1]))
        if speed < MOVING_MPS:
            continue
        ends_m = 0.5 * vehicle.size_lwh_m[0] / speed * np.array([-1.0, 0.0, 1.0])[:, None] * v  # tail, middle, nose
        points = vehicle.p_W_m[:2] + later_s[:, None, None] * v + ends_m  # (T, 3, 2)
        share, distance_m = _beside(points, np.array(crossing.start_W_m), np.array(crossing.end_W_m))
        there_s = START_S + share * length_m / CROSSING_MPS
        when_s = np.broadcast_to(later_s[:, None], share.shape)
        close = (when_s < GAP_S) | (np.abs(when_s - there_s) < GAP_S)
        if (close & (distance_m < 0.5 * vehicle.size_lwh_m[1] + SIDE_M)).any():
            return True
    return False


def _beside(points: F64, start: F64, end: F64) -> tuple[F64, F64]:
    """Where along the stretch (0..1) points (..., 2) are nearest to it, and how far from it."""
    along = end - start
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    off = points - start - share[..., None] * along
    return share, np.hypot(off[..., 0], off[..., 1])

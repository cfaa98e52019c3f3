"""Cameras and actors put on a street by chance, without SUMO: scenes for benchmarks and pictures of a bare town."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wcsim.config import CameraConfig
from wcsim.core import seeding
from wcsim.errors import ConfigError
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pose_of
from wcsim.types import F64, ActorKind, ActorState, ClassId, Ground, Street, WalkGraph, WayKind

RADIUS_M = 45.0
_PEDESTRIAN_SHARE = 0.6
CELL_M = 0.1
CLEAR_M = 1.5  # distance of a vehicle's middle from walls and poles
_ROAD_KINDS: tuple[tuple[ActorKind, tuple[float, float, float]], ...] = (
    (ActorKind.CAR, (4.6, 1.8, 1.5)),
    (ActorKind.CAR, (4.2, 1.75, 1.45)),
    (ActorKind.CAR, (5.0, 1.9, 1.6)),
    (ActorKind.BICYCLE, (1.6, 0.65, 1.7)),
    (ActorKind.TRUCK, (7.1, 2.4, 2.4)),
    (ActorKind.BUS, (12.0, 2.5, 3.4)),
    (ActorKind.SCOOTER, (1.2, 0.5, 1.7)),
    (ActorKind.MOTORCYCLE, (2.2, 0.9, 1.5)),
)
_PERSON_LWH_M = (0.215, 0.478, 1.719)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Cameras on pavements around one place, and actors within RADIUS_M of it."""

    places: tuple[tuple[F64, float], ...]  # where the chairs stand (3,), and their yaw
    poses: tuple[F64, ...]  # world to camera, (3, 4) each
    actors: tuple[ActorState, ...]


def scatter(street: Street, camera: CameraConfig, poses: int, actors: int, seed: int) -> Scene:
    """Put chairs' cameras and actors around a place of the street that the seed chooses.

    Vehicles stand on the road and people on pavements, apart from each other and from the cameras.

    Raises:
        ConfigError: when the street has no pavement in its walk graph.
    """
    rng = seeding.make_rng(seed, "scatter")
    walks = [i for i, edge in enumerate(street.walk.edges) if edge.kind is WayKind.SIDEWALK]
    if not walks:
        raise ConfigError("this street has no pavement in its walk graph; choose another town")
    middles = np.array([street.walk.edges[i].points_W_m.mean(axis=0) for i in walks])
    centre = middles[rng.integers(len(middles))]
    away = np.hypot(*(middles - centre).T)
    near = [walks[i] for i in np.argsort(away, kind="stable")[: max(1, poses)]]
    places = [_on_edge(street, near[i % len(near)], rng) for i in range(poses)]
    mounted = mount(camera)
    matrices = tuple(camera_matrix(pose_of(p_W_m, yaw_rad, 0.0), mounted) for p_W_m, yaw_rad in places)
    taken = [(p_W_m[0], p_W_m[1], 0.8) for p_W_m, _ in places]
    return Scene(places=tuple(places), poses=matrices, actors=_actors(street, centre, actors, taken, rng))


def ground_m(grid: Ground, x_m: float, y_m: float) -> float:
    """Height of the ground at a point; the nearest cell's when it is off the grid."""
    return float(grid.height_at(np.array([x_m, y_m])))


def _on_edge(street: Street, index: int, rng: np.random.Generator) -> tuple[F64, float]:
    """A place (3,) on a piece of pavement and the direction along it."""
    points = street.walk.edges[index].points_W_m
    step = int(rng.integers(len(points) - 1))
    start, end = points[step], points[step + 1]
    x, y = start + rng.uniform(0.1, 0.9) * (end - start)
    yaw = math.atan2(end[1] - start[1], end[0] - start[0]) + (math.pi if rng.random() < 0.5 else 0.0)
    return np.array([x, y, ground_m(street.grid, x, y)]), yaw


def _actors(
    street: Street, centre: F64, count: int, taken: list[tuple[float, float, float]], rng: np.random.Generator
) -> tuple[ActorState, ...]:
    """Up to `count` actors; `taken` holds discs (x, y, radius) where nobody may stand, and grows."""
    grid = street.grid
    road = _cells(grid, centre, (ClassId.ROAD,), CLEAR_M)
    walk = _cells(grid, centre, (ClassId.SIDEWALK, ClassId.CROSSWALK), 0.4)
    out: list[ActorState] = []
    for number in range(4 * count):
        on_foot = bool(rng.random() < _PEDESTRIAN_SHARE)
        cells = walk if on_foot else road
        if len(out) == count or len(cells) == 0:
            continue
        kind, size = (ActorKind.PEDESTRIAN, _PERSON_LWH_M) if on_foot else _ROAD_KINDS[rng.integers(len(_ROAD_KINDS))]
        x, y = (float(value) for value in cells[rng.integers(len(cells))])
        radius = 0.5 * math.hypot(size[0], size[1])
        if any(math.hypot(x - ox, y - oy) < radius + other for ox, oy, other in taken):
            continue
        taken.append((x, y, radius))
        yaw = _along(street.walk, x, y) + (math.pi if rng.random() < 0.5 else 0.0)
        speed = 1.3 if on_foot else 6.0
        out.append(
            ActorState(
                id=f"scattered{number}",
                kind=kind,
                p_W_m=np.array([x, y, ground_m(grid, x, y)]),
                yaw_rad=yaw,
                pitch_rad=0.0,
                v_W_mps=speed * np.array([math.cos(yaw), math.sin(yaw), 0.0]),
                size_lwh_m=size,
            )
        )
    return tuple(out)


def _cells(grid: Ground, centre: F64, classes: tuple[ClassId, ...], clear_m: float) -> F64:
    """Middles (n, 2) of decimetre cells of these classes around a place, some distance from walls."""
    first = np.floor((centre - RADIUS_M) / CELL_M)
    steps = np.arange(round(2 * RADIUS_M / CELL_M)) + 0.5
    middles = np.stack(np.meshgrid(first[0] + steps, first[1] + steps), axis=-1).reshape(-1, 2) * CELL_M
    free = np.isin(grid.class_at(middles), classes) & (grid.clearance_at(middles) >= clear_m)
    return np.asarray(middles[free], np.float64)


def _along(walk: WalkGraph, x_m: float, y_m: float) -> float:
    """Direction of the piece of the walk graph that starts or ends nearest to a point: the street's direction there."""
    ends = walk.nodes_W_m[[[edge.start, edge.end] for edge in walk.edges]]  # (E, 2, 2)
    middle = ends.mean(axis=1)
    nearest = int(np.argmin(np.hypot(middle[:, 0] - x_m, middle[:, 1] - y_m)))
    step = ends[nearest, 1] - ends[nearest, 0]
    return math.atan2(float(step[1]), float(step[0]))

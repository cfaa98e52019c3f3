"""A town's street: mesh, grid and walk graph, built once and kept in a cache."""

from __future__ import annotations

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.towns.buildings import Building, buildings_of
from wcsim.towns.cache import cached_street, street_key
from wcsim.towns.furniture import BASE_M, Place, things_of
from wcsim.towns.grid import build_grid
from wcsim.towns.ground import build_ground, kerbing_of
from wcsim.towns.items import Item, read_items
from wcsim.towns.kerbs import kerb_walls
from wcsim.towns.mesh import build_mesh
from wcsim.towns.netread import LaneKind, Net, read_net
from wcsim.towns.shapes import Piece, prism
from wcsim.towns.surfaces import surfaces_of
from wcsim.towns.town import Town
from wcsim.towns.walkgraph import build_walk_graph, free_space
from wcsim.types import F64, ClassId, Street, WalkGraph

LOW_KERB_M = 0.03  # lower ones need no distance kept


def load_street(town: Town) -> Street:
    """The street of a town, from the cache where it is there. Raises TownError when the town cannot be used."""
    return cached_street(street_key(town), lambda: build_street(town))


def build_street(town: Town) -> Street:
    """Make the street of a town from its net and polygons, without any cache."""
    net = read_net(town.net, town.file.origin_m)
    surfaces = surfaces_of(net, town.file.chair_ways)
    kerbing = kerbing_of(surfaces, town.file.kerb_height_m, town.file.lowered_kerb_m)
    ground = build_ground(surfaces, kerbing)
    walls = kerb_walls(ground)
    items = [*read_items(town.additional, town.file.origin_m), *_signal_posts(net)]
    walkable = shapely.union_all([surfaces.pavement, surfaces.crossing])
    buildings = buildings_of(items, shapely.union_all([surfaces.low, surfaces.pavement]), surfaces.hull)
    blocks = shapely.union_all([building.outline for building in buildings])
    walk = build_walk_graph(net, free_space(walkable, _kerb_lines(walls[0]), blocks), town.file.chair_ways)
    place = Place(low=surfaces.low.buffer(0.1), solids=blocks.buffer(0.05), lines=_lines(walk), hull=surfaces.hull)
    things = things_of(items, place)
    large = [_block(building, town.file.kerb_height_m) for building in buildings]
    return Street(
        mesh=build_mesh(ground, walls, large, [thing.piece for thing in things]),
        grid=build_grid(ground, [*(b.outline for b in buildings), *(thing.footprint for thing in things)]),
        walk=walk,
    )


def _block(building: Building, ground_m: float) -> Piece:
    return prism(building.outline, BASE_M, ground_m + building.height_m, ClassId.BUILDING)


def _kerb_lines(walls: F64) -> BaseGeometry:
    """The edges of all kerbs that a wheel should not drop off."""
    high = walls[walls[:, :, 2].max(axis=1) > LOW_KERB_M]
    foot = high[:, :2, :2]  # a wall triangle's first two corners span its edge, seen from above
    return shapely.union_all(shapely.linestrings(foot)) if len(foot) else shapely.MultiLineString()


def _lines(walk: WalkGraph) -> BaseGeometry:
    return shapely.MultiLineString([edge.points_W_m for edge in walk.edges])


def _signal_posts(net: Net) -> list[Item]:
    """A post at the right-hand end of each crossing that has a signal."""
    lights = {link.end for link in net.connections if link.tls_id}
    posts: list[Item] = []
    for lane in net.lanes(LaneKind.CROSSING):
        if lane.edge_id in lights and len(lane.points_m) > 1:
            for end, inner in ((0, 1), (-1, -2)):
                along = lane.points_m[end] - lane.points_m[inner]
                along = along / max(1e-6, float(np.hypot(*along)))
                place = lane.points_m[end] + 0.4 * along + (0.5 * lane.width_m + 0.3) * np.array([along[1], -along[0]])
                posts.append(
                    Item(id=lane.id, kind="traffic_signals", detail="", points_W_m=place[None], filled=False, tags={})
                )
    return posts

"""Makes a town's street: mesh, grid and walk graph.

All that this file imports, and that imports, makes the street.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.core.constants import KERB_STEP_M
from wcsim.errors import TownError
from wcsim.towns.cache.street_cache import pack_street
from wcsim.towns.furniture.buildings import Building, make_buildings
from wcsim.towns.furniture.everything import author_things, place_furniture
from wcsim.towns.furniture.models import FOOT_M
from wcsim.towns.furniture.placement import FreeGround, HeightAt, set_on_ground
from wcsim.towns.furniture.road_marks import lane_marks, unmarked_crossings
from wcsim.towns.furniture.traffic_lights import all_phases
from wcsim.towns.ground.kerb_heights import Kerbing, make_kerbing
from wcsim.towns.ground.mesh import GridMaker, build_ground, build_mesh, kerb_walls
from wcsim.towns.ground.plane_geometry import buffered
from wcsim.towns.ground.relief import fit_relief, on_land
from wcsim.towns.ground.solid_shapes import Solid, prism
from wcsim.towns.ground.surfaces import Surfaces, covered, make_surfaces
from wcsim.towns.ground.tiles import Packed, pack_tiles
from wcsim.towns.osm.tags import kerb_marks
from wcsim.towns.scenario.files import with_included
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import read_net
from wcsim.towns.walking.graph import build_walk_graph, free_space
from wcsim.types import F64, ClassId, Relief

if TYPE_CHECKING:
    from wcsim.towns.scenario.town import Town


def build_street(town: Town, at: Callable[[str], object] = lambda part: None) -> Packed:
    """Make the street of a town from its net and polygons, without any cache.

    `unpack_street` opens it.

    Args:
        town: The town.
        at: Called with each part that begins.

    Raises:
        TownError: The town cannot be used.
    """
    whole = read_net(town.net, town.file.origin_m)
    at("roads and pavements")
    additional = with_included(town.additional, town.border)
    items = read_items(additional, town.file.origin_m, whole)
    relief = fit_relief(whole)
    net = on_land(whole, relief)
    streets = make_surfaces(net, town.file.chair_ways, unmarked_crossings(items, net))
    surfaces = covered(streets, items, net)
    if surfaces.low.is_empty and surfaces.pavement.is_empty:
        raise TownError(
            f"{town.net}: no lane covers any ground; expected shapes with a length: build it again"
        )
    at("ground and kerbs")
    kerbing = make_kerbing(
        surfaces, town.file.kerb_height_m, town.file.lowered_kerb_m, kerb_marks(items)
    )
    ground = build_ground(surfaces, kerbing, relief)
    walls = kerb_walls(ground)
    placed = author_things(items, surfaces.hull)
    at("walkways and objects")
    walkable = shapely.union_all([surfaces.pavement, surfaces.crossing])
    buildings, overhead = make_buildings(
        items, shapely.union_all([streets.low, streets.pavement]), surfaces.hull
    )
    blocks = shapely.union_all([building.outline for building in buildings])
    solids = shapely.union_all([blocks, *(thing.footprint for thing in placed)])
    space, phases = free_space(walkable, _kerb_lines(walls[0]), solids), all_phases(net, additional)
    barred = [
        item.points_W_m for item in items if item.group == "chair_way" and len(item.points_W_m) > 1
    ]
    walk = build_walk_graph(net, space, town.file.chair_ways, phases, barred)
    lines = shapely.MultiLineString([edge.points_W_m for edge in walk.edges])
    low = buffered(surfaces.low, 0.1)
    place = FreeGround(low=low, solids=blocks.buffer(0.05), lines=lines, hull=surfaces.hull)
    things = place_furniture(items, net, additional, place, placed)
    pieces, heads = set_on_ground(things, _height_at(surfaces, kerbing, relief))
    large = [
        _block(building, town.file.kerb_height_m, relief) for building in (*buildings, *overhead)
    ]
    paint = lane_marks(net, surfaces, town.file.chair_ways, relief)
    mesh = replace(build_mesh(ground, walls, large, pieces, relief), paint=paint)
    # What hangs over it takes none.
    taken = [thing.footprint for thing in things if not thing.footprint.is_empty]
    grid = GridMaker(ground, walls[0], [*(b.outline for b in buildings), *taken], relief)
    at("tiles")
    return pack_street(
        pack_tiles(mesh, grid), walk, relief, heads, (*town.file.origin_m, net.z_origin_m)
    )


def _block(building: Building, ground_m: float, relief: Relief) -> Solid:
    """A building stands on the lowest land below its walls, or hangs over the highest, and rises from the highest."""
    land_m = relief.at(shapely.get_coordinates(building.outline))
    top_m = float(land_m.max()) + ground_m
    hangs = building.low_m > 0.0
    low_m = top_m + building.low_m if hangs else FOOT_M + float(land_m.min())
    return prism(building.outline, low_m, top_m + building.height_m, ClassId.BUILDING, floor=hangs)


def _kerb_lines(walls: F64) -> BaseGeometry:
    """The edges of all kerbs that a wheel should not drop off."""
    high = walls[walls[:, :, 2].max(axis=1) > KERB_STEP_M]
    foot = high[:, :2, :2]  # a wall triangle's first two corners span its edge, seen from above
    return shapely.union_all(shapely.linestrings(foot)) if len(foot) else shapely.MultiLineString()


def _height_at(surfaces: Surfaces, kerbing: Kerbing, relief: Relief) -> HeightAt:
    """How high the ground is at points (n, 2)."""

    def height_at(xy_m: F64) -> F64:
        on_road = shapely.contains_xy(surfaces.low, xy_m)
        return np.where(on_road, 0.0, kerbing.height_m(xy_m)) + relief.at(xy_m)

    return height_at

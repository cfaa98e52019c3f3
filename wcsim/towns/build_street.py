"""Makes a town's street: mesh, grid and walk graph.

What this file imports, at first or second hand, makes the street.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import shapely
from shapely import Polygon

from wcsim.core.constants import KERB_STEP_M
from wcsim.errors import TownError
from wcsim.towns.cache.street_cache import pack_street
from wcsim.towns.furniture.buildings import Building, make_buildings
from wcsim.towns.furniture.everything import author_things, place_furniture
from wcsim.towns.furniture.models import FOOT_M
from wcsim.towns.furniture.placement import FreeGround, set_on_ground
from wcsim.towns.furniture.road_marks import lane_marks, unmarked_crossings
from wcsim.towns.furniture.traffic_lights import all_phases
from wcsim.towns.ground.kerb_heights import make_kerbing
from wcsim.towns.ground.mesh import GridMaker, build_ground, build_mesh, kerb_walls
from wcsim.towns.ground.plane_geometry import buffered
from wcsim.towns.ground.relief import fit_relief, on_land
from wcsim.towns.ground.solid_shapes import Solid, prism
from wcsim.towns.ground.surfaces import covered, make_surfaces
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
    """Make the street of a town, without any cache; `unpack_street` opens it.

    Args:
        town: The town.
        at: Called with each part that begins.

    Raises:
        TownError: The town cannot be used.
    """
    # 1. Read what there is.
    file = town.file
    whole = read_net(town.net, file.origin_m)
    at("roads and pavements")
    additional = with_included(town.additional, town.border)
    items = read_items(additional, file.origin_m, whole)

    # 2. Find what is road, pavement and other ground.
    relief = fit_relief(whole)
    net = on_land(whole, relief)
    streets = make_surfaces(net, file.chair_ways, unmarked_crossings(items, net))
    surfaces = covered(streets, items, net)
    if surfaces.low.is_empty and surfaces.pavement.is_empty:
        raise TownError(
            f"{town.net}: no lane covers any ground; expected shapes with a length: build it again"
        )
    at("ground and kerbs")
    marks = kerb_marks(items)
    kerbing = make_kerbing(surfaces, file.kerb_height_m, file.lowered_kerb_m, marks)
    ground = build_ground(surfaces, kerbing, relief)
    walls = kerb_walls(ground)

    # 3. Find where one can walk and roll. Buildings and the author's things are there already, and
    # a wheel should not drop off a kerb. Seen from above, a wall's first two corners span its edge.
    placed = author_things(items, surfaces.hull)
    at("walkways and objects")
    walkable = shapely.union_all([surfaces.pavement, surfaces.crossing])
    street = shapely.union_all([streets.low, streets.pavement])
    buildings, overhead = make_buildings(items, street, surfaces.hull)
    blocks = shapely.union_all([building.outline for building in buildings])
    solids = shapely.union_all([blocks, *(thing.footprint for thing in placed)])
    high = walls[0][walls[0][:, :, 2].max(axis=1) > KERB_STEP_M][:, :2, :2]
    kerbs = shapely.union_all(shapely.linestrings(high)) if len(high) else Polygon()
    space = free_space(walkable, kerbs, solids)
    phases = all_phases(net, additional)
    ways = [item.points_W_m for item in items if item.group == "chair_way"]
    barred = [points_m for points_m in ways if len(points_m) > 1]
    walk = build_walk_graph(net, space, file.chair_ways, phases, barred)

    # 4. Put furniture where it leaves room to walk.
    lines = shapely.MultiLineString([edge.points_W_m for edge in walk.edges])
    low = buffered(surfaces.low, 0.1)
    place = FreeGround(low=low, solids=blocks.buffer(0.05), lines=lines, hull=surfaces.hull)
    things = place_furniture(items, net, additional, place, placed)

    def height_at(xy_m: F64) -> F64:
        on_road = shapely.contains_xy(surfaces.low, xy_m)
        return np.where(on_road, 0.0, kerbing.height_m(xy_m)) + relief.at(xy_m)

    pieces, heads = set_on_ground(things, height_at)

    # 5. Build mesh and raster. What hangs over the ground takes none of it.
    large = [_block(each, file.kerb_height_m, relief) for each in (*buildings, *overhead)]
    paint = lane_marks(net, surfaces, file.chair_ways, relief)
    mesh = replace(build_mesh(ground, walls, large, pieces, relief), paint=paint)
    taken = [thing.footprint for thing in things if not thing.footprint.is_empty]
    grid = GridMaker(ground, walls[0], [*(b.outline for b in buildings), *taken], relief)
    at("tiles")
    origin_m = (*file.origin_m, net.z_origin_m)
    return pack_street(pack_tiles(mesh, grid), walk, relief, heads, origin_m)


def _block(building: Building, ground_m: float, relief: Relief) -> Solid:
    """A building on its land: it stands on the lowest of it, or hangs over the highest."""
    land_m = relief.at(shapely.get_coordinates(building.outline))
    top_m = float(land_m.max()) + ground_m
    hangs = building.low_m > 0.0
    low_m = top_m + building.low_m if hangs else FOOT_M + float(land_m.min())
    return prism(building.outline, low_m, top_m + building.height_m, ClassId.BUILDING, floor=hangs)

"""Say what a town offers to wheelchairs, what is wrong with it, and the command that cures it."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from wcsim.errors import SumoError
from wcsim.seeding import generator
from wcsim.towns.netread import LaneKind, Net, read_net
from wcsim.towns.plane import length_of
from wcsim.towns.street import load_street
from wcsim.towns.surfaces import surfaces_of
from wcsim.towns.tools import Limits, run_tool
from wcsim.towns.town import Town
from wcsim.towns.xmlio import read_root
from wcsim.types import ClassId, Street

RAYS = 4000
CHECKED_S = 600  # of the demand
HEIGHT_SLACK_M = 0.011  # the grid holds whole centimetres
ENOUGH_SHARE = 0.95
_DEFAULT_CLASSES = {"DEFAULT_VEHTYPE": "passenger", "DEFAULT_PEDTYPE": "pedestrian", "DEFAULT_BIKETYPE": "bicycle"}
_GROUND = (ClassId.ROAD, ClassId.SIDEWALK, ClassId.TERRAIN, ClassId.CROSSWALK)
_NO_WAY = re.compile(r"vehicle '([^']+)' has no valid route|person '([^']+)' because|found for person '([^']+)'")
_NO_PAVEMENT = "netconvert -s {net} --sidewalks.guess --crossings.guess --walkingareas -o better.net.xml"


@dataclass(frozen=True, slots=True, kw_only=True)
class TownReport:
    """What a check found."""

    town: str
    crossings: int
    walkingareas: int
    walkable_largest_share: float  # of the area of all pavements and crossings, in the largest connected part
    walk_km: float  # length of the ways that wheelchairs can use
    classes: tuple[str, ...]  # SUMO vehicle classes in the demand, sorted
    unroutable: int  # trips of the first ten minutes that have no way
    mesh_faults: int  # of RAYS rays straight down that did not meet the ground that the grid says
    cures: tuple[str, ...]  # what to do, empty when all is well


def check_town(town: Town) -> TownReport:
    """Check a town. Raises TownError when it cannot be read at all."""
    net = read_net(town.net, town.file.origin_m)
    street = load_street(town)
    crossings, areas = len(net.lanes(LaneKind.CROSSING)), len(net.lanes(LaneKind.WALKINGAREA))
    share = walkable_share(net, town.file.chair_ways)
    unroutable, faults = unroutable_trips(town), mesh_faults(street)
    return TownReport(
        town=town.name,
        crossings=crossings,
        walkingareas=areas,
        walkable_largest_share=share,
        walk_km=_walk_km(street),
        classes=demand_classes(town),
        unroutable=unroutable,
        mesh_faults=faults,
        cures=_cures(town, crossings, areas, share, unroutable, faults),
    )


def walkable_share(net: Net, chair_ways: tuple[str, ...]) -> float:
    """Share of the area of pavements and crossings that the largest connected part of them holds, 0 to 1."""
    surfaces = surfaces_of(net, chair_ways)
    joined = shapely.union_all([surfaces.pavement, surfaces.crossing]).buffer(0.05).buffer(-0.05)
    areas_m2 = [part.area for part in shapely.get_parts(joined)]
    return max(areas_m2) / sum(areas_m2) if areas_m2 else 0.0


def demand_classes(town: Town) -> tuple[str, ...]:
    """SUMO vehicle classes that the town's demand can hold, sorted."""
    class_of, members, used = dict(_DEFAULT_CLASSES), {}, set()
    for path in (*town.additional, *town.routes):
        for element in read_root(path).iter():
            if element.tag == "vType":
                class_of[element.get("id", "")] = element.get("vClass", "passenger")
            elif element.tag == "vTypeDistribution":
                members[element.get("id", "")] = _members(element)
            elif element.tag in ("vehicle", "trip", "flow"):
                used.add(element.get("type", "DEFAULT_VEHTYPE"))
            elif element.tag in ("person", "personFlow"):
                used.add(element.get("type", "DEFAULT_PEDTYPE"))
    types = {member for name in used for member in members.get(name, (name,))}
    return tuple(sorted({class_of.get(name, "passenger") for name in types}))


def unroutable_trips(town: Town) -> int:
    """How many trips and flows that start in the first ten minutes have no way through the net."""
    if not town.routes:
        return 0
    with tempfile.TemporaryDirectory() as folder:
        options = ["-n", str(town.net.resolve()), "-r", ",".join(str(path.resolve()) for path in town.routes)]
        types = [str(path.resolve()) for path in town.additional if _has_types(path)]
        options += ["-a", ",".join(types)] if types else []
        options += [
            "-o",
            "out.rou.xml",
            "-e",
            str(CHECKED_S),
            "--ignore-errors",
            "--no-step-log",
            "--xml-validation",
            "never",
        ]
        run = run_tool("duarouter", options, Path(folder), Limits(wall_s=180.0))
    if run.returncode:
        raise SumoError(f"town {town.name}: its demand cannot be checked: {run.reason()}; correct the route files")
    found = _NO_WAY.findall(run.output)
    return len({name for names in found for name in names if name})


def mesh_faults(street: Street, rays: int = RAYS) -> int:
    """How many rays straight down, on road and pavement, meet no face with the class and height of the grid."""
    grid, mesh = street.grid, street.mesh
    rows, cols = np.nonzero(np.isin(grid.ground_class, (ClassId.ROAD, ClassId.SIDEWALK, ClassId.CROSSWALK)))
    chosen = generator(0, "rays").choice(len(rows), min(rays, len(rows)), replace=False)
    rows, cols = rows[chosen], cols[chosen]
    xy_m = np.column_stack([cols + 0.5, rows + 0.5]) * grid.cell_m + grid.origin_W_m
    faces = np.flatnonzero(np.isin(mesh.face_class, _GROUND))
    corners = mesh.vertices_W_m[mesh.faces[faces]].astype(np.float64)  # (F, 3, 3)
    tree = shapely.STRtree(shapely.polygons(corners[:, :, :2]))
    ray, face = tree.query(shapely.points(xy_m), predicate="intersects")
    good = mesh.face_class[faces[face]] == grid.ground_class[rows[ray], cols[ray]]
    height_m = grid.z_base_m + 0.01 * grid.height_cm[rows[ray], cols[ray]].astype(np.float64)
    good &= np.abs(_height_on(corners[face], xy_m[ray]) - height_m) <= HEIGHT_SLACK_M
    return len(xy_m) - len(np.unique(ray[good]))


def _height_on(corners: np.ndarray, xy_m: np.ndarray) -> np.ndarray:
    """Height (n,) of planes through triangles (n, 3, 3) at points (n, 2)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offset = xy_m - corners[:, 0, :2]
    height: np.ndarray = corners[:, 0, 2] - (normal[:, :2] * offset).sum(axis=1) / normal[:, 2]
    return height


def _members(element: Element) -> tuple[str, ...]:
    inner = [child.get("id", "") for child in element.iterfind("vType")]
    return tuple([*inner, *element.get("vTypes", "").split()])


def _has_types(path: Path) -> bool:
    return any(element.tag in ("vType", "vTypeDistribution") for element in read_root(path))


def _walk_km(street: Street) -> float:
    return sum(length_of(edge.points_W_m) for edge in street.walk.edges) / 1e3


def _cures(town: Town, crossings: int, areas: int, share: float, unroutable: int, faults: int) -> tuple[str, ...]:
    build = _NO_PAVEMENT.format(net=town.net.name)
    cures = []
    if not crossings or not areas:
        cures.append(f"the net has {crossings} crossings and {areas} walking areas; add them: {build}")
    elif share < ENOUGH_SHARE:
        cures.append(f"only {share:.0%} of the pavement hangs together; expected {ENOUGH_SHARE:.0%}: {build}")
    if unroutable:
        cures.append(
            f"{unroutable} trips have no way; drop them: duarouter -n {town.net.name} -r ROUTES --ignore-errors"
        )
    if faults > RAYS // 1000:
        cures.append(f"{faults} of {RAYS} rays missed the ground; delete the cache and check again")
    return tuple(cures)

"""What a town offers to wheelchairs, and what is wrong with it.

Each fault is one line with the command that cures it.
"""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from wcsim.config import RunConfig
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import pluralize
from wcsim.errors import SumoError, TownError
from wcsim.towns.checks.cures import ENOUGH_SHARE, FOR_ROUTES, PAVED_LATER, Cures
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.ground.plane_geometry import length_of
from wcsim.towns.ground.relief import fit_relief, on_land, steepest_grade
from wcsim.towns.ground.surfaces import ground_of
from wcsim.towns.scenario.files import FilteredFiles, with_included
from wcsim.towns.scenario.options import read_configuration
from wcsim.towns.scenario.stage import files_of
from wcsim.towns.scenario.town import Town, find_changes, polygons_among
from wcsim.towns.street import load_street
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import WALK_KINDS, Edge, LaneKind, Net, read_net
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.towns.sumo.xml_io import read_root
from wcsim.towns.walking.islands import CutOff, cut_off, largest_share, walkable_parts

_WALKER = "pedestrian"
_LARGEST_M = 200_000.0  # across; a net that is larger was projected wrongly
STEEPEST = 0.25
AROUND_M = 100.0  # of the streets: what lies farther outside belongs to something else
_PROJECT = "build the net again from the same files, with netconvert's option --proj.utm"
_BUILT_UP = ("building", "tree", "tree_row")
_MOST_PARTS = 5  # of those that are cut off, in a line
LEAST_M2 = 3.0  # of one pair: less comes of rounded corners
APART_M = 2.0  # ways with more between their heights pass over each other
_CHECKED_S = 600.0  # of the demand, from its begin
_DEFAULT_CLASSES = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_BIKETYPE": "bicycle",
}
_NO_WAY = re.compile(
    r"vehicle '([^']+)' has no valid route|person '([^']+)' because|found for person '([^']+)'"
    r"|within the route [a-z ]*'([^']+)' is not known"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Overlap:
    """A carriageway on a pavement."""

    street: str  # edge ids
    pavement: str
    area_m2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TownReport:
    """What a check found."""

    town: str
    crossings: int
    walkingareas: int
    walkable_largest_share: float  # of all pavements and crossings, in the largest connected part
    walk_km: float  # length of the ways that wheelchairs can use
    classes: tuple[str, ...]  # SUMO vehicle classes in the demand, sorted
    # Trips of the first ten minutes without a way, or that SUMO ignores for their place in a file.
    unroutable: int
    lefthand: bool
    overlaps: tuple[_Overlap, ...] = ()  # streets on the pavements of others
    cut_off: tuple[CutOff, ...] = ()  # walkable parts beside the largest, largest first
    faults: tuple[str, ...] = ()  # each with the command that cures it; empty when all is well
    notes: tuple[str, ...] = ()


def check_town(
    town: Town, share: float | None = None, faster: tuple[float, str] = (0.0, "")
) -> TownReport:
    """Check a town.

    Args:
        town: The town.
        share: Its walkable share, when it is known already.
        faster: For a paved copy, that of `Paved`.

    Raises:
        TownError: The town cannot be read at all, or its net is not in metres.
    """
    # 1. Missing files are reported before SUMO opens a large net.
    files_of(town, RunConfig())
    net = read_net(town.net, town.file.origin_m)
    # 2. The coordinates have to be metres.
    low_m, high_m = net.corners_m()
    size_m = high_m - low_m
    size = f"{town.net}: {town.net.name} is {size_m[0]:.4g} x {size_m[1]:.4g} m"
    if size_m.max() > _LARGEST_M:
        raise TownError(f"{size}, so its projection is wrong; {_PROJECT}")
    lanes = net.every_lane
    drawn_m = sum(float(np.hypot(*np.diff(lane.points_m, axis=0).T).sum()) for lane in lanes)
    noted_m = sum(lane.length_m for lane in lanes if lane.kind is not LaneKind.WALKINGAREA)
    if size_m.max() < 2.0 or noted_m > 20.0 * drawn_m:
        raise TownError(f"{size}, so its coordinates are in degrees or another unit; {_PROJECT}")
    # 3. See what the town has.
    validate_net(town.net, border=town.border)
    street = load_street(town)
    parts = walkable_parts(net, town.file.chair_ways) if share is None else []
    found = TownReport(
        town=town.name,
        crossings=len(net.lanes(LaneKind.CROSSING)),
        walkingareas=len(net.lanes(LaneKind.WALKINGAREA)),
        walkable_largest_share=largest_share(parts) if share is None else share,
        walk_km=sum(length_of(edge.points_W_m) for edge in street.walk.edges) / 1e3,
        classes=_demand_classes(town),
        unroutable=_unroutable_trips(town),
        lefthand=net.lefthand,
        overlaps=_find_overlaps(on_land(net, fit_relief(net))),
        cut_off=cut_off(net, parts),
    )
    notes = (*_find_notes(town, net, found.overlaps), *_no_walkers(town, net, found))
    return replace(found, faults=_faults_of(town, net, found, faster), notes=notes)


def _faults_of(
    town: Town, net: Net, found: TownReport, faster: tuple[float, str] = (0.0, "")
) -> tuple[str, ...]:
    """The faults of a town; none when all is well. `faster` is that of `Paved`."""
    lines = [*_ways(town, net, found, faster), *_foreign_polygons(town, net)]
    if found.unroutable:
        lines.append(
            f"{found.unroutable} trips have no route through the net, or SUMO ignores them below a "
            f"later one in their file; to drop or repair them, {Cures(town).routes()}"
        )
    grade = steepest_grade(net)
    if grade > STEEPEST:
        lines.append(
            f"a lane of {town.net.name} has a grade of {grade:.2f}; "
            f"expected at most {STEEPEST}: {Cures(town).grade()}"
        )
    return tuple(lines)


def _ways(town: Town, net: Net, found: TownReport, faster: tuple[float, str]) -> list[str]:
    imported = "--osm" in town.file.rebuild
    fast_too = f"pave the fast streets too, in another folder: {faster[1]}"

    def paving() -> str:
        if faster[0]:
            return fast_too
        return Cures(town).larger() if imported else Cures(town).pave()

    if not found.walkingareas:
        paved = net.paved_streets
        has = f"has pavements beside {pluralize(paved, 'street')}, but" if paved else "has"
        areas = f"no walking areas{' to join them' if paved else ''}"
        return [f"the net {has} {areas}, so pedestrians cannot walk; {paving()}"]
    lines = []
    if _lacks_crossings(net, found):
        lines.append(f"the net has no crossings, so pedestrians cannot cross a street; {paving()}")
    if found.walkable_largest_share < ENOUGH_SHARE:
        share = f"{found.walkable_largest_share:.1%} of the walkable area is connected"
        cure = Cures(town).larger() if imported else f"join the parts: {Cures(town).netedit()}"
        cure = fast_too if faster[0] > found.walkable_largest_share else cure
        # Which parts of the walkable ground cannot be reached on foot.
        parts = [f"edge {part.edge} ({part.area_m2:.0f} m2)" for part in found.cut_off]
        text = ", ".join(parts[:_MOST_PARTS])
        text += f" and {len(parts) - _MOST_PARTS} more" if len(parts) > _MOST_PARTS else ""
        text = f"cut off: the parts around {text}; " if parts else ""
        lines.append(f"only {share}; expected {ENOUGH_SHARE:.0%}: {text}{cure}")
    return lines


def _lacks_crossings(net: Net, found: TownReport) -> bool:
    return not found.crossings and bool(net.lanes(LaneKind.MOTOR))


def _foreign_polygons(town: Town, net: Net) -> list[str]:
    """Buildings and trees that were made for another net, or for another state of this one."""
    poly = _polygons(town)
    if poly is None:
        return []
    low_m, high_m = net.corners_m()
    files = with_included((poly,), town.border)
    things_m = [item.points_W_m for item in read_items(files, town.file.origin_m, net)]
    low_m, high_m = low_m - AROUND_M, high_m + AROUND_M
    if any(((low_m <= at) & (at <= high_m)).all(axis=1).any() for at in things_m) or not things_m:
        return []
    cure = "build it from its map again, with polyconvert's option --net-file " + town.net.name
    if town.file.rebuild:
        cure = Cures(town).again("build it for this net", town.file.rebuild)
    return [
        f"none of the {len(things_m)} objects of {poly.name} is near the streets, "
        f"so it belongs to another net; {cure}"
    ]


def _find_notes(town: Town, net: Net, over: tuple[_Overlap, ...] = ()) -> tuple[str, ...]:
    """What is worth knowing and no fault."""
    changed, net_file = find_changes(town.folder, town.file), town.net.resolve()
    notes = [
        f"changed since the import: {path.name}" for path in changed if path.resolve() != net_file
    ]
    # The demand was routed through the net.
    for path in (path for path in changed if path.resolve() == net_file):
        note = f"changed since the import: {path.name}"
        if town.routes:
            note += f"; to route the traffic over the new net, {Cures(town).routes()}"
        notes.append(note)
    if over:
        total_m2, worst = sum(item.area_m2 for item in over), over[0]
        notes.append(
            f"{total_m2:.0f} m2 of pavement overlap the carriageway of another street without a "
            f"junction (places of more than {LEAST_M2:g} m2): SUMO's pedestrians and cars do not "
            f"see each other there; the largest: edge {worst.pavement} under {worst.street}, "
            f"{worst.area_m2:.0f} m2; move or delete one of them: {Cures(town).netedit()}"
        )
    # A file of another name may hold buildings or trees.
    items = read_items(with_included(town.additional, town.border), town.file.origin_m, net)
    if _polygons(town) is None and not any(item.kind in _BUILT_UP for item in items):
        notes.append("there are no buildings or trees: the town has no .poly.xml")
    return tuple(notes)


def _polygons(town: Town) -> Path | None:
    """The file of buildings and trees, named by the scenario or included."""
    return town.poly or polygons_among(with_included(town.additional, town.border))


def _no_walkers(town: Town, net: Net, found: TownReport) -> list[str]:
    is_walkable = found.walkingareas or net.lanes(LaneKind.MOTOR, *WALK_KINDS)
    if _WALKER in found.classes or not is_walkable:
        return []
    # Walkers need a paved copy of the scenario first, where there can be one.
    unpaved = not found.walkingareas or _lacks_crossings(net, found)
    cure = PAVED_LATER if unpaved and "--osm" not in town.file.rebuild else Cures(town).walkers()
    words = shlex.split(town.file.rebuild)
    if "--traffic" in words[:-1] and words[words.index("--traffic") + 1] == "0":
        words[words.index("--traffic") + 1] = "1"
        cure = Cures(town).again("add them", shlex.join(words))
    return [f"the demand has no pedestrians; {cure}"]


def _demand_classes(town: Town) -> tuple[str, ...]:
    """SUMO vehicle classes that the town's demand can hold, sorted."""
    class_of, members, used = dict(_DEFAULT_CLASSES), {}, set()
    for path in with_included((*town.additional, *town.routes), town.border):
        for element in read_root(path).iter():
            if element.tag == "vType":
                class_of[element.get("id", "")] = element.get("vClass", "passenger")
            elif element.tag == "vTypeDistribution":
                inner = (
                    child.get("id", child.get("refId", "")) for child in element.iterfind("vType")
                )
                members[element.get("id", "")] = *inner, *element.get("vTypes", "").split()
            elif element.tag in ("vehicle", "trip", "flow"):
                used.add(element.get("type", "DEFAULT_VEHTYPE"))
            elif element.tag in ("person", "personFlow"):
                used.add(element.get("type", "DEFAULT_PEDTYPE"))
    types = {member for name in used for member in members.get(name, (name,))}
    return tuple(sorted({class_of.get(name, "passenger") for name in types}))


def _unroutable_trips(town: Town) -> int:
    """How many trips and flows of the first ten minutes have no way, or SUMO ignores them."""
    if not town.routes:
        return 0
    # 1. Have duarouter look for the ways.
    with create_temporary_folder() as folder:
        met = FilteredFiles(folder, town.border)  # duarouter follows what they include
        routes = [str(met.place(path, town.sumocfg)) for path in town.routes]
        needed = _for_routes([met.place(path, town.sumocfg) for path in town.additional])
        needed.write(folder / "needed.add.xml")
        options = ["-n", str(met.place(town.net, town.sumocfg)), "-r", ",".join(routes)]
        options += ["-a", "needed.add.xml", "-o", "out.rou.xml"]
        # SUMO drops what departs before its begin.
        begin_s = Cures(town).own_time()[0]
        options += ["-b", f"{begin_s:.12g}", "-e", f"{begin_s + _CHECKED_S:.12g}"]
        options += ["--ignore-errors", "--no-step-log", "--xml-validation", "never"]
        run = run_tool("duarouter", options, folder, Limits(wall_s=180.0))
    if run.returncode:
        files = ", ".join(path.name for path in (*town.routes, *town.additional, town.net))
        raise SumoError(
            f"{town.sumocfg}: its demand cannot be checked: {run.reason()}; correct one of: {files}"
        )
    missed = {name for names in _NO_WAY.findall(run.output) for name in names if name}
    # 2. SUMO ignores what stands below a later departure, unless it reads files as a whole.
    in_order = read_configuration(town.sumocfg).seconds("route-steps", "200") > 0.0
    for path in town.routes if in_order else ():
        latest_s = 0.0
        for element in read_root(path):
            depart = element.get("depart", element.get("begin", ""))
            depart_s = float(depart) if re.fullmatch(r"\d+(\.\d*)?", depart) else latest_s
            if depart_s < latest_s:
                missed.add(element.get("id", ""))
            latest_s = max(latest_s, depart_s)
    return len(missed)


def _for_routes(files: list[Path]) -> ElementTree:
    """What a demand needs of additional files; included ones stand in the place of <include>."""
    found = Element("additional")
    for path in files:
        found.extend(_needed_of(path))
    return ElementTree(found)


def _needed_of(path: Path) -> Iterator[Element]:
    """Of a file that was placed, so that it does not include itself."""
    for element in read_root(path):
        if element.tag == "include":
            yield from _needed_of(path.parent / element.get("href", ""))
        elif element.tag in FOR_ROUTES:
            yield element


def _find_overlaps(net: Net) -> tuple[_Overlap, ...]:
    """All overlaps of more than LEAST_M2, the largest first."""
    streets, driven = _areas(net, LaneKind.MOTOR)
    paved, walked = _areas(net, *WALK_KINDS)
    found: list[_Overlap] = []
    if not driven or not walked:
        return ()
    for i, j in shapely.STRtree(walked).query(driven, predicate="intersects").T.tolist():
        street, other = streets[i], paved[j]
        meets = {street.start, street.end} & {other.start, other.end}
        if meets or abs(_z_m(street) - _z_m(other)) > APART_M:
            continue
        area_m2 = float(driven[i].intersection(walked[j]).area)
        if area_m2 > LEAST_M2:
            found.append(_Overlap(street=street.id, pavement=other.id, area_m2=area_m2))
    return tuple(sorted(found, key=lambda item: (-item.area_m2, item.street, item.pavement)))


def _areas(net: Net, *kinds: LaneKind) -> tuple[list[Edge], list[BaseGeometry]]:
    edges = [e for e in net.streets if e.has(*kinds)]
    return edges, [ground_of(lane for lane in e.lanes if lane.kind in kinds) for e in edges]


def _z_m(edge: Edge) -> float:
    return float(sum(lane.z_m.mean() for lane in edge.lanes) / len(edge.lanes))

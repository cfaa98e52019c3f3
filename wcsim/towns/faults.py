"""What is wrong with a town, each in one line with the command that cures it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wcsim.towns.items import read_items
from wcsim.towns.lift import steepest_grade
from wcsim.towns.manifest import changes_of
from wcsim.towns.netread import LaneKind, Net
from wcsim.towns.town import Town

ENOUGH_SHARE = 0.95
LARGEST_M = 200_000.0  # across; a net that is larger was projected wrongly
STEEPEST = 0.25
AROUND_M = 100.0  # of the streets: what lies farther outside belongs to something else
_PAVE = "netconvert -s {net} --sidewalks.guess --crossings.guess --walkingareas -o better.net.xml"
_PROJECT = "build it again in metres: netconvert --osm-files EXTRACT --proj.utm -o {net}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What a check measured."""

    crossings: int
    walkingareas: int
    walkable_largest_share: float
    unroutable: int
    mesh_faults: int
    rays: int  # that were sent down for `mesh_faults`
    classes: tuple[str, ...]


def faults_of(town: Town, net: Net, found: Findings) -> tuple[str, ...]:
    """The faults of a town; none when all is well."""
    lines = [*_ways(town, net, found), *_demand(town, found), *projection_faults(town, net)]
    if found.mesh_faults > found.rays // 1000:
        lines.append(
            f"{found.mesh_faults} of {found.rays} rays missed the ground; build the street again: "
            'rm -r "${XDG_CACHE_HOME:-$HOME/.cache}/wcsim"'
        )
    lines += _foreign_polygons(town, net)
    grade = steepest_grade(net)
    if grade > STEEPEST:
        lines.append(
            f"a lane of {town.net.name} is as steep as {grade:.2f}; expected at most {STEEPEST}: "
            f"netconvert -s {town.net.name} --geometry.max-grade 12 --geometry.max-grade.fix -o better.net.xml"
        )
    stale = changes_of(town).stale
    if stale:
        again = _in_folder(town, town.file.rebuild or "import the scenario again: wcsim town import --sumocfg FILE")
        lines.append(f"changed since the import, and made for each other: {', '.join(stale)}; {again}")
    return tuple(lines)


def notes_of(town: Town, net: Net) -> tuple[str, ...]:
    """What is worth knowing and no fault."""
    notes = [f"changed since the import: {name}" for name in changes_of(town).authored]
    if town.poly is None:
        notes.append("there are no buildings or trees: the town has no .poly.xml")
    return tuple(notes)


def projection_faults(town: Town, net: Net) -> tuple[str, ...]:
    """Nets whose coordinates are no metres."""
    points_m = np.concatenate([lane.points_m for edge in net.edges for lane in edge.lanes])
    size_m = np.ptp(points_m, axis=0)
    told = f"{town.net.name} is {size_m[0]:.4g} x {size_m[1]:.4g} m large"
    cure = _PROJECT.format(net=town.net.name)
    if size_m.max() > LARGEST_M:
        return (f"{told}, so its projection is wrong; {cure}",)
    drawn_m = sum(float(np.hypot(*np.diff(lane.points_m, axis=0).T).sum()) for edge in net.edges for lane in edge.lanes)
    noted_m = sum(lane.length_m for edge in net.edges for lane in edge.lanes if lane.kind is not LaneKind.WALKINGAREA)
    if size_m.max() < 2.0 or noted_m > 20.0 * drawn_m:
        return (f"{told}, so its coordinates are degrees or in another unit; {cure}",)
    return ()


def _foreign_polygons(town: Town, net: Net) -> list[str]:
    """Buildings and trees that were made for another net, or for another state of this one."""
    if town.poly is None:
        return []
    streets_m = np.concatenate([lane.points_m for edge in net.edges for lane in edge.lanes])
    low_m, high_m = streets_m.min(axis=0) - AROUND_M, streets_m.max(axis=0) + AROUND_M
    things_m = [item.points_W_m for item in read_items((town.poly,), town.file.origin_m, net)]
    if not things_m or any(((low_m <= at) & (at <= high_m)).all(axis=1).any() for at in things_m):
        return []
    cure = f"polyconvert --osm-files EXTRACT --net-file {town.net.name} -o {town.poly.name}"
    if town.file.rebuild:
        cure = _in_folder(town, town.file.rebuild)
    return [
        f"none of the {len(things_m)} things of {town.poly.name} lies at the streets, so it was made for another net; "
        f"build it for this one: {cure}"
    ]


def _ways(town: Town, net: Net, found: Findings) -> list[str]:
    pave = _PAVE.format(net=town.net.name)
    if town.file.rebuild:
        pave = "take a larger area: wcsim town import --osm FILE --bbox W,S,E,N --name " + town.name
    if not found.walkingareas:
        return [f"the net has no walking areas, so nobody can walk; add pavements: {pave}"]
    lines = []
    if not found.crossings and net.lanes(LaneKind.MOTOR):
        lines.append(f"the net has no crossings, so nobody can cross a street; add them: {pave}")
    if found.walkable_largest_share < ENOUGH_SHARE:
        share = f"{found.walkable_largest_share:.0%} of the walkable ground hangs together"
        lines.append(f"only {share}; expected {ENOUGH_SHARE:.0%}: {pave}")
    return lines


def _demand(town: Town, found: Findings) -> list[str]:
    lines = []
    if "pedestrian" not in found.classes:
        cure = f"randomTrips.py -n {town.net.name} --pedestrians -r walkers.rou.xml"
        if town.file.rebuild:
            cure = _in_folder(town, f"{town.file.rebuild} --traffic 1")
        lines.append(f"nobody walks in this town: its demand has no persons; add some: {cure}")
    if found.unroutable:
        routes = ",".join(path.name for path in town.routes)
        cure = f"duarouter -n {town.net.name} -r {routes} --ignore-errors -o better.rou.xml"
        lines.append(f"{found.unroutable} trips have no way through the net; drop them: {cure}")
    return lines


def _in_folder(town: Town, command: str) -> str:
    return f"cd {town.folder} && {command}" if command.startswith("wcsim") else command

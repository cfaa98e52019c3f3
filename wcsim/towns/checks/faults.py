"""What is wrong with a town, each in one line with the command that cures it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wcsim.towns.checks.cures import (
    grade_cure,
    netedit_cure,
    pave_cure,
    paved_streets,
    routes_cure,
    slowest_street_mps,
    walkers_cure,
)
from wcsim.towns.ground.relief import steepest_grade
from wcsim.towns.scenario.includes import with_included
from wcsim.towns.scenario.manifest import changes_of, own_work
from wcsim.towns.scenario.town import Town, polygons_among
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import WALK_KINDS, LaneKind, Net
from wcsim.towns.walking.islands import CutOff
from wcsim.towns.walking.overlaps import Overlap

_ENOUGH_SHARE = 0.95
_WALKER = "pedestrian"
LARGEST_M = 200_000.0  # across; a net that is larger was projected wrongly
STEEPEST = 0.25
AROUND_M = 100.0  # of the streets: what lies farther outside belongs to something else
_MUCH = 0.1  # of the pavement, under carriageways of other levels
_BUILT_UP = ("building", "tree", "tree_row")
_TOLD_PARTS = 5  # of those that are cut off
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
    overlaps: tuple[Overlap, ...] = ()  # streets on the pavements of others
    cut_off: tuple[CutOff, ...] = ()  # walkable parts beside the largest, largest first


def faults_of(town: Town, net: Net, found: Findings) -> tuple[str, ...]:
    """The faults of a town; none when all is well."""
    lines = [*_ways(town, net, found), *_demand(town, net, found), *projection_faults(town, net)]
    if found.mesh_faults > found.rays // 1000:
        lines.append(
            f"{found.mesh_faults} of {found.rays} rays missed the ground; build the street again: "
            "wcsim cache --clear"
        )
    lines += _foreign_polygons(town, net)
    grade = steepest_grade(net)
    if grade > STEEPEST:
        lines.append(
            f"a lane of {town.net.name} is as steep as {grade:.2f}; expected at most {STEEPEST}: {grade_cure(town)}"
        )
    if _large(net, found.overlaps):
        cure = f"bridges belong on another level; delete them: {netedit_cure(town)}"
        lines.append(f"{_overlap(found.overlaps)}; {cure}")
    return tuple(lines)


def notes_of(town: Town, net: Net, over: tuple[Overlap, ...] = ()) -> tuple[str, ...]:
    """What is worth knowing and no fault."""
    changes = changes_of(town)
    notes = [f"changed since the import: {name}" for name in changes.others]
    for name in changes.net:
        again = routes_cure(town)
        notes.append(f"changed since the import: {name}; traffic takes new ways when it is routed again: {again}")
    if over and not _large(net, over):
        notes.append(_overlap(over))
    if _polygons(town) is None and not _built_up(town, net):
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
    poly = _polygons(town)
    if poly is None:
        return []
    streets_m = np.concatenate([lane.points_m for edge in net.edges for lane in edge.lanes])
    low_m, high_m = streets_m.min(axis=0) - AROUND_M, streets_m.max(axis=0) + AROUND_M
    files = with_included((poly,), town.border)
    things_m = [item.points_W_m for item in read_items(files, town.file.origin_m, net)]
    if not things_m or any(((low_m <= at) & (at <= high_m)).all(axis=1).any() for at in things_m):
        return []
    cure = f"polyconvert --osm-files EXTRACT --net-file {town.net.name} -o {poly.name}"
    if town.file.rebuild:
        cure = _again(town, town.file.rebuild)
    return [
        f"none of the {len(things_m)} things of {poly.name} lies at the streets, so it was made for another net; "
        f"build it for this one: {cure}"
    ]


def _polygons(town: Town) -> Path | None:
    """The file of buildings and trees, named by the scenario or included."""
    return town.poly or polygons_among(with_included(town.additional, town.border))


def _built_up(town: Town, net: Net) -> bool:
    """Whether a file of another name holds buildings or trees."""
    files = with_included(town.additional, town.border)
    return any(item.kind in _BUILT_UP for item in read_items(files, town.file.origin_m, net))


def _ways(town: Town, net: Net, found: Findings) -> list[str]:
    larger = f"take a larger area: wcsim town import --osm FILE --bbox W,S,E,N --name {town.name}"
    imported = "town import" in town.file.rebuild
    pave = larger if imported else f"{'first ' * _walkers_later(town, net, found)}{pave_cure(town)}"
    if not found.walkingareas:
        paved = paved_streets(net)
        has = f"has pavements beside {paved} streets, but" if paved else "has"
        return [f"the net {has} no walking areas{' to join them' if paved else ''}, so nobody can walk; {pave}"]
    lines = []
    if _lacks_crossings(net, found):
        lines.append(f"the net has no crossings, so nobody can cross a street; {pave}")
    if found.walkable_largest_share < _ENOUGH_SHARE:
        share = f"{found.walkable_largest_share:.1%} of the walkable ground hangs together"
        cure = larger if imported else f"join the parts: {netedit_cure(town)}"
        lines.append(f"only {share}; expected {_ENOUGH_SHARE:.0%}: {_parts(found.cut_off)}{cure}")
    return lines


def _lacks_crossings(net: Net, found: Findings) -> bool:
    return not found.crossings and bool(net.lanes(LaneKind.MOTOR))


def _walkers_later(town: Town, net: Net, found: Findings) -> bool:
    """Whether nobody walks, and those who will are for a copy of the scenario that has to be paved first."""
    unpaved = not found.walkingareas or _lacks_crossings(net, found)
    can_be = "town import" not in town.file.rebuild and slowest_street_mps(net) is not None
    return unpaved and can_be and _WALKER not in found.classes


def _parts(cut_off: tuple[CutOff, ...]) -> str:
    """Which parts of the walkable ground nobody can walk to."""
    told = ", ".join(f"edge {part.edge} ({part.area_m2:.0f} m2)" for part in cut_off[:_TOLD_PARTS])
    more = f" and {len(cut_off) - _TOLD_PARTS} more" if len(cut_off) > _TOLD_PARTS else ""
    return f"cut off are the parts around {told}{more}; " if told else ""


def _demand(town: Town, net: Net, found: Findings) -> list[str]:
    lines = []
    if _WALKER not in found.classes:
        later = _walkers_later(town, net, found)
        cure = f"{'then, for the paved copy, ' * later}{walkers_cure(town, paved=later)}"
        words = shlex.split(town.file.rebuild)
        if "--traffic" in words[:-1] and words[words.index("--traffic") + 1] == "0":
            words[words.index("--traffic") + 1] = "1"
            cure = f"add some: {_again(town, shlex.join(words))}"
        lines.append(f"nobody walks in this town: its demand has no persons on foot; {cure}")
    if found.unroutable:
        lines.append(f"{found.unroutable} trips have no way through the net; to drop or mend them, {routes_cure(town)}")
    return lines


def _again(town: Town, rebuild: str) -> str:
    """The command that builds a town again, run in its folder; it says so when somebody's work would be lost."""
    command = f"cd {shlex.quote(str(town.folder.resolve()))} && {rebuild}"
    work = own_work(town.folder)
    return f"{command} --replace (what you did to {', '.join(work)} is lost then)" if work else command


def _large(net: Net, over: tuple[Overlap, ...]) -> bool:
    paved_m2 = sum(lane.length_m * lane.width_m for lane in net.lanes(*WALK_KINDS))
    return sum(item.area_m2 for item in over) > _MUCH * paved_m2


def _overlap(over: tuple[Overlap, ...]) -> str:
    total_m2 = sum(item.area_m2 for item in over)
    worst = f"most of it edge {over[0].street} over {over[0].pavement}"
    return f"{total_m2:.0f} m2 of carriageway lie on pavements of other streets, without a junction; {worst}"

"""What is wrong with a town, each in one line with the command that cures it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wcsim.towns.checks.cures import (
    again_cure,
    grade_cure,
    larger_cure,
    netedit_cure,
    pave_cure,
    paved_streets,
    routes_cure,
    slowest_street_mps,
    walkers_cure,
)
from wcsim.towns.ground.relief import steepest_grade
from wcsim.towns.scenario.includes import with_included
from wcsim.towns.scenario.manifest import changes_of
from wcsim.towns.scenario.town import Town, polygons_among
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.net import LaneKind, Net
from wcsim.towns.walking.islands import CutOff
from wcsim.towns.walking.overlaps import LEAST_M2, Overlap

_ENOUGH_SHARE = 0.95
_WALKER = "pedestrian"
LARGEST_M = 200_000.0  # across; a net that is larger was projected wrongly
STEEPEST = 0.25
AROUND_M = 100.0  # of the streets: what lies farther outside belongs to something else
_BUILT_UP = ("building", "tree", "tree_row")
_TOLD_PARTS = 5  # of those that are cut off
_PROJECT = "build the net again from the same files, with netconvert's option --proj.utm"


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
            f"{found.mesh_faults} of {found.rays} vertical rays missed the ground; build the street "
            "again: wcsim cache --clear"
        )
    lines += _foreign_polygons(town, net)
    grade = steepest_grade(net)
    if grade > STEEPEST:
        lines.append(
            f"a lane of {town.net.name} has a grade of {grade:.2f}; expected at most {STEEPEST}: {grade_cure(town)}"
        )
    return tuple(lines)


def notes_of(town: Town, net: Net, over: tuple[Overlap, ...] = ()) -> tuple[str, ...]:
    """What is worth knowing and no fault."""
    changes = changes_of(town)
    notes = [f"changed since the import: {name}" for name in changes.others]
    for name in changes.net:
        again = f"; to route the traffic over the new net, {routes_cure(town)}" if town.routes else ""
        notes.append(f"changed since the import: {name}{again}")
    if over:
        notes.append(_overlap(town, over))
    if _polygons(town) is None and not _built_up(town, net):
        notes.append("there are no buildings or trees: the town has no .poly.xml")
    return tuple(notes)


def projection_faults(town: Town, net: Net) -> tuple[str, ...]:
    """Nets whose coordinates are no metres."""
    points_m = np.concatenate([lane.points_m for edge in net.edges for lane in edge.lanes])
    size_m = np.ptp(points_m, axis=0)
    told = f"{town.net.name} is {size_m[0]:.4g} x {size_m[1]:.4g} m"
    if size_m.max() > LARGEST_M:
        return (f"{told}, so its projection is wrong; {_PROJECT}",)
    drawn_m = sum(float(np.hypot(*np.diff(lane.points_m, axis=0).T).sum()) for edge in net.edges for lane in edge.lanes)
    noted_m = sum(lane.length_m for edge in net.edges for lane in edge.lanes if lane.kind is not LaneKind.WALKINGAREA)
    if size_m.max() < 2.0 or noted_m > 20.0 * drawn_m:
        return (f"{told}, so its coordinates are in degrees or another unit; {_PROJECT}",)
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
    told = f"none of the {len(things_m)} objects of {poly.name} is near the streets, so it belongs to another net; "
    if town.file.rebuild:
        return [told + again_cure(town, "build it for this net", town.file.rebuild)]
    return [f"{told}build it from its map again, with polyconvert's option --net-file {town.net.name}"]


def _polygons(town: Town) -> Path | None:
    """The file of buildings and trees, named by the scenario or included."""
    return town.poly or polygons_among(with_included(town.additional, town.border))


def _built_up(town: Town, net: Net) -> bool:
    """Whether a file of another name holds buildings or trees."""
    files = with_included(town.additional, town.border)
    return any(item.kind in _BUILT_UP for item in read_items(files, town.file.origin_m, net))


def _ways(town: Town, net: Net, found: Findings) -> list[str]:
    imported = "town import" in town.file.rebuild

    def paving() -> str:
        return larger_cure(town) if imported else f"{'first ' * _walkers_later(town, net, found)}{pave_cure(town)}"

    if not found.walkingareas:
        paved = paved_streets(net)
        has = f"has pavements beside {paved} streets, but" if paved else "has"
        return [
            f"the net {has} no walking areas{' to join them' if paved else ''}, so pedestrians cannot walk; {paving()}"
        ]
    lines = []
    if _lacks_crossings(net, found):
        lines.append(f"the net has no crossings, so pedestrians cannot cross a street; {paving()}")
    if found.walkable_largest_share < _ENOUGH_SHARE:
        share = f"{found.walkable_largest_share:.1%} of the walkable area is connected"
        cure = larger_cure(town) if imported else f"join the parts: {netedit_cure(town)}"
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
    return f"cut off: the parts around {told}{more}; " if told else ""


def _demand(town: Town, net: Net, found: Findings) -> list[str]:
    lines = []
    if _WALKER not in found.classes and (found.walkingareas or slowest_street_mps(net) is not None):
        later = _walkers_later(town, net, found)
        cure = f"{'then, for the paved copy, ' * later}{walkers_cure(town, paved=later)}"
        words = shlex.split(town.file.rebuild)
        if "--traffic" in words[:-1] and words[words.index("--traffic") + 1] == "0":
            words[words.index("--traffic") + 1] = "1"
            cure = again_cure(town, "add them", shlex.join(words))
        lines.append(f"the demand has no pedestrians; {cure}")
    if found.unroutable:
        lines.append(
            f"{found.unroutable} trips have no route through the net; to drop or repair them, {routes_cure(town)}"
        )
    return lines


def _overlap(town: Town, over: tuple[Overlap, ...]) -> str:
    total_m2, worst = sum(item.area_m2 for item in over), over[0]
    return (
        f"{total_m2:.0f} m2 of pavement overlap the carriageway of another street without a junction (places of more "
        f"than {LEAST_M2:g} m2): SUMO's pedestrians and cars do not see each other there; the largest: edge "
        f"{worst.pavement} under {worst.street}, {worst.area_m2:.0f} m2; move or delete one of them: "
        f"{netedit_cure(town)}"
    )

"""Build a town's net, and leave out what nobody can walk to."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import Element

from wcsim.errors import TownError
from wcsim.towns.importing.netconvert import NetOrder, convert_net
from wcsim.towns.osm.bridges import cut_bridges
from wcsim.towns.osm.clean import filter_osm, strip_orphans
from wcsim.towns.osm.left_out import NetWays
from wcsim.towns.osm.sidewalk_rules import unpaved_ways, wrongly_paved
from wcsim.towns.sumo.net import LaneKind, Net, read_net
from wcsim.towns.sumo.tools import by_file
from wcsim.towns.sumo.xml_io import xml_bytes
from wcsim.towns.walking.islands import Islands, islands_by_ground, islands_by_links, share_of, walkable_parts, ways_of

log = logging.getLogger("wcsim.towns")

_GOOD_SHARE = 0.965  # of the walkable ground in one part: below it roads on islands go too
_LEAST_LEFT = 0.3  # of the walkable area: a town is not cut down to less than this for the sake of the share
EXTRACT = "clean.osm.xml"


@dataclass(frozen=True, slots=True, kw_only=True)
class BuiltNet:
    """A net, and the share of its walkable ground that hangs together."""

    net: Net
    share: float
    bridges: tuple[str, ...] = ()  # what they are called that were left out, for they pass over other streets
    ways: NetWays = field(default_factory=NetWays)


def build_net(order: NetOrder, root: Element, folder: Path) -> BuiltNet:
    """Write <name>.net.xml and the cleaned extract that it was made of; `root` is changed.

    Raises:
        TownError: the area has no streets, or nothing that can be walked on.
        SumoError: netconvert failed.
    """
    filter_osm(root)
    before = _ids(root)
    bridges = cut_bridges(root, order.keep_service)
    cut = before - _ids(root)
    built = _hanging_together(order, root, folder)
    walkable = {edge.id for edge in built.net.edges if any(lane.permits("pedestrian") for lane in edge.lanes)}
    drawn = ways_of(folder / f"{order.name}.net.xml")
    ways = NetWays(
        given=_ids(root),
        bridges=cut,
        drawn=frozenset(way for made_of in drawn.values() for way in made_of),
        walked=frozenset(way for edge, made_of in drawn.items() if edge in walkable for way in made_of),
    )
    return replace(built, bridges=bridges, ways=ways)


def _ids(root: Element) -> frozenset[str]:
    return frozenset(way.get("id", "").lstrip("-") for way in root.iterfind("way"))


def _hanging_together(order: NetOrder, root: Element, folder: Path) -> BuiltNet:
    net = _converted(order, root, folder)
    found = islands_by_links(net, folder / f"{order.name}.net.xml")
    if found.footways:
        net = _converted(order, root, folder, found.footways)
    parts = walkable_parts(net, order.chair_ways)
    if share_of(parts) < _GOOD_SHARE:
        ground = islands_by_ground(net, folder / f"{order.name}.net.xml", parts)
        if ground.footways | ground.roads:
            smaller = _smaller(order, root, folder, ground)
            if smaller is not None:
                return smaller
            net = _converted(order, root, folder)
    return BuiltNet(net=net, share=share_of(parts))


def _smaller(order: NetOrder, root: Element, folder: Path, before: Islands) -> BuiltNet | None:
    """The net without the ways on islands, or None when that is no gain; then `root` is as before."""
    everything = list(root)
    dropped = before.footways | before.roads
    try:
        net = _converted(order, root, folder, dropped)
        parts = walkable_parts(net, order.chair_ways)
    except TownError:  # nothing is left
        parts = []
    if share_of(parts) > before.share and sum(part.area for part in parts) >= _LEAST_LEFT * before.area_m2:
        log.info("town %s: %d ways on islands were left out", order.name, len(dropped))
        return BuiltNet(net=net, share=share_of(parts))
    root[:] = everything
    return None


def _converted(order: NetOrder, root: Element, folder: Path, dropped: frozenset[str] = frozenset()) -> Net:
    root[:] = [item for item in root if item.tag != "way" or item.get("id", "").lstrip("-") not in dropped]
    strip_orphans(root)
    (folder / EXTRACT).write_bytes(xml_bytes(root))
    net = _read(convert_net(order, EXTRACT, folder))
    if paved := wrongly_paved(net, folder / f"{order.name}.net.xml", unpaved_ways(root)):
        config = folder / "unpaved.netccfg"
        more = (*order.more, *by_file("sidewalks.guess.exclude", paved, config))
        net = _read(convert_net(replace(order, more=more), EXTRACT, folder))
        config.unlink()
    if not net.lanes(LaneKind.WALKINGAREA) and not net.lanes(LaneKind.SIDEWALK, LaneKind.SHARED):
        raise TownError("the area has no pavements; choose a larger or another bounding box")
    return net


def _read(path: Path) -> Net:
    try:
        return read_net(path)
    except TownError:
        raise TownError(
            "the area holds no street that could be built; choose a larger or another bounding box"
        ) from None

"""Crossings that lie upon each other in a net: one of them is taken out.

netconvert builds a crossing on either side of a mapped one, and one over each street of a joined
junction.
"""

from collections.abc import Collection
from pathlib import Path
from xml.etree.ElementTree import Element

import networkx
import shapely

from wcsim.towns.ground.surfaces import lane_area
from wcsim.towns.sumo.net import WALK_KINDS, LaneKind, Net, net_of
from wcsim.towns.sumo.xml_io import read_root, xml_bytes

_SAME = 0.5  # share of the smaller one that lies on the other: then they are one on the ground
_STEPS = 6  # at most, over pavements, walking areas and crossings, past one that is taken out


def drop_crossings(path: Path, denied: Collection[str]) -> None:
    """Take crossings out of a net: those at junctions in `denied`, and one of two upon each other.

    A crossing without which walkers would have to go a long way round stays.
    """
    root = read_root(path)
    net = net_of(root, str(path))
    # Of two that serve alike the shorter one goes: it ends amid the road of the longer one.
    lanes = sorted(net.lanes(LaneKind.CROSSING), key=lambda lane: (lane.length_m, lane.id))
    areas = [lane_area(lane) for lane in lanes]
    tree = shapely.STRtree(areas)
    graph = _walked_edges(net)
    removed = {lane.edge_id for lane in lanes if lane.edge_id[1:].rpartition("_c")[0] in denied}
    for lane, area in zip(lanes, areas, strict=True):
        near = [k for k in tree.query(area).tolist() if lanes[k] is not lane]
        others = [areas[k] for k in near if lanes[k].edge_id not in removed]
        is_double = any(
            area.intersection(other).area > _SAME * min(area.area, other.area) for other in others
        )
        if is_double and lane.edge_id in graph and lane.edge_id not in removed:
            first, *rest = graph.neighbors(lane.edge_id)
            left = graph.subgraph(set(graph) - removed - {lane.edge_id})
            if set(rest) <= networkx.single_source_shortest_path_length(left, first, _STEPS).keys():
                removed.add(lane.edge_id)
    for edge_id in sorted(removed):
        _remove_crossing(root, edge_id)
    if removed:
        path.write_bytes(xml_bytes(root))


def _walked_edges(net: Net) -> networkx.Graph:
    """The edges with lanes for walkers, joined where a link leads from one to another."""
    walked = {
        lane.edge_id for lane in net.lanes(*WALK_KINDS, LaneKind.CROSSING, LaneKind.WALKINGAREA)
    }
    links = ((link.start, link.end) for link in net.connections)
    return networkx.Graph(ends for ends in links if {*ends} <= walked)


def _remove_crossing(root: Element, edge_id: str) -> None:
    """Take a crossing out of a net: its edge, its links, and its right of way.

    The programs of a light keep its letter.
    """
    lane_id = f"{edge_id}_0"
    links = root.findall("connection")
    own = [link for link in links if edge_id in (link.get("from"), link.get("to"))]
    for item in [*own, *root.findall(f"edge[@id='{edge_id}']")]:
        root.remove(item)
    for junction in root.iterfind("junction"):
        inside = junction.get("intLanes", "").split()
        if lane_id not in inside:
            continue
        junction.set("intLanes", " ".join(lane for lane in inside if lane != lane_id))
        # One for each link: those of vehicles, then the crossings in their order.
        requests = junction.findall("request")
        crossings = [lane for lane in inside if lane.startswith(f":{junction.get('id')}_c")]
        number = len(requests) - len(crossings) + crossings.index(lane_id) if requests else 0
        for index, request in enumerate(requests):
            if index == number:
                junction.remove(request)
            request.set("index", str(index - (index > number)))
            # The last bit is that of the first link.
            for key in ("response", "foes"):
                bits, end = request.get(key, ""), len(requests) - number
                request.set(key, bits[: end - 1] + bits[end:])

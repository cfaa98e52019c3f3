"""Cut an area out of an OpenStreetMap extract of any format.

It runs as a child, for libosmium may crash on a broken file.
`python -m wcsim.towns.osm.cut IN FORMAT OUT [W,S,E,N]` writes .osm XML; without a box all of it.
"""

import sys

import osmium
from osmium.index import IdSet

from wcsim.towns.osm.read import Box


def _cut(source: str, file_format: str, out: str, box: Box | None) -> None:
    """Write the nodes in a box, the ways that have one of them, and their nodes and relations."""
    file = osmium.io.File(source, file_format)
    header = osmium.io.Reader(file, osmium.osm.osm_entity_bits.NOTHING).header()
    nodes, ways, needed = osmium.IdTracker(), osmium.IdTracker(), osmium.IdTracker()
    if box is not None:
        # The box is unpacked once: each node of a country is looked at.
        west, south, east, north = box
        for node in osmium.FileProcessor(file, osmium.osm.NODE):
            assert isinstance(node, osmium.osm.Node)  # noqa: S101 - only nodes were requested
            place = node.location
            if place.valid() and west <= place.lon <= east and south <= place.lat <= north:
                nodes.add_node(node.id)
        for way in osmium.FileProcessor(file, osmium.osm.WAY).with_filter(nodes.contains_filter()):
            ways.add_way(way.id)
            needed.add_references(way)
    bounds = osmium.io.Header()
    if box is not None:
        bounds.add_box(osmium.osm.Box(*box))
    elif header.box().valid():
        bounds.add_box(header.box())
    ids = (nodes.node_ids(), needed.node_ids(), ways.way_ids())
    target = osmium.io.File(out, "osm")
    with osmium.SimpleWriter(target, header=bounds, overwrite=True) as writer:
        for item in osmium.FileProcessor(file):
            if box is None or _is_needed(item, *ids):
                writer.add(item)


def _is_needed(item: object, nodes: IdSet, needed: IdSet, ways: IdSet) -> bool:
    if isinstance(item, osmium.osm.Node):
        return item.id in nodes or item.id in needed
    if isinstance(item, osmium.osm.Way):
        return item.id in ways
    members = item.members if isinstance(item, osmium.osm.Relation) else ()
    return any(member.type == "w" and member.ref in ways for member in members)


if __name__ == "__main__":
    _cut(sys.argv[1], sys.argv[2], sys.argv[3], Box.of(sys.argv[4]) if len(sys.argv) > 4 else None)

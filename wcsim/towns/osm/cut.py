"""Cut an area out of an OpenStreetMap extract of any format: run as a child, for libosmium may crash on a broken file.

`python -m wcsim.towns.osm.cut IN FORMAT OUT [W,S,E,N]` writes .osm XML; without a box all of it.
"""

import sys

import osmium
from osmium.index import IdSet

from wcsim.towns.osm.read import Box


def _cut(source: str, file_format: str, out: str, box: Box | None) -> None:
    """Write the nodes in a box, the ways that have one of them, their other nodes, and the relations of those."""
    file = osmium.io.File(source, file_format)
    header = osmium.io.Reader(file, osmium.osm.osm_entity_bits.NOTHING).header()
    nodes, ways, needed = osmium.IdTracker(), osmium.IdTracker(), osmium.IdTracker()
    if box is not None:
        west, south, east, north = box  # unpacked once: each node of a country is looked at
        for node in osmium.FileProcessor(file, osmium.osm.NODE):
            assert isinstance(node, osmium.osm.Node)  # noqa: S101 - only nodes were requested
            place = node.location
            if place.valid() and west <= place.lon <= east and south <= place.lat <= north:
                nodes.add_node(node.id)
        for way in osmium.FileProcessor(file, osmium.osm.WAY).with_filter(nodes.contains_filter()):
            ways.add_way(way.id)
            needed.add_references(way)
    kept = (nodes.node_ids(), needed.node_ids(), ways.way_ids())
    with osmium.SimpleWriter(osmium.io.File(out, "osm"), header=_bounds(header, box), overwrite=True) as writer:
        for item in osmium.FileProcessor(file):
            if box is None or _is_kept(item, *kept):
                writer.add(item)


def _is_kept(item: object, nodes: IdSet, needed: IdSet, ways: IdSet) -> bool:
    if isinstance(item, osmium.osm.Node):
        return item.id in nodes or item.id in needed
    if isinstance(item, osmium.osm.Way):
        return item.id in ways
    return isinstance(item, osmium.osm.Relation) and any(m.type == "w" and m.ref in ways for m in item.members)


def _bounds(header: osmium.io.Header, box: Box | None) -> osmium.io.Header:
    made = osmium.io.Header()
    if box is not None:
        made.add_box(osmium.osm.Box(*box))
    elif header.box().valid():
        made.add_box(header.box())
    return made


if __name__ == "__main__":
    _cut(sys.argv[1], sys.argv[2], sys.argv[3], Box.of(sys.argv[4]) if len(sys.argv) > 4 else None)

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from wcsim.towns.osm.left_out import LeftOut, crossings_inside, left_out_note, left_out_of, ways_inside

BOX = (25.0, 60.0, 25.01, 60.01)
TEXT = """<osm>
    <node id="1" lon="25.001" lat="60.005"/><node id="2" lon="25.005" lat="60.005"/>
    <node id="3" lon="25.005" lat="60.009"><tag k="highway" v="crossing"/></node>
    <node id="4" lon="25.03" lat="60.009"><tag k="highway" v="crossing"/></node>
    <way id="10"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/><tag k="name" v="Long Street"/></way>
    <way id="11"><nd ref="2"/><nd ref="3"/><nd ref="4"/><tag k="highway" v="footway"/><tag k="name" v="Path"/></way>
    <way id="12"><nd ref="1"/><nd ref="3"/><tag k="highway" v="primary"/><tag k="tunnel" v="yes"/></way>
    <way id="13"><nd ref="1"/><nd ref="3"/><tag k="highway" v="service"/></way>
    <way id="14"><nd ref="4"/><nd ref="4"/><tag k="highway" v="primary"/></way>
</osm>"""


def test_what_the_net_does_not_have_is_told_by_length_and_name() -> None:
    ways = ways_inside(ElementTree.fromstring(TEXT), BOX)  # noqa: S314 - our own
    assert {way.id: (way.street, way.name) for way in ways} == {"10": (True, "Long Street"), "11": (False, "Path")}
    lengths_m = {way.id: way.inside_m for way in ways}
    assert lengths_m["10"] == pytest.approx(222.6, rel=0.01) and lengths_m["11"] == pytest.approx(445.3, rel=0.01)
    found = left_out_of(ways, {"10"})
    assert found.names == ("Path",) and found.streets_left_out_m == 0.0
    assert found.footways_left_out_m == found.footways_m == lengths_m["11"]
    told = left_out_note(found)
    assert "0.00 km of 0.22 km of streets and 0.45 km of 0.45 km of ways on foot" in told and "(Path);" in told
    assert left_out_note(left_out_of(ways, {"10", "11"})) == left_out_note(LeftOut()) == ""


def test_crossings_of_the_map_are_those_in_the_box() -> None:
    assert crossings_inside(ElementTree.fromstring(TEXT), BOX) == 1  # noqa: S314 - our own

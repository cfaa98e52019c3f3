from xml.etree import ElementTree

import pytest

from wcsim.towns.osm.clean import (
    MOST_FOOTWAYS,
    LeftOut,
    _MapWay,
    count_inside,
    map_ways,
)
from wcsim.towns.osm.read import Box

BOX = Box(25.0, 60.0, 25.01, 60.01)
TEXT = """<osm>
    <node id="1" lon="25.001" lat="60.005"/><node id="2" lon="25.005" lat="60.005"/>
    <node id="3" lon="25.005" lat="60.009"><tag k="highway" v="crossing"/></node>
    <node id="4" lon="25.03" lat="60.009"><tag k="highway" v="crossing"/></node>
    <node id="5" lon="25.006" lat="60.005"/><node id="6" lon="25.006" lat="60.006"/>
    <node id="7" lon="25.007" lat="60.006"/>
    <way id="10"><nd ref="1"/><nd ref="2"/><tag k="highway" v="residential"/><tag k="name" v="Long Street"/></way>
    <way id="11"><nd ref="2"/><nd ref="3"/><nd ref="4"/><tag k="highway" v="footway"/><tag k="name" v="Path"/></way>
    <way id="12"><nd ref="1"/><nd ref="3"/><tag k="highway" v="primary"/><tag k="tunnel" v="yes"/></way>
    <way id="13"><nd ref="1"/><nd ref="3"/><tag k="highway" v="service"/></way>
    <way id="14"><nd ref="4"/><nd ref="4"/><tag k="highway" v="primary"/></way>
    {more}
</osm>"""
_ON_FOOT = {
    "highway=steps": "steps",
    "highway=path tunnel=yes": "a tunnel, indoors, or on another level",
    "highway=pedestrian area=yes": "an open area",
    "highway=footway area=yes": "an area",
    "highway=path access=private": "closed to the public",
    "highway=footway": "",
    "highway=cycleway foot=designated": "",
    "highway=path": "",
    "highway=pedestrian": "",
    "highway=cycleway": None,
    "highway=path foot=no": None,
}


def inside(more: str = "") -> tuple[_MapWay, ...]:
    return map_ways(ElementTree.fromstring(TEXT.format(more=more)), BOX)  # noqa: S314 - our own


def test_what_the_net_does_not_have_is_told_by_length_and_name() -> None:
    ways = inside()
    assert {way.id: (way.street, way.name) for way in ways} == {"10": (True, "Long Street"), "11": (False, "Path")}
    lengths_m = {way.id: way.inside_m for way in ways}
    assert lengths_m["10"] == pytest.approx(222.6, rel=0.01) and lengths_m["11"] == pytest.approx(445.3, rel=0.01)
    both = frozenset(("10", "11"))
    found = LeftOut.of(ways, both, frozenset(("10",)))
    assert found.names == () and found.streets_left_out_m == 0.0
    assert found.footways_left_out_m == found.footways_m == lengths_m["11"]
    (told,) = found.notes
    assert "445 of 445 m of footways" in told and ": 11 Path (445 m)" in told
    (street, _) = LeftOut.of(ways, frozenset(), frozenset()).notes
    assert "0.22 km of 0.22 km of streets" in street and "(Long Street);" in street
    assert LeftOut.of(ways, both, both).notes == LeftOut().notes == ()


def test_each_lost_way_on_foot_is_named_with_why_and_all_add_up() -> None:
    text = ""
    for number, tags in enumerate(_ON_FOOT):
        told = "".join('<tag k="{}" v="{}"/>'.format(*tag.split("=")) for tag in tags.split())
        text += f'<way id="-{100 + number}"><nd ref="2"/><nd ref="6"/>{told}</way>'
    tags = '<tag k="type" v="multipolygon"/><tag k="highway" v="pedestrian"/>'
    text += f'<relation id="7"><member type="way" ref="13" role="outer"/>{tags}</relation>'
    ways = inside(text)
    found = LeftOut.of(ways, frozenset(("10", "106")), frozenset())
    whys = [*_ON_FOOT.values()]
    assert {way.id: way.why for way in found.footways} == {
        "11": "",
        "relation 7": "an open area",
        **{str(100 + number): why for number, why in enumerate(whys) if why is not None},
    }
    assert sum(way.inside_m for way in found.footways) == pytest.approx(found.footways_m)
    (told,) = found.notes
    assert told.count("(") == MOST_FOOTWAYS + 1 and ", and 1 more (" in told
    some = LeftOut.of(ways, frozenset(("10", "11")), frozenset(("11",)))
    kept_m = next(way.inside_m for way in ways if way.id == "11")
    assert kept_m + some.footways_left_out_m == pytest.approx(some.footways_m)


def test_crossings_of_the_map_are_those_in_the_box() -> None:
    assert count_inside(ElementTree.fromstring(TEXT.format(more="")), BOX, "crossing") == 1  # noqa: S314 - our own

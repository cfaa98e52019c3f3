import bz2
import gzip
from pathlib import Path

import osmium
import pytest

from tests.cli.towns import tiny_osm
from wcsim.errors import TownError
from wcsim.towns.osm import read
from wcsim.towns.osm.read import Box, read_extract

TINY = tiny_osm().encode()
BOX = Box(24.999, 59.9995, 25.0046, 60.0023)


def as_pbf(path: Path) -> Path:
    out = path.with_suffix(".osm.pbf")
    with osmium.SimpleWriter(str(out)) as writer:
        for item in osmium.FileProcessor(str(path)):
            writer.add(item)
    return out


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.osm"
    path.write_text(tiny_osm(), encoding="utf-8")
    return path


@pytest.mark.parametrize("box", [BOX, None])
def test_every_format_gives_the_same_extract(tiny: Path, box: Box | None) -> None:
    data = tiny.read_bytes()
    tiny.with_name("a.osm.xml.gz").write_bytes(gzip.compress(data))
    tiny.with_name("b.osm.bz2").write_bytes(bz2.compress(data))
    tiny.with_name("misnamed.gz").write_bytes(data)
    wanted = read_extract(tiny, box)
    assert len(wanted.root) == 20
    for path in (*tiny.parent.glob("*.*z*"), tiny.with_name("misnamed.gz"), as_pbf(tiny)):
        found = read_extract(path, box)
        assert (found.xml(), found.box) == (wanted.xml(), wanted.box), path.name


def test_a_pbf_that_was_cut_off_is_told_apart(tiny: Path) -> None:
    data = as_pbf(tiny).read_bytes()
    tiny.with_name("b.osm.pbf").write_bytes(data[:-200])
    with pytest.raises(TownError, match=r"ends in the middle; .*: download it again"):
        read_extract(tiny.with_name("b.osm.pbf"), BOX)


def test_o5m_gives_the_same_extract(tmp_path: Path) -> None:
    # Three nodes and a residential street through them: differences of ids and of degrees times 10 million.
    data = (
        "ffe0046f356d32100c020080cab5ee0180989abc0410060200a09c01001006020000a0"
        "9c01ff111b0a00030202020068696768776179007265736964656e7469616c00fe"
    )
    (tmp_path / "a.o5m").write_bytes(bytes.fromhex(data))
    root = read_extract(tmp_path / "a.o5m").root
    assert [each.get("lat") for each in root.iterfind("node")] == ["60.0000000", "60.0000000", "60.0010000"]
    assert [nd.get("ref") for nd in root.iter("nd")] == ["1", "2", "3"]


def test_a_box_that_is_too_large_is_answered_with_one_that_has_streets(tmp_path: Path) -> None:
    far = TINY.replace(b'lat="60.', b'lat="60.2').replace(b'lon="25.', b'lon="25.3').replace(b'id="', b'id="9')
    both = TINY.replace(b"</osm>", far[far.index(b"<node") :].replace(b'ref="', b'ref="9'))
    for name, box in (("a.osm", None), ("b.osm", Box(24.9, 59.9, 25.5, 60.5))):
        (tmp_path / name).write_bytes(both)
        with pytest.raises(TownError, match="where most streets are: --bbox=") as caught:
            read_extract(tmp_path / name, box)
        told = Box.of(str(caught.value).partition("--bbox=")[2])
        assert 1100.0 < min(told.size_m) <= max(told.size_m) < 1300.0
        assert len(read_extract(tmp_path / name, told).root) == 20


def test_a_pbf_keeps_the_box_of_its_header(tiny: Path) -> None:
    header = osmium.io.Header()
    header.add_box(osmium.osm.Box(25.0, 60.0, 25.002, 60.001))
    with osmium.SimpleWriter(str(tiny.with_name("b.osm.pbf")), header=header) as writer:
        for item in osmium.FileProcessor(str(tiny)):
            writer.add(item)
    assert read_extract(tiny.with_name("b.osm.pbf")).box == (25.0, 60.0, 25.002, 60.001)


def test_a_large_extract_is_cut_by_libosmium_to_the_same(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = tiny.with_name("a.osm.gz")
    packed.write_bytes(gzip.compress(tiny.read_bytes()))
    small = Box(25.0, 60.0, 25.0015, 60.0008)
    wanted = read_extract(tiny, small).xml()
    monkeypatch.setattr(read, "SMALL_BYTES", 100)
    assert read_extract(tiny, small).xml() == read_extract(packed, small).xml() == wanted


def test_without_a_box_the_extract_says_how_far_it_goes(tiny: Path) -> None:
    cover = read_extract(tiny).box
    assert (24.9999, 59.9999) < cover[:2] < (25.0, 60.0) and (25.0036, 60.0018) < cover[2:] < (25.0037, 60.0019)
    text = tiny.read_text(encoding="utf-8")
    bounds = '<bounds minlat="60" minlon="25" maxlat="60.001" maxlon="25.002"/>'
    tiny.write_text(text.replace('<osm version="0.6">', f'<osm version="0.6">{bounds}'), encoding="utf-8")
    assert read_extract(tiny).box == (25.0, 60.0, 25.002, 60.001)
    wide = bounds.replace('maxlon="25.002"', 'maxlon="29"')
    tiny.write_text(text.replace('<osm version="0.6">', f'<osm version="0.6">{wide}'), encoding="utf-8")
    assert max(read_extract(tiny).box.size_m) < 400.0, "bounds that cannot be a town's are not believed"


def test_what_dangles_is_left_out(tiny: Path) -> None:
    text = tiny.read_text(encoding="utf-8")
    more = [
        '<node id="900" lat="60.0001"/><node id="901" lon="25"/><node id="x" lat="60" lon="25"/>',
        '<node id="1" lat="61" lon="25"/><node id="902" lat="60.0002" lon="25.0001" action="delete"/>',
        '<node id="903" lat="60.0003" lon="-179.9"/>',
        '<way id="904"><nd ref="1"/><nd ref="77777"/><nd ref="903"/><tag k="highway" v="residential"/></way>',
        '<way id="905"><nd ref="1"/><nd ref="903"/><nd ref="2"/><tag k="highway" v="residential"/></way>',
        '<relation id="906"><member type="way" ref="88888" role="outer"/></relation><bogus/>',
    ]
    tiny.write_text(text.replace("</osm>", "".join(more) + "</osm>"), encoding="utf-8")
    root = read_extract(tiny, BOX).root
    ids = {item.get("id") for item in root}
    assert ids.isdisjoint({"900", "901", "x", "902", "903", "904", "906"}) and "905" in ids
    (way,) = [item for item in root if item.get("id") == "905"]
    assert [nd.get("ref") for nd in way.iterfind("nd")] == ["1", "2"]
    assert len([item for item in root if item.get("id") == "1"]) == 1


def test_names_of_mappers_are_not_kept(tiny: Path) -> None:
    text = tiny.read_text(encoding="utf-8").replace('version="1"', 'version="1" user="someone" uid="7" timestamp="t"')
    tiny.write_text(text, encoding="utf-8")
    assert b"someone" not in read_extract(tiny, BOX).xml()


@pytest.mark.parametrize(
    ("name", "data", "told"),
    [
        ("a.osm", b"", "not well-formed XML"),
        ("a.osm", b"<osm/>", "streets in it"),
        ("a.osm", b'<osm><node id="7" lat="60" lon="nan"/></osm>', "node 7 lies at nan, 60; expected degrees"),
        ("a.osm", b'<osm><node id="7" lat="-inf" lon="25"/></osm>', "node 7 lies at 25, -inf"),
        ("a.osm", b'<osm><node id="7" lat="91" lon="east"/></osm>', "node 7 lies at east, 91"),
        ("a.osm.gz", gzip.compress(b"<osm>" + bytes(range(256)) * 40)[:200], "cannot be read"),
        ("a.osm.bz2", bz2.compress(b"<osm>" * 500)[:40], "cannot be read"),
        ("a.osm.bz2", b"BZh9 rubbish", "cannot be read"),
        ("a.osm.pbf", b"rubbish", "not a .pbf file"),
        ("a.osm.pbf", b"\0\0\0\x0d\n\x09OSMHeader\x18\x04rubbish", "cannot be read as an extract"),
        ("a.osm", TINY[:900], "ends in the middle; expected .*: download it again"),
        (
            "a.osm",
            TINY.replace(b'v="both"', b'v="both"/><tag k="width:lanes" v="3|NaN"'),
            "way 109 has width:lanes='3|NaN'",
        ),
        (
            "a.osm",
            TINY.replace(b'k="building" v="yes"', b'k="height" v="1e999"'),
            "way 200 has height='1e999'; expected a number",
        ),
        ("a.osm.gz", gzip.compress(TINY, mtime=0)[:-60], "ends in the middle"),
        ("a.osm.bz2", bz2.compress(TINY)[:-60], "ends in the middle"),
        ("a.osm", TINY.replace(b"<node", b"<n"), r"6 of its 6 streets have no nodes.*\(\._;>;\); out body;"),
        ("a.osm", b"<osm><remark>Query timed out</remark></osm>", "the server said: Query timed out"),
        ("a.osm.gz", gzip.compress(b'{"version": 0.6, "osm3s": {}}', mtime=0), r"is JSON of Overpass.*\[out:xml\]"),
        ("a.json", b'\n[{"type": "Feature"}]', "is GeoJSON.*raw OpenStreetMap data"),
        ("a.json", b"[]", "is JSON, not XML"),
        ("a.osc.bz2", bz2.compress(b"<osmChange/>"), "osmium apply-changes EXTRACT /.*a.osc.bz2 -o"),
        ("a.o5m", b"\xff\xe0\x04o5c2\xfe", "is a file of changes"),
        ("a.osm", b'<?xml version="1.0"?>\n<!DOCTYPE html>', "is a web page"),
        ("a.xodr", b"<OpenDRIVE/>", "import it with --opendrive /.*a.xodr"),
        ("a.zip", b"PK\x03\x04", "packed as zip"),
        ("a.osm.xz", b"\xfd7zXZ\0", "packed as xz"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, name: str, data: bytes, told: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(TownError, match=told) as caught:
        read_extract(path, BOX)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_a_box_elsewhere_is_answered_with_where_the_streets_are(tiny: Path) -> None:
    with pytest.raises(TownError, match=r"its streets are in 24\.9999\d,59\.9999\d,25\.0036\d,60\.0018\d") as caught:
        read_extract(tiny, Box(4.9, 59.9, 5.0, 60.0))
    assert len(read_extract(tiny, Box.of(str(caught.value).partition("--bbox=")[2])).root) == 20


def test_elements_that_are_no_map_are_left_out(tiny: Path) -> None:
    """SUMO's tools follow an <include> wherever it stands."""
    text = tiny.read_text(encoding="utf-8").replace('<nd ref="11"/>', '<include href="/etc/hostname"/><nd ref="11"/>')
    assert "include" in text
    tiny.write_text(text, encoding="utf-8")
    assert {child.tag for item in read_extract(tiny).root for child in item} == {"nd", "tag"}


def test_a_small_file_that_unpacks_to_a_large_one_is_refused_at_once(tmp_path: Path) -> None:
    packer = bz2.BZ2Compressor()
    blanks = b"".join(packer.compress(b" " * (1 << 20)) for _ in range(60)) + packer.flush()
    (tmp_path / "a.osm.bz2").write_bytes(blanks)
    (tmp_path / "b.osm.bz2").write_bytes(bz2.compress(b"<osm") + blanks)
    (tmp_path / "c.osm.gz").write_bytes(gzip.compress(b"<osm>" + b" " * (220 << 20), 1))
    (tmp_path / "d.osm").write_bytes(b"<osm>" + b" " * (60 << 20))
    with (tmp_path / "e.osm").open("wb") as sparse:
        sparse.write(b"<osm>")
        sparse.truncate(20 << 30)
    for path in sorted(tmp_path.iterdir()):  # libosmium would look for the end of the tag until it is stopped
        with pytest.raises(TownError, match=r"MiB of XML|not well-formed|a tag"):
            read_extract(path, None if path.name.startswith("c") else BOX)

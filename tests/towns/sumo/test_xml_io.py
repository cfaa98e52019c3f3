"""XML that one parser would read in another way than the next one does not get in."""

import bz2
import gzip
import io
import os
import time
import zlib
from functools import partial
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import pytest

from wcsim.errors import TownError
from wcsim.towns.scenario.town import net_middle
from wcsim.towns.sumo.additional import read_items
from wcsim.towns.sumo.xml_io import (
    MAX_MEMBERS,
    MAX_NESTING,
    _Gunzip,
    _unpack,
    is_true,
    parse_root,
    read_bytes,
    read_root,
    scan,
    without_comments,
    xml_bytes,
)

BODY = '<additional><edgeData id="x" file="/anywhere"/></additional>'


def declared(encoding: str, version: str = "1.0") -> str:
    return f'<?xml version="{version}" encoding="{encoding}"?>{BODY}'


REFUSED = {
    "EBCDIC": declared("ebcdic-cp-us").encode("cp037"),
    "EBCDIC 500": declared("cp500").encode("cp500"),
    "EBCDIC 1140": declared("ibm1140").encode("cp1140"),
    "UTF-16": declared("UTF-16").encode("utf-16"),
    "UTF-16 LE without mark": BODY.encode("utf-16-le"),
    "UTF-16 BE without mark": BODY.encode("utf-16-be"),
    "UTF-32": BODY.encode("utf-32"),
    "UTF-32 BE without mark": BODY.encode("utf-32-be"),
    "UTF-7": declared("utf-7").encode("utf-7"),
    "declared UTF-16, is UTF-8": declared("UTF-16").encode(),
    "declared EBCDIC, is UTF-8": declared("ebcdic-cp-us").encode(),
    "declared far behind": f'<?xml version="1.0"{" " * 3000}encoding="ebcdic-cp-us"?>{BODY}'.encode(),
    "two marks": b"\xef\xbb\xbf\xef\xbb\xbf" + BODY.encode(),
    "the mark of UTF-16, then UTF-8": b"\xff\xfe" + BODY.encode(),
    "XML 1.1": declared("utf-8", "1.1").encode(),
    "XML 1.1, blanks of its own": b'<?xml version="1.1"?><a\xc2\x85file="x"/>',
    "declaration after a blank": b" " + declared("ebcdic-cp-us").encode(),
    "document type": b"<!DOCTYPE a>" + BODY.encode(),
    "NUL": BODY.encode().replace(b"id", b"i\0d"),
    "zlib, not gzip": zlib.compress(BODY.encode()),
    "gzip, then zlib": gzip.compress(b"<!-- -->") + zlib.compress(BODY.encode()),
    "packed twice": gzip.compress(gzip.compress(BODY.encode())),
    "nothing": b"",
    "blanks": b" \n" * 100,
    "deep": b"<a>" * (MAX_NESTING + 1) + b"</a>" * (MAX_NESTING + 1),
    "very deep": b"<a>" * 100_000 + b"</a>" * 100_000,
    "endless tag": b"<a" + b" " * (3 << 20) + b"/>",
    "broken": BODY.encode()[:-3],
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_could_be_read_in_two_ways_is_refused_by_every_door(name: str, tmp_path: Path) -> None:
    path = tmp_path / "x.xml"
    path.write_bytes(REFUSED[name])
    with pytest.raises(TownError, match=r"x\.xml: "):
        read_root(path)
    with pytest.raises(TownError, match=r"x\.xml: "):
        scan(read_bytes(path), str(path), lambda tag, attributes: None)


@pytest.mark.parametrize("encoding", ["UTF-8", "us-ascii", "ISO-8859-1", "iso-8859-15", "windows-1252"])
def test_relatives_of_ascii_are_read(encoding: str) -> None:
    text = declared(encoding).replace("anywhere", "anywhere" if "ascii" in encoding else "\u00e4")
    for data in (
        text.encode(encoding),
        b"\xef\xbb\xbf" + text.encode() if encoding == "UTF-8" else text.encode(encoding),
    ):
        assert parse_root(data, "x")[0].get("file") == ("/anywhere" if "ascii" in encoding else "/\u00e4")
        seen: list[tuple[str, list[str]]] = []
        scan(data, "x", lambda tag, attributes, seen=seen: seen.append((tag, attributes)))
        assert [tag for tag, _ in seen] == ["additional", "edgeData"]


def test_no_file_that_is_none_is_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero"), Path("a\0b"), tmp_path / "none"):
        with pytest.raises(TownError, match="expected an XML file"):
            read_root(path)


def test_unpacking_is_bounded_in_size_and_pieces() -> None:
    for pack, unpack in (
        (gzip.compress, partial(_unpack, make=_Gunzip)),
        (bz2.compress, partial(_unpack, make=bz2.BZ2Decompressor)),
    ):
        bomb = pack(b" " * (64 << 20))
        assert unpack(io.BytesIO(bomb), 1000) == b" " * 1000
        assert unpack(io.BytesIO(pack(b"ab") + pack(b"cd")), 100) == b"abcd"
        with pytest.raises(EOFError, match="ends too early"):
            unpack(io.BytesIO(pack(b"abcd")[:-3]), 100)
        many = io.BytesIO(pack(b"") * (MAX_MEMBERS * 20))
        with pytest.raises(EOFError, match="pieces"):
            unpack(many, 100)
        assert many.tell() < 2 * MAX_MEMBERS * len(pack(b""))  # what lies behind is not even read


def test_comments_are_taken_out() -> None:
    for text, left in (
        (b"<!-- a -->\n <a/><!----><b/>", b"<a/><b/>"),
        (b"<a/><!-- <!-- --> --><b/>", b"<a/>--><b/>"),
        (b"<!--><a/>-->", b""),
        (b"<a/><!-- open", b"<a/><!-- open"),
        (b"<a/>", b"<a/>"),
    ):
        assert without_comments(text) == left


def test_what_is_looked_for_in_a_file_takes_a_time_in_proportion_to_its_length(tmp_path: Path) -> None:
    def cost_s(size: int) -> float:
        net = tmp_path / "a.net.xml"
        net.write_bytes(b"<location " * size + b"<net/>")
        costs_s = []
        for _ in range(3):
            begun_s = time.process_time()
            without_comments(b"<!--" * size)
            with pytest.raises(TownError):
                net_middle(net)
            costs_s.append(time.process_time() - begun_s)
        return min(costs_s)

    assert cost_s(80_000) < 60 * cost_s(5_000)  # 16 for a proportion, 256 for a square


def test_xml_bytes_are_those_of_the_library():
    text = '<osm v="0.6"><way id="1" name="Straße &quot;&lt;&amp;&#10; 北"/><t>a &lt; b &#128512;</t></osm>'
    root = parse_root(text.encode(), "a map")
    root.append(Element("tag", {"k": "lone \ud800 surrogate"}))
    assert xml_bytes(root) == ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


@pytest.mark.parametrize("text", ["1", "true", "True", "yes", "on", "x", "t"])
def test_booleans_are_true_where_sumo_takes_them_for_true(tmp_path, text):
    assert is_true(text) and not any(map(is_true, ("", "0", "false", "no", "off", "-", "f", "2")))
    file = tmp_path / "a.poly.xml"
    file.write_text(f'<additional><poly id="a" type="building" fill="{text}" shape="0,0 9,0 9,9"/></additional>')
    assert read_items((file,), (0, 0))[0].filled

"""Areas on the globe, and an OpenStreetMap extract of one, as clean elements with nothing dangling.

Areas are in degrees, as OpenStreetMap and SUMO's tools take them; an extract may have any common format. Or download
one with SUMO's own tool, osmGet.py, in a child process under limits.

The driving side: the time zone of a place gives the country, and the country gives the side.
"""

from __future__ import annotations

import math
import os
import re
import shlex
import sys
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from wcsim.core.frames import deg2rad
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import EXTRACT, escape, open_regular_file, read_file_size, read_module_toml
from wcsim.errors import SumoError, TownError
from wcsim.towns.sumo.tools import Limits, run_child, sumo_home
from wcsim.towns.sumo.xml_io import (
    MAX_TAG_BYTES,
    MAX_TAGS,
    MAX_XML_BYTES,
    check_plain_xml,
    parse_root,
    unpack,
    xml_bytes,
)

LONGEST_M = 12_000.0  # of a side: netconvert and the street mesh of more take minutes and gigabytes
_M_PER_DEG = 111_320.0

_DATA = read_module_toml(__file__)
_LEFT = frozenset(f"{region}/{city}" for region, cities in _DATA["left"].items() for city in cities.split())
"""IANA time zones of the countries and territories that drive on the left."""
_SHARED = "Asia/Bangkok"  # of Thailand, and of Vietnam north of the 17th parallel, where traffic keeps right
_VIETNAM_DEG = ((105.0, 16.5), (102.0, 18.55))  # of that zone, what lies east and north of either; Laos lies between


class Box(NamedTuple):
    """An area on the globe, in degrees."""

    west: float
    south: float
    east: float
    north: float

    @classmethod
    def of(cls, text: str) -> Box:
        """The box of "west,south,east,north". Raises ValueError."""
        west, south, east, north = (float(part) for part in text.split(","))
        return cls(west, south, east, north)

    def check(self, part: Box | None = None) -> None:
        """Raise TownError unless it is one that a town can be made of; `part` is one of it that is."""
        if not (-180 <= self.west < self.east <= 180 and -84 <= self.south < self.north <= 84):
            raise TownError(
                f"--bbox {tuple(self)} is empty or outside of the globe; expected west < east and south < north, in "
                "degrees, from -84 to 84 north"
            )
        wide_m, high_m = self.size_m
        if max(wide_m, high_m) > LONGEST_M:
            where = f", such as where most streets are: {part.option}" if part is not None else ""
            raise TownError(
                f"the bounding box is {wide_m / 1e3:.0f} x {high_m / 1e3:.0f} km; expected at most "
                f"{LONGEST_M / 1e3:.0f} km each way: choose a part of it{where}"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres."""
        wide_m = (self.east - self.west) * _M_PER_DEG * math.cos(deg2rad((self.south + self.north) / 2))
        return wide_m, (self.north - self.south) * _M_PER_DEG

    @property
    def centre(self) -> tuple[float, float]:
        """Longitude and latitude of its middle."""
        return (self.west + self.east) / 2, (self.south + self.north) / 2

    @property
    def option(self) -> str:
        """As the command line takes it."""
        return f"--bbox={','.join(map(str, self))}"

    def grown(self, margin_m: float) -> Box:
        """The same with a margin in metres on each side, within the globe."""
        high = margin_m / _M_PER_DEG
        wide = high / max(0.05, math.cos(deg2rad((self.south + self.north) / 2)))
        west, south = max(-180.0, self.west - wide), max(-90.0, self.south - high)
        return Box(west, south, min(180.0, self.east + wide), min(90.0, self.north + high))

    def holds(self, place: tuple[float, float]) -> bool:
        """Whether a place (longitude, latitude) lies in it."""
        return self.west <= place[0] <= self.east and self.south <= place[1] <= self.north


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """The side of the street that traffic keeps to, and why it is believed to."""

    lefthand: bool
    why: str

    def __str__(self) -> str:
        """In words: "left (time zone Asia/Tokyo)"."""
        return f"{'left' if self.lefthand else 'right'} ({self.why})"


def side_at(longitude_deg: float, latitude_deg: float) -> Side:
    """The side on which traffic drives at a place; on the right where no country is known.

    >>> str(side_at(139.70, 35.68)), str(side_at(1.86, 50.95))
    ('left (time zone Asia/Tokyo)', 'right (time zone Europe/Paris)')
    """
    from timezonefinder import TimezoneFinder  # half a second, which only an import needs

    zone = TimezoneFinder().timezone_at(lng=longitude_deg, lat=latitude_deg)
    known = zone is not None and not zone.startswith("Etc/")  # those lie at sea
    if zone == _SHARED and any(longitude_deg > west and latitude_deg > south for west, south in _VIETNAM_DEG):
        return Side(lefthand=False, why=f"Vietnam, in time zone {zone}")
    return Side(lefthand=zone in _LEFT, why=f"time zone {zone}" if known else "country unknown")


SMALL_BYTES = 48 << 20  # of XML; more is cut by libosmium first, which is faster and needs less memory
MARGIN_M = 150.0  # around the box: buildings and trees beside streets that reach out of it
FAR_M = 20_000.0  # nodes farther outside are left out of their ways: ferries, or the other side of the 180th meridian
EXPECTED = f"expected {EXTRACT.what}"
_ENDS = re.compile("ends too early|EOF|no element found|unclosed")  # how parsers and unpackers call a lost end
_HEAD_BYTES = 4096
_CELL_M = 1200.0  # along a side of the box that is proposed: a hundredth of a degree, and a little
_LIMITS = Limits(wall_s=90.0, cpu_s=120, memory_bytes=6 << 30, file_bytes=MAX_XML_BYTES)
_MEASURE = re.compile("width|height|speed|lanes|layer|level|incline|^ele$")  # of keys whose values are numbers
_NO_NUMBER = re.compile(r"(?i)(^|[|;\s])[+-]?(nan|inf|infinity|\d[\d.]*e\+?\d{3,})($|[|;\s])")
_CHILDREN = ("nd", "tag", "member")  # SUMO's tools follow an <include>, and die of one that names nothing
WAIT_S = 120.0
_CURE = "try again later or with another --url, or download the area by hand and pass it with --osm FILE"


@dataclass(frozen=True, slots=True, kw_only=True)
class Extract:
    """An extract cut to `box`: every node has a place, every way at least two nodes that are there."""

    root: Element
    box: Box
    bounded: bool = True  # the box was ordered, or is the extract's own; else it is the reach of its streets

    def xml(self) -> bytes:
        """As .osm XML."""
        return xml_bytes(self.root)


def read_extract(path: Path, box: Box | None = None) -> Extract:
    """Read and cut an extract; without a box it is taken at its own bounds, or at those of its streets.

    Raises TownError when it is no extract, or holds no streets there.
    """
    try:
        root = parse_root(_xml_of(path, box), str(path))
    except TownError as error:
        if _ENDS.search(str(error)):
            why = "cannot be read, for it ends in the middle"
            raise TownError(f"{escape(path)}: {why}; {EXPECTED}: download it again") from None
        raise
    if root.tag != "osm":
        other = f"is not an OpenStreetMap extract (root <{root.tag}>): export the area as raw OpenStreetMap data (.osm)"
        raise _other(path, _DATA["roots"].get(root.tag, other))
    places = _places(root, path)
    nodes = _street_nodes(root, places, path)
    cover, named = _cover(nodes), box or _bounds(root)
    try:
        box = named or cover
        box.check(_densest([place for place in nodes if box.holds(place)] or nodes))
        _cut(root, places, box)
    except TownError as error:
        raise TownError(f"{path}: {error}") from None
    if not _streets(root):
        cover_text = ",".join(f"{value:.5f}" for value in cover)
        raise TownError(
            f"{path}: no street lies in the bounding box {tuple(box)}; its streets are in {cover_text}: choose a box "
            f"there, such as where most of them are: {_densest(nodes).option}"
        )
    return Extract(root=root, box=box, bounded=named is not None)


def _street_nodes(root: Element, places: dict[str, tuple[float, float]], path: Path) -> list[tuple[float, float]]:
    """The places of the nodes of all streets. Raises TownError where there are none, or most streets have none."""
    streets = _streets(root)
    found = [[places[ref] for nd in way.iterfind("nd") if (ref := nd.get("ref", "")) in places] for way in streets]
    bare = sum(len(ends) < 2 for ends in found)
    if 2 * bare > len(streets):
        raise TownError(
            f"{path}: {bare} of its {len(streets)} streets have no nodes, as after Overpass' out geom; {EXPECTED}, "
            "with nodes: end the query with (._;>;); out body;"
        )
    if not streets:
        remark = root.findtext("remark", "").strip()
        said = f" (the server said: {escape(remark, 200)})" if remark else ""
        raise TownError(f"{path}: is not an OpenStreetMap extract with streets in it{said}; {EXPECTED}, with streets")
    return [place for ends in found for place in ends]


def _xml_of(path: Path, box: Box | None) -> bytes:
    kind = _kind(path)
    if kind in ("pbf", "o5m"):
        return _cut_by_osmium(path, kind, box)
    if kind == "osm" and read_file_size(path, EXTRACT) > SMALL_BYTES:
        _require_tags(path)
        return _cut_by_osmium(path, kind, box)
    most = 4 * MAX_XML_BYTES if box is not None else MAX_XML_BYTES
    data = _unpacked(path, most + 1)
    if len(data) > most:
        raise TownError(f"{escape(path)}: more than {most >> 20} MiB of XML; clip it to a smaller area")
    if len(data) > SMALL_BYTES and box is not None:
        check_plain_xml(data, escape(path), 8 * MAX_TAGS)
        return _cut_by_osmium(path, {"gz": "osm.gz", "bz2": "osm.bz2"}.get(kind, "osm"), box)
    return data


def _kind(path: Path) -> str:
    """How a file is packed, by its first bytes: names say it wrongly too often. Raises TownError."""
    with open_regular_file(path, EXTRACT) as file:
        head = file.read(64)
    if b"OSMHeader" in head:
        return "pbf"
    # What it is shows when it is unpacked.
    beginning = _unpacked(path, _HEAD_BYTES).decode("latin-1").lstrip("\xef\xbb\xbf \t\r\n")
    for pattern, told in _DATA["others"].items():
        if re.match(pattern, beginning):
            raise _other(path, told)
    if path.suffix == ".pbf":
        raise TownError(f"{path}: is not a .pbf file; {EXPECTED}: download it again, or check it: osmium fileinfo")
    kinds = {"\x1f\x8b": "gz", "BZ": "bz2", "\xff\xe0": "o5m"}
    return kinds.get(head[:2].decode("latin-1"), "osm")


def _other(path: Path, told: str) -> TownError:
    """What is said of a file of another kind, which is `told`: what it is, and what to do."""
    what, _, cure = told.partition(": ")
    return TownError(f"{path}: {what}; {EXPECTED}: {cure.format(file=shlex.quote(str(path)))}")


def _unpacked(path: Path, most: int) -> bytes:
    """The first `most` bytes of what a file holds. Raises TownError."""
    try:
        with open_regular_file(path, EXTRACT) as file:
            return unpack(file, most)
    except (EOFError, ValueError, zlib.error) as error:
        raise TownError(f"{escape(path)}: cannot be read ({error}); {EXPECTED}") from None


def _require_tags(path: Path) -> None:
    """Raise TownError for a large file that libosmium would take minutes to find no XML in."""
    with open_regular_file(path, EXTRACT) as file:
        while len(part := file.read(MAX_TAG_BYTES)) == MAX_TAG_BYTES:
            if b">" not in part or b"\0" in part:
                raise TownError(
                    f"{escape(path)}: is not XML, or has a tag of more than {MAX_TAG_BYTES} bytes; {EXPECTED}"
                )


def _cut_by_osmium(path: Path, file_format: str, box: Box | None) -> bytes:
    place = [",".join(map(repr, box.grown(MARGIN_M)))] if box is not None else []
    with create_temporary_folder() as folder:
        out = folder / "cut.osm"
        words = ["-m", "wcsim.towns.osm.cut", str(path.resolve()), file_format, str(out), *place]
        run = run_child("osmium", [sys.executable, *words], folder, os.environ, _LIMITS)
        if run.returncode:
            cure = "" if box is not None else "; a large extract needs --bbox W,S,E,N"
            raise TownError(f"{path}: cannot be read as an extract ({run.reason()}); {EXPECTED}{cure}")
        return out.read_bytes()


def _places(root: Element, path: Path) -> dict[str, tuple[float, float]]:
    """Longitude and latitude of nodes; those without are left out, as are doubles and deleted ones.

    Raises TownError for one that lies nowhere on Earth: its streets would be lost without a word.
    """
    places: dict[str, tuple[float, float]] = {}
    kept = []
    for item in root:
        if item.get("action") == "delete" or item.get("visible") == "false" or not _is_number(item.get("id", "0")):
            continue
        if item.tag == "node":
            place = _place(item, path)
            if place is None or item.get("id", "") in places or "id" not in item.attrib:
                continue
            places[item.attrib["id"]] = place
        kept.append(item)
    root[:] = kept
    return places


def _is_number(text: str) -> bool:
    return text.lstrip("-").isascii() and text.lstrip("-").isdigit()


def _place(node: Element, path: Path) -> tuple[float, float] | None:
    told = node.get("lon"), node.get("lat")
    if None in told:
        return None
    try:
        longitude, latitude = (float(str(text)) for text in told)
    except ValueError:
        longitude = latitude = math.nan
    if abs(longitude) <= 180 and abs(latitude) <= 90:  # false for what is no number
        return longitude, latitude
    where = ", ".join(escape(str(text), 40) for text in told)
    raise TownError(
        f"{path}: node {escape(node.get('id', '?'), 40)} lies at {where}; expected degrees of longitude and latitude"
    )


def _streets(root: Element) -> list[Element]:
    return [way for way in root.iterfind("way") if any(item.get("k") == "highway" for item in way.iterfind("tag"))]


def _cover(nodes: list[tuple[float, float]]) -> Box:
    """The box of nearly all street nodes: an extract holds streets whole, and a few reach far out of it."""
    few = len(nodes) // 100
    longitudes, latitudes = (sorted(values) for values in zip(*nodes, strict=True))
    margin = 1e-5  # a street that runs along the edge is inside
    west, east = longitudes[few] - margin, longitudes[-1 - few] + margin
    return Box(west, latitudes[few] - margin, east, latitudes[-1 - few] + margin)


def _densest(nodes: list[tuple[float, float]]) -> Box:
    """A box around the cell of a hundredth of a degree that has the most street nodes."""
    ((middle, _),) = Counter((round(east, 2), round(north, 2)) for east, north in nodes).most_common(1)
    return Box(*(round(side, 5) for side in Box(*middle, *middle).grown(_CELL_M / 2)))


def _bounds(root: Element) -> Box | None:
    """The box that the extract itself names, where it is one: <bounds> of most tools, <bound> of osmosis."""
    try:
        if (element := root.find("bounds")) is not None:
            west, south, east, north = (float(element.attrib[key]) for key in ("minlon", "minlat", "maxlon", "maxlat"))
        elif (element := root.find("bound")) is not None:
            south, west, north, east = (float(part) for part in element.attrib["box"].split(","))
        else:
            return None
    except (KeyError, ValueError):
        return None
    box = Box(west, south, east, north)
    return box if west < east and south < north and max(box.size_m) <= LONGEST_M else None


def _cut(root: Element, places: dict[str, tuple[float, float]], box: Box) -> None:
    """Leave in `root` what lies around a box, in order and spelt in one way; users' names and time stamps go too."""
    nodes, ways, elsewhere = _needed(root, places, box)
    root[:] = [item for item in root if item not in elsewhere and _is_needed(item, nodes, ways)]
    for item in root:
        for key in ("version", "timestamp", "changeset", "uid", "user", "visible", "action"):
            item.attrib.pop(key, None)
        item[:] = [child for child in item if child.tag in _CHILDREN]
        for tag in item.iterfind("tag"):
            key, value = tag.get("k", ""), tag.get("v", "")
            if _MEASURE.search(key) and _NO_NUMBER.search(value):
                told = f"{item.tag} {item.get('id')} has {escape(key, 40)}={escape(value, 40)!r}"
                raise TownError(f"{told}; expected a number: correct it, or remove the tag")
        if item.tag == "node":
            longitude, latitude = places[item.attrib["id"]]
            item.attrib |= {"lat": f"{latitude:.7f}", "lon": f"{longitude:.7f}"}
    root.attrib.clear()
    root.set("version", "0.6")
    ElementTree.indent(root, "")


def _needed(root: Element, places: dict[str, tuple[float, float]], box: Box) -> tuple[set[str], set[str], set[Element]]:
    """Ids of the nodes and ways around a box, and the ways that are not; all ways lose what is not within reach."""
    near, far = box.grown(MARGIN_M), box.grown(FAR_M)
    inside = {key for key, place in places.items() if near.holds(place)}
    reachable = {key for key, place in places.items() if far.holds(place)}
    nodes, ways, elsewhere = set(inside), set(), set()
    for way in root.iterfind("way"):
        way[:] = [child for child in way if child.tag != "nd" or child.get("ref") in reachable]
        refs = {nd.attrib["ref"] for nd in way.iterfind("nd")}
        if len(refs) < 2 or refs.isdisjoint(inside) or way.get("id") in ways or "id" not in way.attrib:
            elsewhere.add(way)
        else:
            nodes |= refs
            ways.add(way.attrib["id"])
    return nodes, ways, elsewhere


def _is_needed(item: Element, nodes: set[str], ways: set[str]) -> bool:
    if item.tag == "node":
        return item.attrib["id"] in nodes
    if item.tag == "relation":
        return any(m.get("type") == "way" and m.get("ref") in ways for m in item.iterfind("member"))
    return item.tag == "way"


def download(box: Box, folder: Path, url: str = "", wait_s: float = WAIT_S) -> Path:
    """The extract of an area, from the Overpass server at `url` or from those that SUMO knows, in `folder`.

    Raises TownError with one line when no server answers in time, or answers something else.
    """
    box.check()
    if url and (urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).netloc):
        raise TownError(f"--url {url!r} is not a server address; expected http://... or https://...")
    home = sumo_home()
    words = [str(home / "tools" / "osmGet.py"), f"--bbox={','.join(map(repr, box))}", "--prefix", "area"]
    words += ["--output-dir", str(folder), "--retries", "1", "--retry-delay", "1"]
    words += ["--url", url] if url else []
    environment = os.environ | {"SUMO_HOME": str(home)}
    limits = Limits(wall_s=wait_s, cpu_s=60, memory_bytes=4 << 30, file_bytes=MAX_XML_BYTES)
    where = url or "the Overpass servers"
    try:
        run = run_child("osmGet.py", [sys.executable, *words], folder, environment, limits)
    except SumoError:
        raise TownError(f"{where} did not answer within {wait_s:.0f} s; {_CURE}") from None
    out = folder / "area_bbox.osm.xml"
    if run.returncode or not out.is_file():
        raise TownError(f"no map could be downloaded from {where} ({_last_words(run.output)}); {_CURE}")
    return out


def _last_words(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    words = lines[-1] if lines else "no message"
    return words.removeprefix("urllib.error.")[:200]

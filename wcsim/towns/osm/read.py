"""Areas on the globe, and an OpenStreetMap extract of one, as clean elements with nothing dangling.

Areas are in degrees, as OpenStreetMap and SUMO's tools take them; an extract may have any common
format. Or download one with SUMO's own tool, osmGet.py, in a child process under limits.

The driving side: the time zone of a place gives the country, and the country gives the side.
"""

import math
import os
import re
import shlex
import sys
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self
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

_DATA = read_module_toml(__file__)

LONGEST_M = 12_000.0  # of a side: netconvert and the street mesh of more take minutes and gigabytes
_M_PER_DEG = 111_320.0

_LEFT = frozenset(
    f"{region}/{city}" for region, cities in _DATA["left"].items() for city in cities.split()
)
"""IANA time zones of the countries and territories that drive on the left."""
# Time zone of Thailand, and of Vietnam north of the 17th parallel, where traffic keeps right.
_SHARED = "Asia/Bangkok"
# Vietnam, of that zone, lies east and north of either; Laos lies between.
_VIETNAM_DEG = ((105.0, 16.5), (102.0, 18.55))

# Of XML; more is cut by libosmium first, which is faster and needs less memory.
SMALL_BYTES = 48 << 20
MARGIN_M = 150.0  # around the box: buildings and trees beside streets that reach out of it
# Nodes farther outside are left out of their ways: ferries, or beyond the 180th meridian.
FAR_M = 20_000.0
EXPECTED = f"expected {EXTRACT.what}"
# How parsers and unpackers call a lost end.
_ENDS = re.compile("ends too early|EOF|no element found|unclosed")
_HEAD_BYTES = 4096
# Along a side of the box that is proposed: a hundredth of a degree, and a little.
_CELL_M = 1200.0
_LIMITS = Limits(wall_s=90.0, cpu_s=120, memory_bytes=6 << 30, file_bytes=MAX_XML_BYTES)
# Keys whose values are numbers, and values that are none.
_MEASURE = re.compile("width|height|speed|lanes|layer|level|incline|^ele$")
_NO_NUMBER = re.compile(r"(?i)(^|[|;\s])[+-]?(nan|inf|infinity|\d[\d.]*e\+?\d{3,})($|[|;\s])")
# SUMO's tools follow an <include>, and die of one that names nothing.
_CHILDREN = ("nd", "tag", "member")
WAIT_S = 120.0
_CURE = (
    "try again later or with another --url, or download the area by hand and pass it with "
    "--osm FILE"
)


class Box(NamedTuple):
    """An area on the globe, in degrees."""

    west: float
    south: float
    east: float
    north: float

    @classmethod
    def of(cls, text: str) -> Self:
        """The box of "west,south,east,north". Raises ValueError."""
        west, south, east, north = (float(part) for part in text.split(","))
        return cls(west, south, east, north)

    def check(self, part: Self | None = None) -> None:
        """Raise TownError unless a town can be made of it; `part` is a part of a good size."""
        if not (-180 <= self.west < self.east <= 180 and -84 <= self.south < self.north <= 84):
            raise TownError(
                f"--bbox {tuple(self)} is empty or outside of the globe; expected west < east and "
                "south < north, in degrees, from -84 to 84 north"
            )
        wide_m, high_m = self.size_m
        if max(wide_m, high_m) > LONGEST_M:
            where = f", such as where most streets are: {part.option}" if part is not None else ""
            raise TownError(
                f"the bounding box is {wide_m / 1e3:.0f} x {high_m / 1e3:.0f} km; "
                f"expected at most {LONGEST_M / 1e3:.0f} km each way: choose a part of it{where}"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height in metres."""
        wide_m = (
            (self.east - self.west) * _M_PER_DEG * math.cos(deg2rad((self.south + self.north) / 2))
        )
        return wide_m, (self.north - self.south) * _M_PER_DEG

    @property
    def centre(self) -> tuple[float, float]:
        """Longitude and latitude of its middle."""
        return (self.west + self.east) / 2, (self.south + self.north) / 2

    @property
    def option(self) -> str:
        """As the command line takes it."""
        return f"--bbox={','.join(map(str, self))}"

    def grown(self, margin_m: float) -> Self:
        """The same with a margin in metres on each side, within the globe."""
        high = margin_m / _M_PER_DEG
        wide = high / max(0.05, math.cos(deg2rad((self.south + self.north) / 2)))
        west, south = max(-180.0, self.west - wide), max(-90.0, self.south - high)
        return type(self)(west, south, min(180.0, self.east + wide), min(90.0, self.north + high))

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
    # These take half a second, which only an import needs.
    from wcsim.core.jit import cache_other_kernels

    cache_other_kernels()
    from timezonefinder import TimezoneFinder

    zone = TimezoneFinder().timezone_at(lng=longitude_deg, lat=latitude_deg)
    known = zone is not None and not zone.startswith("Etc/")  # those lie at sea
    is_vietnam = any(longitude_deg > west and latitude_deg > south for west, south in _VIETNAM_DEG)
    if zone == _SHARED and is_vietnam:
        return Side(lefthand=False, why=f"Vietnam, in time zone {zone}")
    return Side(lefthand=zone in _LEFT, why=f"time zone {zone}" if known else "country unknown")


@dataclass(frozen=True, slots=True, kw_only=True)
class Extract:
    """An extract cut to `box`: every node has a place, every way at least two of the nodes."""

    root: Element
    box: Box
    # The box was ordered, or is the extract's own; else it is the reach of its streets.
    bounded: bool = True

    def xml(self) -> bytes:
        """As .osm XML."""
        return xml_bytes(self.root)


def read_extract(path: Path, box: Box | None = None) -> Extract:
    """Read and cut an extract; without a box it is taken at its own bounds, or its streets'.

    Raises:
        TownError: It is no extract, or holds no streets there.
    """
    # 1. Read it.
    try:
        root = parse_root(_xml_of(path, box), str(path))
    except TownError as error:
        if _ENDS.search(str(error)):
            why = "cannot be read, for it ends in the middle"
            raise TownError(f"{escape(path)}: {why}; {EXPECTED}: download it again") from None
        raise
    if root.tag != "osm":
        foreign = (
            f"is not an OpenStreetMap extract (root <{root.tag}>): "
            "export the area as raw OpenStreetMap data (.osm)"
        )
        raise _other(path, _DATA["roots"].get(root.tag, foreign))

    # 2. Find the places of its streets.
    places = _places(root, path)
    nodes = _street_nodes(root, places, path)

    # 3. Choose the box, and cut.
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
            f"{path}: no street lies in the bounding box {tuple(box)}; "
            f"its streets are in {cover_text}: choose a box there, "
            f"such as where most of them are: {_densest(nodes).option}"
        )
    return Extract(root=root, box=box, bounded=named is not None)


def download(box: Box, folder: Path, url: str = "", wait_s: float = WAIT_S) -> Path:
    """The extract of an area in `folder`, from the Overpass server at `url` or from SUMO's own.

    Raises:
        TownError: No server answers in time, or it answers something else; one line.
    """
    box.check()
    if url and (urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).netloc):
        raise TownError(
            f"--url {url!r} is not a server address; expected http://... or https://..."
        )
    home = sumo_home()
    words = [str(home / "tools" / "osmGet.py"), f"--bbox={','.join(map(repr, box))}"]
    words += [
        "--prefix",
        "area",
        "--output-dir",
        str(folder),
        "--retries",
        "1",
        "--retry-delay",
        "1",
    ]
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
        lines = [line.strip() for line in run.output.splitlines() if line.strip()]
        last = (lines[-1] if lines else "no message").removeprefix("urllib.error.")[:200]
        raise TownError(f"no map could be downloaded from {where} ({last}); {_CURE}")
    return out


def _xml_of(path: Path, box: Box | None) -> bytes:
    kind = _kind(path)
    if kind in ("pbf", "o5m"):
        return _cut_by_osmium(path, kind, box)
    if kind == "osm" and read_file_size(path, EXTRACT) > SMALL_BYTES:
        # libosmium would take minutes to find no XML in a large file.
        with open_regular_file(path, EXTRACT) as file:
            while len(part := file.read(MAX_TAG_BYTES)) == MAX_TAG_BYTES:
                if b">" not in part or b"\0" in part:
                    why = f"is not XML, or has a tag of more than {MAX_TAG_BYTES} bytes"
                    raise TownError(f"{escape(path)}: {why}; {EXPECTED}")
        return _cut_by_osmium(path, kind, box)
    most = 4 * MAX_XML_BYTES if box is not None else MAX_XML_BYTES
    data = _unpacked(path, most + 1)
    if len(data) > most:
        size = f"more than {most >> 20} MiB of XML"
        raise TownError(f"{escape(path)}: {size}; clip it to a smaller area")
    if len(data) > SMALL_BYTES and box is not None:
        check_plain_xml(data, escape(path), 8 * MAX_TAGS)
        packed = {"gz": "osm.gz", "bz2": "osm.bz2"}
        return _cut_by_osmium(path, packed.get(kind, "osm"), box)
    return data


def _kind(path: Path) -> str:
    """How a file is packed, by its first bytes: names are wrong too often. Raises TownError."""
    with open_regular_file(path, EXTRACT) as file:
        head = file.read(64)
    if b"OSMHeader" in head:
        return "pbf"
    # What it is shows when it is unpacked.
    beginning = _unpacked(path, _HEAD_BYTES).decode("latin-1").lstrip("\xef\xbb\xbf \t\r\n")
    for pattern, text in _DATA["others"].items():
        if re.match(pattern, beginning):
            raise _other(path, text)
    if path.suffix == ".pbf":
        cure = "download it again, or check it: osmium fileinfo"
        raise TownError(f"{path}: is not a .pbf file; {EXPECTED}: {cure}")
    kinds = {"\x1f\x8b": "gz", "BZ": "bz2", "\xff\xe0": "o5m"}
    return kinds.get(head[:2].decode("latin-1"), "osm")


def _unpacked(path: Path, most: int) -> bytes:
    """The first `most` bytes of what a file holds. Raises TownError."""
    try:
        with open_regular_file(path, EXTRACT) as file:
            return unpack(file, most)
    except (EOFError, ValueError, zlib.error) as error:
        raise TownError(f"{escape(path)}: cannot be read ({error}); {EXPECTED}") from None


def _cut_by_osmium(path: Path, file_format: str, box: Box | None) -> bytes:
    place = [",".join(map(repr, box.grown(MARGIN_M)))] if box is not None else []
    with create_temporary_folder() as folder:
        out = folder / "cut.osm"
        words = ["-m", "wcsim.towns.osm.cut", str(path.resolve()), file_format, str(out), *place]
        run = run_child("osmium", [sys.executable, *words], folder, os.environ, _LIMITS)
        if run.returncode:
            cure = "" if box is not None else "; a large extract needs --bbox W,S,E,N"
            why = f"cannot be read as an extract ({run.reason()})"
            raise TownError(f"{path}: {why}; {EXPECTED}{cure}")
        return out.read_bytes()


def _other(path: Path, text: str) -> TownError:
    """The error for a file of another kind; `text` has what it is, and what to do."""
    what, _, cure = text.partition(": ")
    return TownError(f"{path}: {what}; {EXPECTED}: {cure.format(file=shlex.quote(str(path)))}")


def _places(root: Element, path: Path) -> dict[str, tuple[float, float]]:
    """Longitude and latitude of nodes; those without are left out, as are doubles and deleted ones.

    Raises:
        TownError: One lies nowhere on Earth: its streets would be lost without a word.
    """
    places: dict[str, tuple[float, float]] = {}
    found = []
    for item in root:
        number = item.get("id", "0").lstrip("-")
        is_number = number.isascii() and number.isdigit()
        if item.get("action") == "delete" or item.get("visible") == "false" or not is_number:
            continue
        if item.tag == "node":
            place = _place(item, path)
            if place is None or item.get("id", "") in places or "id" not in item.attrib:
                continue
            places[item.attrib["id"]] = place
        found.append(item)
    root[:] = found
    return places


def _place(node: Element, path: Path) -> tuple[float, float] | None:
    texts = node.get("lon"), node.get("lat")
    if None in texts:
        return None
    try:
        longitude, latitude = (float(str(text)) for text in texts)
    except ValueError:
        longitude = latitude = math.nan
    if abs(longitude) <= 180 and abs(latitude) <= 90:  # false for what is no number
        return longitude, latitude
    where = ", ".join(escape(str(text), 40) for text in texts)
    raise TownError(
        f"{path}: node {escape(node.get('id', '?'), 40)} lies at {where}; "
        "expected degrees of longitude and latitude"
    )


def _street_nodes(
    root: Element, places: dict[str, tuple[float, float]], path: Path
) -> list[tuple[float, float]]:
    """The places of the nodes of all streets, street by street.

    Raises:
        TownError: There are no streets, or most of them have no nodes.
    """
    streets = _streets(root)
    lines = [
        [places[ref] for nd in way.iterfind("nd") if (ref := nd.get("ref", "")) in places]
        for way in streets
    ]
    bare = sum(len(line) < 2 for line in lines)
    if 2 * bare > len(streets):
        raise TownError(
            f"{path}: {bare} of its {len(streets)} streets have no nodes, "
            f"as after Overpass' out geom; {EXPECTED}, with nodes: "
            "end the query with (._;>;); out body;"
        )
    if not streets:
        remark = root.findtext("remark", "").strip()
        answer = f" (the server said: {escape(remark, 200)})" if remark else ""
        raise TownError(
            f"{path}: is not an OpenStreetMap extract with streets in it{answer}; "
            f"{EXPECTED}, with streets"
        )
    return [place for line in lines for place in line]


def _streets(root: Element) -> list[Element]:
    return [
        way
        for way in root.iterfind("way")
        if any(tag.get("k") == "highway" for tag in way.iterfind("tag"))
    ]


def _cover(nodes: list[tuple[float, float]]) -> Box:
    """The box of nearly all street nodes: a few streets reach far out of an extract."""
    few = len(nodes) // 100
    longitudes, latitudes = (sorted(values) for values in zip(*nodes, strict=True))
    margin = 1e-5  # a street that runs along the edge is inside
    west, east = longitudes[few] - margin, longitudes[-1 - few] + margin
    return Box(west, latitudes[few] - margin, east, latitudes[-1 - few] + margin)


def _densest(nodes: list[tuple[float, float]]) -> Box:
    """A box around the cell of a hundredth of a degree that has the most street nodes."""
    ((middle, _),) = Counter(
        (round(east, 2), round(north, 2)) for east, north in nodes
    ).most_common(1)
    return Box(*(round(side, 5) for side in Box(*middle, *middle).grown(_CELL_M / 2)))


def _bounds(root: Element) -> Box | None:
    """The box that the extract itself names: <bounds> of most tools, <bound> of osmosis."""
    try:
        if (element := root.find("bounds")) is not None:
            sides = ("minlon", "minlat", "maxlon", "maxlat")
            west, south, east, north = (float(element.attrib[side]) for side in sides)
        elif (element := root.find("bound")) is not None:
            south, west, north, east = (float(part) for part in element.attrib["box"].split(","))
        else:
            return None
    except (KeyError, ValueError):
        return None
    box = Box(west, south, east, north)
    return box if west < east and south < north and max(box.size_m) <= LONGEST_M else None


def _cut(root: Element, places: dict[str, tuple[float, float]], box: Box) -> None:
    """Leave in `root` what lies around a box, in order and spelt in one way; no users' names."""
    # 1. Leave out what is elsewhere.
    nodes, ways, elsewhere = _needed(root, places, box)
    found = []
    for item in root:
        if item.tag == "node":
            is_needed = item.attrib["id"] in nodes
        elif item.tag == "relation":
            members = item.iterfind("member[@type='way']")
            is_needed = any(member.get("ref") in ways for member in members)
        else:
            is_needed = item.tag == "way" and item not in elsewhere
        if is_needed:
            found.append(item)
    root[:] = found
    # 2. Spell the rest in one way.
    for item in root:
        for key in ("version", "timestamp", "changeset", "uid", "user", "visible", "action"):
            item.attrib.pop(key, None)
        item[:] = [child for child in item if child.tag in _CHILDREN]
        for tag in item.iterfind("tag"):
            key, value = tag.get("k", ""), tag.get("v", "")
            if _MEASURE.search(key) and _NO_NUMBER.search(value):
                raise TownError(
                    f"{item.tag} {item.get('id')} has {escape(key, 40)}={escape(value, 40)!r}; "
                    "expected a number: correct it, or remove the tag"
                )
        if item.tag == "node":
            longitude, latitude = places[item.attrib["id"]]
            item.attrib |= {"lat": f"{latitude:.7f}", "lon": f"{longitude:.7f}"}
    root.attrib.clear()
    root.set("version", "0.6")
    ElementTree.indent(root, "")


def _needed(
    root: Element, places: dict[str, tuple[float, float]], box: Box
) -> tuple[set[str], set[str], set[Element]]:
    """Ids of the nodes and ways around a box, and the ways elsewhere; ways lose what is too far."""
    near, far = box.grown(MARGIN_M), box.grown(FAR_M)
    inside = {key for key, place in places.items() if near.holds(place)}
    reachable = {key for key, place in places.items() if far.holds(place)}
    nodes, ways, elsewhere = set(inside), set(), set()
    for way in root.iterfind("way"):
        way[:] = [child for child in way if child.tag != "nd" or child.get("ref") in reachable]
        refs = {nd.attrib["ref"] for nd in way.iterfind("nd")}
        is_new = "id" in way.attrib and way.get("id") not in ways
        if len(refs) < 2 or refs.isdisjoint(inside) or not is_new:
            elsewhere.add(way)
        else:
            nodes |= refs
            ways.add(way.attrib["id"])
    return nodes, ways, elsewhere

"""What is changed in an OpenStreetMap extract before SUMO's tools read it.

Hidden ways: those that are not at street level are removed.

Bridges over other streets: they are removed. A town has one level, on which they would be level crossings. The lower
way stays, whatever it is, except a railway under a street: no trains run in imported towns. Bridges over water, or over
nothing, stay as well.

Motorways: they are made fast. netconvert guesses crossings wherever two pavements face each other across a slow street.

Ways on foot: what `tags.toml` makes of them is put into words that SUMO's tools read. netconvert guesses pavements by
speed alone, beside tracks and where the map denies them, so each is checked.

Buildings: courtyards and parts are put into tags that polyconvert keeps. polyconvert 1.28 gives the tags of a
multipolygon to its inner ways as well, so a courtyard would become a building; and it knows no key building:part. Both
get a value of `building` that `towns/furniture/buildings.py` understands: courtyard and part.

What of a map's streets and ways on foot is not in the net that was made of it.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Set
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import shapely

from wcsim.core.frames import deg2rad
from wcsim.core.reading import join_names, read_module_toml
from wcsim.towns.osm.read import Box
from wcsim.towns.osm.tags import meanings
from wcsim.towns.sumo.net import Edge, LaneKind, Net
from wcsim.towns.walking.islands import osm_ways_by_edge
from wcsim.types import F64

_TAGS = {name: frozenset(words.split()) for name, words in read_module_toml(__file__).items()}
_COURTYARD = "courtyard"
_PART = "part"
_SLOWEST_KMH = 66  # just above netconvert's --crossings.guess.speed-threshold: nobody crosses a motorway on foot
_KMH = {"": 1.0, "km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609, "knots": 1.852}
_SPEED = re.compile(r"^(\d+(?:\.\d+)?)\s*([a-z/]*)$")
ALONG_M = 15.0  # a bridge that runs over another way for longer than this lies on top of it
BESIDE_M = 2.5  # and as near to its line
_M_PER_DEG = 111_320.0


def _mark_buildings(root: Element) -> None:
    """Mark courtyards and parts of buildings; changes `root`."""
    ways = {way.get("id", ""): way for way in root.iterfind("way")}
    for thing in (*ways.values(), *root.iterfind("relation")):
        tags = _read_tags(thing)
        if "building" not in tags and tags.get("building:part", "no") != "no":
            SubElement(thing, "tag", {"k": "building", "v": _PART})
    for relation in root.iterfind("relation"):
        tags = _read_tags(relation)
        if tags.get("type") != "multipolygon":
            # it only says which ways belong together
            relation[:] = [tag for tag in relation if tag.tag != "tag" or tag.get("k") != "building"]
        elif "building" in tags or any(_read_tags(way).get("building") for way in _ways(relation, "outer", ways)):
            for way in _ways(relation, "inner", ways):
                if "building" not in _read_tags(way):
                    SubElement(way, "tag", {"k": "building", "v": _COURTYARD})


def _ways(relation: Element, role: str, ways: dict[str, Element]) -> list[Element]:
    """The ways that a relation has in a role, as far as they are in the extract."""
    refs = [m.get("ref", "") for m in relation.iterfind("member") if (m.get("type"), m.get("role")) == ("way", role)]
    return [ways[ref] for ref in refs if ref in ways]


_NUMBERS = re.compile(r"^(lanes|width|est_width|layer|maxspeed|((cycleway|sidewalk):.*:?width))(:(forward|backward))?$")
_NUMBER = re.compile(r"^[+-]?\d{1,4}([.,]\d+)?\s*[a-z/'\"]*$")


def filter_osm(root: Element, lefthand: bool = False) -> None:
    """Drop ways that are not at street level, and the crossing tag of nodes that lie on no street; changes `root`.

    Traffic may keep to the left. Tags `pavement_*`, `chair_way` and `kerb_*` are added; polyconvert passes on the last.
    """
    root[:] = [item for item in root if item.tag != "way" or not _is_hidden(_read_tags(item))]
    for item in (*root.iterfind("way"), *root.iterfind("node")):
        item[:] = [tag for tag in item if tag.tag != "tag" or not _is_senseless(tag.get("k", ""), tag.get("v", ""))]
    strip_orphans(root)
    _mark_buildings(root)
    _quicken_motorways(root)
    _mark_ways(root, lefthand)


def strip_orphans(root: Element) -> None:
    """Take the crossing tag off nodes that lie on no street, where it crashes netconvert 1.28, or are no crossings.

    Changes `root`.
    """
    on_street = {
        node.get("ref")
        for way in root.iterfind("way")
        if any(item.get("k") == "highway" for item in way.iterfind("tag"))
        for node in way.iterfind("nd")
    }
    on_street -= set(denied_crossings(root))
    for node in root.iterfind("node"):
        if node.get("id") not in on_street:
            node[:] = [tag for tag in node if (tag.get("k"), tag.get("v")) != ("highway", "crossing")]


def _is_senseless(key: str, value: str) -> bool:
    """True for a tag without a value, or a word where netconvert wants a number: it stops at some of them."""
    if not key or not value.strip():
        return True
    if not _NUMBERS.match(key):
        return False
    plain = value.strip()
    return not (_NUMBER.match(plain) or plain in _TAGS["words"] or ":" in plain)  # as "DE:urban"


def _read_tags(item: Element) -> dict[str, str]:
    """The tags of a node or a way."""
    return {tag.get("k", ""): tag.get("v", "") for tag in item.iterfind("tag")}


def _is_hidden(tag: dict[str, str]) -> bool:
    """True for what is neither seen nor driven on from the street."""
    if "building" in tag or "building:part" in tag:
        return (
            tag.get("building", "yes") in _TAGS["no_building"]
            or tag.get("location") == "underground"
            or _layer(tag) < 0
        )
    if "highway" not in tag and "railway" not in tag:
        return False
    return (
        tag.get("tunnel", "no") not in ("no", "building_passage")
        or tag.get("indoor") == "yes"
        or tag.get("highway") in _TAGS["no_street"]
        or tag.get("railway") in _TAGS["no_rail"]
        or tag.get("location") in ("underground", "indoor")
        or _layer(tag) < 0
        or tag.get("level", "0").split(";")[0] not in ("0", "")
    )


def _layer(tag: dict[str, str]) -> float:
    try:
        return float(tag.get("layer", "0"))
    except ValueError:
        return 0.0


def _quicken_motorways(root: Element) -> None:
    """Make slow motorways of an extract as fast as netconvert needs to leave out crossings on foot."""
    for way in root.iterfind("way"):
        if not _is_motorway(_read_tags(way)):
            continue
        for tag in [tag for tag in way.findall("tag") if tag.get("k") in _TAGS["speeds"]]:
            if _kmh(tag.get("v", "")) < _SLOWEST_KMH:
                tag.set("v", str(_SLOWEST_KMH))


def _mark_ways(root: Element, lefthand: bool) -> None:
    """Put pavements, crossings, kerbs and ways on foot into the words of SUMO's tools; changes `root`."""
    for way in root.iterfind("way"):
        tags = _read_tags(way)
        if "highway" not in tags and "railway" not in tags:
            continue
        words = _pavements(tags, lefthand)
        for side in ("left", "right"):
            words[f"kerb_{side}"] = tags.get(f"kerb:{side}", tags.get("kerb:both", ""))
        if tags.get("highway") in _TAGS["on_foot"]:
            means = meanings("footways", tags)
            words |= {"chair_way": "no"} if means.get("chairs") == "no" else {}
            words |= {"highway": "footway"} if tags["highway"] == "steps" and "steps" in means else {}
        way[:] = [tag for tag in way if tag.tag != "tag" or tag.get("k") not in words]
        for key, word in words.items():
            if word:
                SubElement(way, "tag", {"k": key, "v": word})


def _pavements(tags: dict[str, str], lefthand: bool) -> dict[str, str]:
    """What the tags of a way say of pavements: for each side, and in netconvert's word; empty words take tags away."""
    sides = meanings("streets", tags)
    words = {key: "" for key in tags if key.startswith("sidewalk")}
    words |= {f"pavement_{side}": told for side, told in sides.items()}
    if mapped := [side for side, told in sides.items() if told == "paved"]:
        # netconvert calls the side of those who drive along the way the right.
        named = {"left": "right", "right": "left"}[mapped[0]] if lefthand else mapped[0]
        words["sidewalk"] = "both" if len(mapped) == 2 else named
    elif "bare" in sides.values():
        words["sidewalk"] = "no"  # else it takes foot=yes for pavements; a guess comes later
    return words


def denied_crossings(root: Element) -> list[str]:
    """The nodes at which the map says that there is no crossing."""
    found = [node for node in root.iterfind("node") if meanings("crossings", _read_tags(node)).get("built") == "no"]
    return [node.get("id", "") for node in found]


def edge_lists(root: Element, net: Net | None = None, net_path: Path = Path()) -> dict[str, list[str]]:
    """Lists of edges for options of netconvert, by option.

    Streets with a crossing on them are not joined there. Of the edges of a net that it made, no pavement is guessed
    beside those that the map denies one, for any of the ways that they were made of.
    """
    ways = {way.get("id", "").lstrip("-"): way for way in root.iterfind("way")}
    crossings = {node.get("id") for node in root.iterfind("node") if _read_tags(node).get("highway") == "crossing"}
    joined: list[str] = []
    for way in ways.values():
        refs = [nd.get("ref") for nd in way.iterfind("nd")]
        if {"highway", "pavement_left"} <= _read_tags(way).keys() and not crossings.isdisjoint(refs):
            names = [way.get("id", ""), *(f"{way.get('id')}#{number}" for number in range(len(refs)))]
            joined += [*names, *(f"-{name}" for name in names)]
    denied: list[str] = []
    if net is not None:
        places, made_of = _places(root), osm_ways_by_edge(net_path)
        for edge in net.streets:
            known = [ways[way_id] for way_id in made_of[edge.id] if way_id in ways]
            if edge.has(LaneKind.SIDEWALK) and any(_denies(way, edge, places, net.lefthand) for way in known):
                denied.append(edge.id)
    return {"geometry.remove.keep-edges.explicit": joined, "sidewalks.guess.exclude": denied}


def _denies(way: Element, edge: Edge, places: dict[str, tuple[float, float]], lefthand: bool) -> bool:
    """Whether a way has no pavement on the side of an edge that was made of it."""
    named, way_id = edge.id.partition("#")[0], way.get("id", "")
    along = named == way_id
    if named not in (way_id, f"-{way_id}"):  # it was joined to the way that gives the name
        ends = [places[nd.get("ref", "")] for nd in way.iterfind("nd") if nd.get("ref") in places]
        step_m = edge.lanes[0].points_m[-1] - edge.lanes[0].points_m[0]
        along = bool(np.dot(np.subtract(ends[-1], ends[0]), step_m) > 0.0)
    side = "right" if along != lefthand else "left"
    return _read_tags(way).get(f"pavement_{side}", "bare") == "bare"


def _is_motorway(tag: dict[str, str]) -> bool:
    return tag.get("highway") == "motorway" or ("highway" in tag and tag.get("motorroad") == "yes")


def _kmh(text: str) -> float:
    """A speed in km/h; without a limit, or by a rule, motorways are fast."""
    match = _SPEED.match(text.strip().lower())
    return float(match[1]) * _KMH.get(match[2], 1.0) if match else float("inf")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Way:
    """A street or railway of the extract."""

    element: Element
    nodes: tuple[str, ...]
    points_m: F64  # (n, 2)
    level: float
    train: bool

    def piece(self, first: int, last: int) -> shapely.LineString:
        """The line from one node to another."""
        return shapely.LineString(self.points_m[first : last + 1])

    def without(self, gone: Set[int]) -> shapely.MultiLineString:
        """Its segments but for those of these numbers."""
        return shapely.MultiLineString([self.piece(k, k + 1) for k in range(len(self.nodes) - 1) if k not in gone])


def cut_bridges(root: Element, keep_service: bool = False) -> tuple[str, ...]:
    """Leave out the parts of bridges that pass over other streets, and say what they are called; changes `root`.

    A part reaches from one junction to the next. Names are sorted, each once; what has none goes by its kind.
    """
    ways = _built_ways(root, keep_service)
    if not ways:
        return ()
    uses = Counter(node for way in ways for node in set(way.nodes))
    cut: dict[int, set[int]] = {}  # number of a way: its segments that go
    lines = [way.piece(0, len(way.nodes) - 1) for way in ways]
    pairs = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=BESIDE_M).T.tolist()
    for high, low in sorted(pairs, key=lambda pair: (ways[pair[0]].level, pair)):
        if ways[high].level <= ways[low].level:
            continue
        upper, lower = (low, high) if ways[low].train and not ways[high].train else (high, low)
        kept = ways[lower].without(cut.get(lower, set()))
        for segment in _over(ways[upper], kept, set(ways[lower].nodes)):
            cut.setdefault(upper, set()).update(_between_junctions(ways[upper], segment, uses))
    _remove(root, [(ways[number], gone) for number, gone in sorted(cut.items())])
    return tuple(sorted({_called(ways[number].element) for number in cut if not ways[number].train}))


def _places(root: Element) -> dict[str, tuple[float, float]]:
    """Longitude and latitude of each node of an extract."""
    return {
        node.get("id", ""): (float(node.get("lon", "0")), float(node.get("lat", "0"))) for node in root.iterfind("node")
    }


def _built_ways(root: Element, keep_service: bool) -> list[_Way]:
    places = _places(root)
    middle = np.mean(list(places.values()) or [(0.0, 0.0)], axis=0)
    scale_m = _M_PER_DEG * np.array([np.cos(deg2rad(float(middle[1]))), 1.0])
    found: list[_Way] = []
    for element in root.iterfind("way"):
        tag = _read_tags(element)
        nodes = tuple(ref for nd in element.iterfind("nd") if (ref := nd.get("ref", "")) in places)
        if len(nodes) < 2 or len(nodes) != len(element.findall("nd")) or not _is_built(tag, keep_service):
            continue
        points_m = (np.array([places[node] for node in nodes]) - middle) * scale_m
        train = "highway" not in tag and tag.get("railway") in _TAGS["trains"]
        level = _layer(tag) or (1.0 if tag.get("bridge", "no") != "no" else 0.0)
        found.append(_Way(element=element, nodes=nodes, points_m=points_m, level=level, train=train))
    return found


def _is_built(tag: dict[str, str], keep_service: bool) -> bool:
    """True for what becomes part of the net."""
    if tag.get("area") == "yes":
        return False
    if "highway" in tag:
        return tag["highway"] not in _TAGS["no_way"] and (keep_service or tag["highway"] != "service")
    return tag.get("railway") in _TAGS["rails"]


def _over(way: _Way, other: shapely.MultiLineString, joined: set[str]) -> list[int]:
    """Segments of a way that cross another one, or lie along it, without a common node there."""
    near = shapely.union_all([shapely.Point(way.points_m[k]) for k, node in enumerate(way.nodes) if node in joined])
    found: list[int] = []
    beside = other.buffer(BESIDE_M) if near.is_empty else shapely.Polygon()
    for k in range(len(way.nodes) - 1):
        meets = way.piece(k, k + 1).intersection(other)
        crosses = not meets.is_empty and (near.is_empty or not meets.within(near.buffer(0.05)))
        if crosses or way.piece(k, k + 1).intersection(beside).length > ALONG_M:
            found.append(k)
    return found


def _between_junctions(way: _Way, segment: int, uses: Counter[str]) -> range:
    """Segments of a way from the junction before one of them to the junction after it."""
    first, last = segment, segment + 1
    while first > 0 and uses[way.nodes[first]] < 2:
        first -= 1
    while last < len(way.nodes) - 1 and uses[way.nodes[last]] < 2:
        last += 1
    return range(first, last)


def _remove(root: Element, cuts: list[tuple[_Way, set[int]]]) -> None:
    """Take segments out of ways; what is left of one beyond the first piece becomes a way of its own."""
    ids = [int(way.get("id", "0")) for way in root.iterfind("way")]
    sign, free = (1 if max(ids, default=1) > 0 else -1), max(map(abs, ids), default=0) + 1
    for way, gone in cuts:
        runs: list[list[str]] = [[]]
        for k, node in enumerate(way.nodes):
            runs[-1].append(node)
            if k in gone:
                runs.append([])
        place, tags = list(root).index(way.element), [deepcopy(tag) for tag in way.element.iterfind("tag")]
        root.remove(way.element)
        for number, nodes in enumerate(run for run in runs if len(run) > 1):
            piece = Element("way", way.element.attrib if number == 0 else {"id": str(sign * free)})
            free += number > 0
            piece.extend([Element("nd", {"ref": node}) for node in nodes] + deepcopy(tags))
            root.insert(place + number, piece)


def _called(way: Element) -> str:
    tag = _read_tags(way)
    return tag.get("name") or tag.get("ref") or f"a {tag.get('highway') or tag.get('railway')} without a name"


LEAST_M = 50.0  # what is less is lost at the edges of any box
TOLD = 5  # names
TOLD_LOST = 10  # ways on foot


@dataclass(frozen=True, slots=True, kw_only=True)
class _MapWay:
    """A street or a way on foot of a map."""

    id: str  # without a sign; of a relation with the word before it
    street: bool
    name: str
    inside_m: float  # how much of it lies in the box; of an area, its outline
    why: str  # it may be missing, by its tags


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """What the map has inside the box, and how much of it the net has not."""

    streets_m: float = 0.0
    footways_m: float = 0.0
    streets_left_out_m: float = 0.0
    footways_left_out_m: float = 0.0
    names: tuple[str, ...] = ()  # of streets that are left out, longest first
    footways: tuple[_MapWay, ...] = ()  # all that are left out, longest first

    @classmethod
    def of(cls, ways: Collection[_MapWay], drawn: Set[str], walked: Set[str]) -> LeftOut:
        """What of `ways` is not in the net, by the ids of those that it has, and of those with lanes for walkers."""
        gone = [way for way in ways if way.id not in (drawn if way.street else walked)]
        by_name: dict[str, float] = defaultdict(float)
        for way in gone:
            if way.name and way.street:
                by_name[way.name] += way.inside_m
        lost = [way for way in gone if not way.street]
        return cls(
            streets_m=sum(way.inside_m for way in ways if way.street),
            footways_m=sum(way.inside_m for way in ways if not way.street),
            streets_left_out_m=sum(way.inside_m for way in gone if way.street),
            footways_left_out_m=sum(way.inside_m for way in lost),
            names=tuple(sorted(by_name, key=lambda name: (-by_name[name], name))),
            footways=tuple(sorted(lost, key=lambda way: (-way.inside_m, way.id))),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Streets where they are more than next to nothing, and each way on foot or the longest."""
        notes = []
        if self.streets_left_out_m >= LEAST_M:
            names = join_names(self.names, TOLD)
            notes.append(
                f"left out: {_km(self.streets_left_out_m)} of {_km(self.streets_m)} of streets: bridges, and streets "
                f"connected to the rest only outside of the box{' (' + names + ')' if names else ''}; a larger --bbox "
                "or --keep-service may connect them"
            )
        if lost := self.footways:
            told = ", ".join(map(_told, lost[:TOLD_LOST]))
            more_m = sum(way.inside_m for way in lost[TOLD_LOST:])
            more = f", and {len(lost) - TOLD_LOST} more ({more_m:.0f} m)" if len(lost) > TOLD_LOST else ""
            notes.append(
                f"left out: {self.footways_left_out_m:.0f} of {self.footways_m:.0f} m of footways in the box, by map "
                f"id: {told}{more}"
            )
        return tuple(notes)


def _told(way: _MapWay) -> str:
    return f"{' '.join(filter(None, (way.id, way.name)))} ({way.inside_m:.0f} m{', ' * bool(way.why)}{way.why})"


def map_ways(root: Element, box: Box) -> tuple[_MapWay, ...]:
    """The streets of an extract at street level, and its ways on foot; `root` is as it was read."""
    places = _places(root)
    lines = {
        way.get("id", ""): [ref for node in way.iterfind("nd") if (ref := node.get("ref", "")) in places]
        for way in root.iterfind("way")
    }
    found = []
    for item in (*root.iterfind("way"), *root.iterfind("relation")):
        tags = _read_tags(item)
        street = tags.get("highway") in _TAGS["streets"] and not _is_hidden(tags) and tags.get("area") != "yes"
        if not street and not _is_footway(tags):
            continue
        parts = [lines[item.get("id", "")]] if item.tag == "way" else _outline(item, lines)
        way = _MapWay(
            id=f"{'relation ' * (item.tag == 'relation')}{item.get('id', '').lstrip('-')}",
            street=street,
            name=tags.get("name", ""),
            inside_m=sum(_inside_m([places[node] for node in part], box) for part in parts),
            why=_why_by_tags(tags),
        )
        found.append(way)
    return tuple(way for way in found if way.inside_m > 0.0)


def _is_footway(tags: dict[str, str]) -> bool:
    shared = tags.get("highway") == "cycleway" and tags.get("foot") in ("yes", "designated")
    return shared or (tags.get("highway") in _TAGS["footways"] and tags.get("foot") != "no")


def _outline(relation: Element, lines: dict[str, list[str]]) -> list[list[str]]:
    outer = [
        m.get("ref", "") for m in relation.iterfind("member") if m.get("type") == "way" and m.get("role") != "inner"
    ]
    return [lines[ref] for ref in outer if ref in lines] if _read_tags(relation).get("type") == "multipolygon" else []


def _why_by_tags(tags: dict[str, str]) -> str:
    if _is_hidden(tags):
        return "a tunnel, indoors, or on another level"
    if tags["highway"] == "steps":
        return "steps"
    if tags.get("area") == "yes" or tags.get("type") == "multipolygon":
        return "an open area" if tags["highway"] == "pedestrian" else "an area"
    return "closed to the public" if tags.get("foot", tags.get("access")) in _TAGS["closed"] else ""


def count_inside(root: Element, box: Box, highway: str) -> int:
    """How many nodes with this value of `highway` the map has in the box; crossings without paint count too."""
    nodes = (node for node in root.iterfind("node") if _read_tags(node).get("highway") == highway)
    return sum(box.holds((float(node.get("lon", "0")), float(node.get("lat", "0")))) for node in nodes)


def _inside_m(points: list[tuple[float, float]], box: Box) -> float:
    """Length in m of the parts between points (longitude, latitude) that have their middles in the box."""
    total_m = 0.0
    for (x1, y1), (x2, y2) in itertools.pairwise(points):
        if box.holds(((x1 + x2) / 2, (y1 + y2) / 2)):
            total_m += math.hypot(*Box(x1, y1, x2, y2).size_m)
    return total_m


def _km(length_m: float) -> str:
    return f"{length_m / 1e3:.2f} km"

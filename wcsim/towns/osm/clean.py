"""What is changed in an OpenStreetMap extract before SUMO's tools read it.

Hidden ways: those that are not at street level are removed.

Bridges over other streets: they are removed. A town has one level, on which they would be level
crossings. The lower way stays, whatever it is, except a railway under a street: no trains run in
imported towns. Bridges over water, or over nothing, stay as well.

Motorways: they are made fast. netconvert guesses crossings wherever two pavements face each other
across a slow street.

Ways on foot: what `tags.toml` makes of them is put into words that SUMO's tools read. netconvert
guesses pavements by speed alone, beside tracks and where the map denies them, so each is checked.

Buildings: courtyards and parts are put into tags that polyconvert keeps. polyconvert 1.28 gives the
tags of a multipolygon to its inner ways as well, so a courtyard would become a building; and it
knows no key building:part. Both get a value of `building` that `towns/furniture/buildings.py`
understands: courtyard and part.

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
# Just above netconvert's --crossings.guess.speed-threshold: nobody crosses a motorway on foot.
_SLOWEST_KMH = 66
_KMH = {"": 1.0, "km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609, "knots": 1.852}
_SPEED = re.compile(r"^(\d+(?:\.\d+)?)\s*([a-z/]*)$")
# Keys whose values netconvert takes for numbers, and what it reads as one.
_NUMBERS = re.compile(
    r"^(lanes|width|est_width|layer|maxspeed|((cycleway|sidewalk):.*:?width))"
    r"(:(forward|backward))?$"
)
_NUMBER = re.compile(r"^[+-]?\d{1,4}([.,]\d+)?\s*[a-z/'\"]*$")
# A bridge that runs over another way for longer than this, and as near to its line, lies on it.
ALONG_M = 15.0
BESIDE_M = 2.5
_M_PER_DEG = 111_320.0

LEAST_M = 50.0  # what is less is lost at the edges of any box
MOST_NAMES = 5
MOST_FOOTWAYS = 10


def filter_osm(root: Element, lefthand: bool = False) -> None:
    """Drop ways that are not at street level, and tags that SUMO's tools fail at; changes `root`.

    Traffic may keep to the left. Tags `pavement_*`, `chair_way` and `kerb_*` are added; polyconvert
    passes on the last.
    """
    root[:] = [item for item in root if item.tag != "way" or not _is_hidden(_read_tags(item))]
    for item in (*root.iterfind("way"), *root.iterfind("node")):
        tags = item.findall("tag")
        senseless = {tag for tag in tags if not _is_sound(tag.get("k", ""), tag.get("v", ""))}
        item[:] = [child for child in item if child not in senseless]
    strip_orphans(root)
    _mark_buildings(root)
    _quicken_motorways(root)
    _mark_ways(root, lefthand)


def strip_orphans(root: Element) -> None:
    """Take the crossing tag off nodes that lie on no street, or are no crossings; changes `root`.

    It crashes netconvert 1.28 at nodes that lie on no street.
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
            node[:] = [
                tag for tag in node if (tag.get("k"), tag.get("v")) != ("highway", "crossing")
            ]


def denied_crossings(root: Element) -> list[str]:
    """The nodes at which the map says that there is no crossing."""
    found = [
        node
        for node in root.iterfind("node")
        if meanings("crossings", _read_tags(node)).get("built") == "no"
    ]
    return [node.get("id", "") for node in found]


def crossed_edges(root: Element) -> list[str]:
    """The edges that netconvert may make of streets with a crossing on them, in either direction.

    Where it joined them, their crossings would be lost.
    """
    crossings = {
        node.get("id")
        for node in root.iterfind("node")
        if _read_tags(node).get("highway") == "crossing"
    }
    found: list[str] = []
    for way in _ways_by_id(root).values():
        refs = [nd.get("ref") for nd in way.iterfind("nd")]
        is_street = {"highway", "pavement_left"} <= _read_tags(way).keys()
        if is_street and not crossings.isdisjoint(refs):
            way_id = way.get("id", "")
            names = [way_id, *(f"{way_id}#{number}" for number in range(len(refs)))]
            found += [*names, *(f"-{name}" for name in names)]
    return found


def denied_pavements(root: Element, net: Net, net_path: Path) -> list[str]:
    """The edges with pavements that the map denies, for any of the ways they are made of."""
    ways, places = _ways_by_id(root), _places(root)
    made_of = osm_ways_by_edge(net_path)
    found: list[str] = []
    for edge in net.streets:
        known = [ways[way_id] for way_id in made_of[edge.id] if way_id in ways]
        has_pavement = edge.has(LaneKind.SIDEWALK)
        if has_pavement and any(_denies(way, edge, places, net.lefthand) for way in known):
            found.append(edge.id)
    return found


def cut_bridges(root: Element, keep_service: bool = False) -> tuple[str, ...]:
    """Leave out the parts of bridges over other streets, and return their names; changes `root`.

    A part reaches from one junction to the next. Names are sorted, each once; what has none goes by
    its kind.
    """
    ways = _net_ways(root, keep_service)
    if not ways:
        return ()
    # 1. Find the parts, from the lowest level up: what is left out below is not in the way above.
    uses = Counter(node for way in ways for node in set(way.nodes))
    cuts: dict[int, set[int]] = {}  # number of a way: its segments that go
    lines = [way.piece(0, len(way.nodes) - 1) for way in ways]
    pairs = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=BESIDE_M).T.tolist()
    for high, low in sorted(pairs, key=lambda pair: (ways[pair[0]].level, pair)):
        if ways[high].level <= ways[low].level:
            continue
        upper, lower = (low, high) if ways[low].train and not ways[high].train else (high, low)
        rest = ways[lower].without(cuts.get(lower, set()))
        for segment in _over(ways[upper], rest, set(ways[lower].nodes)):
            part = _between_junctions(ways[upper].nodes, segment, uses)
            cuts.setdefault(upper, set()).update(part)
    # 2. Take them out. Railways are not named, for no trains run.
    _remove_segments(root, [(ways[number], removed) for number, removed in sorted(cuts.items())])
    named = (ways[number] for number in cuts if not ways[number].train)
    return tuple(sorted({_name_or_kind(way.element) for way in named}))


@dataclass(frozen=True, slots=True, kw_only=True)
class _MapWay:
    """A street or a way on foot of a map."""

    id: str  # without a sign; of a relation with the word before it
    street: bool
    name: str
    inside_m: float  # how much of it lies in the box; of an area, its outline
    why: str  # why it may be missing, by its tags


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
        """What of `ways` the net has not.

        Args:
            ways: Those of the map.
            drawn: Ids of those that the net has.
            walked: Ids of those with lanes for walkers.
        """
        missing = [way for way in ways if way.id not in (drawn if way.street else walked)]
        by_name: dict[str, float] = defaultdict(float)
        for way in missing:
            if way.name and way.street:
                by_name[way.name] += way.inside_m
        lost = [way for way in missing if not way.street]
        return cls(
            streets_m=sum(way.inside_m for way in ways if way.street),
            footways_m=sum(way.inside_m for way in ways if not way.street),
            streets_left_out_m=sum(way.inside_m for way in missing if way.street),
            footways_left_out_m=sum(way.inside_m for way in lost),
            names=tuple(sorted(by_name, key=lambda name: (-by_name[name], name))),
            footways=tuple(sorted(lost, key=lambda way: (-way.inside_m, way.id))),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Streets where they are more than next to nothing, and each way on foot or the longest."""
        notes = []
        if self.streets_left_out_m >= LEAST_M:
            names = f" ({join_names(self.names, MOST_NAMES)})" if self.names else ""
            notes.append(
                f"left out: {_km(self.streets_left_out_m)} of {_km(self.streets_m)} of streets: "
                f"bridges, and streets connected to the rest only outside of the box{names}; "
                "a larger --bbox or --keep-service may connect them"
            )
        if lost := self.footways:
            footways = ", ".join(map(_footway_text, lost[:MOST_FOOTWAYS]))
            more_m = sum(way.inside_m for way in lost[MOST_FOOTWAYS:])
            if len(lost) > MOST_FOOTWAYS:
                footways += f", and {len(lost) - MOST_FOOTWAYS} more ({more_m:.0f} m)"
            notes.append(
                f"left out: {self.footways_left_out_m:.0f} of {self.footways_m:.0f} m of footways "
                f"in the box, by map id: {footways}"
            )
        return tuple(notes)


def map_ways(root: Element, box: Box) -> tuple[_MapWay, ...]:
    """The streets of an extract at street level, and its ways on foot; `root` is as it was read."""
    places = _places(root)
    lines = {
        way.get("id", ""): [
            ref for node in way.iterfind("nd") if (ref := node.get("ref", "")) in places
        ]
        for way in root.iterfind("way")
    }
    found = []
    for item in (*root.iterfind("way"), *root.iterfind("relation")):
        # 1. Streets and ways on foot alone.
        tags = _read_tags(item)
        highway = tags.get("highway")
        street = highway in _TAGS["streets"] and not _is_hidden(tags) and tags.get("area") != "yes"
        if not street and not _is_footway(tags):
            continue
        # 2. Its line; of an area of several ways their outlines.
        refs = [item.get("id", "")] if item.tag == "way" else _outlines(item, tags)
        parts = [lines[ref] for ref in refs if ref in lines]
        way = _MapWay(
            id=f"{'relation ' * (item.tag == 'relation')}{item.get('id', '').lstrip('-')}",
            street=street,
            name=tags.get("name", ""),
            inside_m=sum(_inside_m([places[node] for node in part], box) for part in parts),
            why=_why_by_tags(tags),
        )
        found.append(way)
    return tuple(way for way in found if way.inside_m > 0.0)


def count_inside(root: Element, box: Box, highway: str) -> int:
    """How many nodes with this value of `highway` the map has in the box; unpainted ones count."""
    nodes = (node for node in root.iterfind("node") if _read_tags(node).get("highway") == highway)
    return sum(
        box.holds((float(node.get("lon", "0")), float(node.get("lat", "0")))) for node in nodes
    )


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


def _is_sound(key: str, value: str) -> bool:
    """Whether a tag has a value, and a number where netconvert needs one: else it may stop."""
    plain = value.strip()
    if not key or not plain:
        return False
    if not _NUMBERS.match(key):
        return True
    # Other than numbers there are words, and rules such as "DE:urban".
    return bool(_NUMBER.match(plain)) or plain in _TAGS["words"] or ":" in plain


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
            # It only says which ways belong together.
            relation[:] = [
                tag for tag in relation if tag.tag != "tag" or tag.get("k") != "building"
            ]
            continue
        outer = _ways(relation, "outer", ways)
        if "building" in tags or any(_read_tags(way).get("building") for way in outer):
            for way in _ways(relation, "inner", ways):
                if "building" not in _read_tags(way):
                    SubElement(way, "tag", {"k": "building", "v": _COURTYARD})


def _ways(relation: Element, role: str, ways: dict[str, Element]) -> list[Element]:
    """The ways that a relation has in a role, as far as they are in the extract."""
    refs = [
        m.get("ref", "")
        for m in relation.iterfind("member")
        if (m.get("type"), m.get("role")) == ("way", role)
    ]
    return [ways[ref] for ref in refs if ref in ways]


def _quicken_motorways(root: Element) -> None:
    """Make slow motorways so fast that netconvert guesses no crossings on foot there."""
    for way in root.iterfind("way"):
        tags = _read_tags(way)
        motorway = tags.get("highway") == "motorway" or tags.get("motorroad") == "yes"
        if "highway" not in tags or not motorway:
            continue
        for tag in way.iterfind("tag"):
            # Without a limit, or by a rule, motorways are fast.
            match = _SPEED.match(tag.get("v", "").strip().lower())
            if tag.get("k") not in _TAGS["speeds"] or match is None:
                continue
            if float(match[1]) * _KMH.get(match[2], 1.0) < _SLOWEST_KMH:
                tag.set("v", str(_SLOWEST_KMH))


def _mark_ways(root: Element, lefthand: bool) -> None:
    """Put pavements, kerbs and ways on foot into the words of SUMO's tools; changes `root`.

    An empty word takes a tag away.
    """
    for way in root.iterfind("way"):
        tags = _read_tags(way)
        if "highway" not in tags and "railway" not in tags:
            continue
        # 1. Pavements: for each side, and in netconvert's word.
        words = _pavement_words(tags, lefthand)
        # 2. Kerbs.
        for side in ("left", "right"):
            words[f"kerb_{side}"] = tags.get(f"kerb:{side}", tags.get("kerb:both", ""))
        # 3. Ways on foot.
        if tags.get("highway") in _TAGS["on_foot"]:
            means = meanings("footways", tags)
            words |= {"chair_way": "no"} if means.get("chairs") == "no" else {}
            is_ramp = tags["highway"] == "steps" and "steps" in means
            words |= {"highway": "footway"} if is_ramp else {}
        way[:] = [tag for tag in way if tag.tag != "tag" or tag.get("k") not in words]
        for key, word in words.items():
            if word:
                SubElement(way, "tag", {"k": key, "v": word})


def _pavement_words(tags: dict[str, str], lefthand: bool) -> dict[str, str]:
    """Words for the pavements of a way; the map's own tags for them get empty ones."""
    sides = meanings("streets", tags)
    words = {key: "" for key in tags if key.startswith("sidewalk")}
    words |= {f"pavement_{side}": word for side, word in sides.items()}
    if mapped := [side for side, word in sides.items() if word == "paved"]:
        # netconvert calls the side of those who drive along the way the right.
        named = {"left": "right", "right": "left"}[mapped[0]] if lefthand else mapped[0]
        words["sidewalk"] = "both" if len(mapped) == 2 else named
    elif "bare" in sides.values():
        # Else it takes foot=yes for pavements. A guess follows later.
        words["sidewalk"] = "no"
    return words


def _ways_by_id(root: Element) -> dict[str, Element]:
    """The ways of an extract by their ids without a sign; of two the last."""
    return {way.get("id", "").lstrip("-"): way for way in root.iterfind("way")}


def _denies(
    way: Element, edge: Edge, places: dict[str, tuple[float, float]], lefthand: bool
) -> bool:
    """Whether a way has no pavement on the side of an edge that was made of it."""
    named, way_id = edge.id.partition("#")[0], way.get("id", "")
    along = named == way_id
    if named not in (way_id, f"-{way_id}"):  # it was joined to the way that gives the name
        ends = [places[nd.get("ref", "")] for nd in way.iterfind("nd") if nd.get("ref") in places]
        step_m = edge.lanes[0].points_m[-1] - edge.lanes[0].points_m[0]
        along = bool(np.dot(np.subtract(ends[-1], ends[0]), step_m) > 0.0)
    side = "right" if along != lefthand else "left"
    return _read_tags(way).get(f"pavement_{side}", "bare") == "bare"


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

    def without(self, removed: Set[int]) -> shapely.MultiLineString:
        """Its segments but for those of these numbers."""
        segments = [k for k in range(len(self.nodes) - 1) if k not in removed]
        return shapely.MultiLineString([self.piece(k, k + 1) for k in segments])


def _net_ways(root: Element, keep_service: bool) -> list[_Way]:
    """The streets and railways that become part of the net."""
    places = _places(root)
    middle = np.mean(list(places.values()) or [(0.0, 0.0)], axis=0)
    scale_m = _M_PER_DEG * np.array([np.cos(deg2rad(float(middle[1]))), 1.0])
    found: list[_Way] = []
    for element in root.iterfind("way"):
        tags = _read_tags(element)
        if "highway" in tags:
            is_service = tags["highway"] == "service"
            is_built = tags["highway"] not in _TAGS["no_way"] and (keep_service or not is_service)
        else:
            is_built = tags.get("railway") in _TAGS["rails"]
        nodes = tuple(ref for nd in element.iterfind("nd") if (ref := nd.get("ref", "")) in places)
        is_whole = len(nodes) >= 2 and len(nodes) == len(element.findall("nd"))
        if not is_built or not is_whole or tags.get("area") == "yes":
            continue
        points_m = (np.array([places[node] for node in nodes]) - middle) * scale_m
        train = "highway" not in tags and tags.get("railway") in _TAGS["trains"]
        level = _layer(tags) or (1.0 if tags.get("bridge", "no") != "no" else 0.0)
        found.append(
            _Way(element=element, nodes=nodes, points_m=points_m, level=level, train=train)
        )
    return found


def _over(way: _Way, other: shapely.MultiLineString, joined: set[str]) -> list[int]:
    """Segments of a way that cross another one, or lie along it, without a common node there."""
    near = shapely.union_all(
        [shapely.Point(way.points_m[k]) for k, node in enumerate(way.nodes) if node in joined]
    )
    found: list[int] = []
    beside = other.buffer(BESIDE_M) if near.is_empty else shapely.Polygon()
    for k in range(len(way.nodes) - 1):
        meets = way.piece(k, k + 1).intersection(other)
        crosses = not meets.is_empty and (near.is_empty or not meets.within(near.buffer(0.05)))
        if crosses or way.piece(k, k + 1).intersection(beside).length > ALONG_M:
            found.append(k)
    return found


def _between_junctions(nodes: tuple[str, ...], segment: int, uses: Counter[str]) -> range:
    """Segments of a way from the junction before one of them to the junction after it."""
    first, last = segment, segment + 1
    while first > 0 and uses[nodes[first]] < 2:
        first -= 1
    while last < len(nodes) - 1 and uses[nodes[last]] < 2:
        last += 1
    return range(first, last)


def _remove_segments(root: Element, cuts: list[tuple[_Way, set[int]]]) -> None:
    """Take segments out of ways; of a way that falls apart all pieces but one are new ways."""
    ids = [int(way.get("id", "0")) for way in root.iterfind("way")]
    sign = 1 if max(ids, default=1) > 0 else -1
    free = max(map(abs, ids), default=0) + 1
    for way, removed in cuts:
        runs: list[list[str]] = [[]]
        for k, node in enumerate(way.nodes):
            runs[-1].append(node)
            if k in removed:
                runs.append([])
        place = list(root).index(way.element)
        tags = [deepcopy(tag) for tag in way.element.iterfind("tag")]
        root.remove(way.element)
        for number, nodes in enumerate(run for run in runs if len(run) > 1):
            piece = Element("way", way.element.attrib if number == 0 else {"id": str(sign * free)})
            free += number > 0
            piece.extend([Element("nd", {"ref": node}) for node in nodes] + deepcopy(tags))
            root.insert(place + number, piece)


def _name_or_kind(way: Element) -> str:
    tags = _read_tags(way)
    kind = tags.get("highway") or tags.get("railway")
    return tags.get("name") or tags.get("ref") or f"a {kind} without a name"


def _places(root: Element) -> dict[str, tuple[float, float]]:
    """Longitude and latitude of each node of an extract."""
    return {
        node.get("id", ""): (float(node.get("lon", "0")), float(node.get("lat", "0")))
        for node in root.iterfind("node")
    }


def _footway_text(way: _MapWay) -> str:
    name = " ".join(filter(None, (way.id, way.name)))
    return f"{name} ({way.inside_m:.0f} m{', ' * bool(way.why)}{way.why})"


def _is_footway(tags: dict[str, str]) -> bool:
    """Whether it is a way for walkers, or for cyclists and walkers."""
    highway, foot = tags.get("highway"), tags.get("foot")
    is_shared = highway == "cycleway" and foot in ("yes", "designated")
    return is_shared or (highway in _TAGS["footways"] and foot != "no")


def _outlines(relation: Element, tags: dict[str, str]) -> list[str]:
    """Ids of the ways around the area that a relation is; none where it is no area."""
    if tags.get("type") != "multipolygon":
        return []
    ways = relation.iterfind("member[@type='way']")
    return [way.get("ref", "") for way in ways if way.get("role") != "inner"]


def _inside_m(points: list[tuple[float, float]], box: Box) -> float:
    """Length in m of the parts between points (longitude, latitude) whose middles the box holds."""
    total_m = 0.0
    for (x1, y1), (x2, y2) in itertools.pairwise(points):
        if box.holds(((x1 + x2) / 2, (y1 + y2) / 2)):
            total_m += math.hypot(*Box(x1, y1, x2, y2).size_m)
    return total_m


def _why_by_tags(tags: dict[str, str]) -> str:
    if _is_hidden(tags):
        return "a tunnel, indoors, or on another level"
    if tags["highway"] == "steps":
        return "steps"
    if tags.get("area") == "yes" or tags.get("type") == "multipolygon":
        return "an open area" if tags["highway"] == "pedestrian" else "an area"
    return "closed to the public" if tags.get("foot", tags.get("access")) in _TAGS["closed"] else ""


def _read_tags(item: Element) -> dict[str, str]:
    """The tags of a node or a way."""
    return {tag.get("k", ""): tag.get("v", "") for tag in item.iterfind("tag")}


def _km(length_m: float) -> str:
    return f"{length_m / 1e3:.2f} km"

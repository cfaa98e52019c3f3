"""What changes in a scenario's files when its net gets pavements: lanes, positions, signals.

A pavement becomes lane 0 of its edge, so lanes move on by one, and positions are found again. Each
state of a signal program gets a letter for every new crossing.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import shapely

from wcsim.errors import TownError
from wcsim.towns.sumo.net import Connection, Lane, Net

SAME_M = 0.01  # as nets are written
FAR_M = 0.05  # a place that moved farther is reported
LEAST_M = 1.0  # of a stop or an area of which a junction has taken the rest
# How far before its end a lane still sees what lay beyond it: SUMO's vehicles stand so far back.
_NEAR_END_M = 1.0
_SPANS = frozenset(
    (
        "busStop", "trainStop", "containerStop", "chargingStation", "parkingArea", "stop",
        "laneAreaDetector", "e2Detector", "overheadWireSegment"
    )
)  # fmt: skip
_AREAS = ("laneAreaDetector", "e2Detector")  # their `length` lies on the lane
# Attributes of other names that name lanes.
_IDS = (("closingLaneReroute", "id"), ("lane", "id"), ("param", "key"))
_POSITIONS = ("pos", "startPos", "endPos")
_VEHICLES = ("vehicle", "trip", "flow")
_WALKS = ("walk", "personTrip", "tranship")
_RIDES = ("ride", "transport")
_PEOPLE = ("person", "personFlow", "container", "containerFlow")
_RINGS = "NEMA"  # the type of programs that show a phase of each ring at once
# Of a phase with all lights red: shorter ones clear the junction, longer ones are for walkers.
_SHORT_S = 8.0
_RED = frozenset("rRs")
_GREEN = frozenset("Gg")
_OFF = frozenset("oO")
_CHANGING = frozenset("yYu")

_LinkKey = tuple[str, str, int, int]
"""Edges and lanes, from and to."""
_Way = tuple[str, ...]
"""The edges of a route, or the first and the last edge of a trip."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _NeverGreen:
    """A crossing that one of its signal's programs never gives green."""

    signal: str
    edge: str  # one that is crossed
    in_net: bool  # where the program lies; else in an additional file
    rings: bool  # whether it is a NEMA controller's


@dataclass(frozen=True, slots=True, kw_only=True)
class _VehicleLink:
    """A vehicle's way over a junction, as one of its signal's links."""

    link: int
    start: str  # edge ids
    end: str
    straight: bool


@dataclass(slots=True, kw_only=True)
class _SignalLinks:
    """What the links of one traffic light are in the net with crossings."""

    count: int = 0
    was: dict[int, int] = field(default_factory=dict)  # link -> the link that it was before
    drives: list[_VehicleLink] = field(default_factory=list)
    # Link -> the edges that it crosses.
    crossings: dict[int, frozenset[str]] = field(default_factory=dict)


class Paving:
    """What is known of a scenario while its files are gone through, and what was done."""

    def __init__(self, before: Net, after: Net) -> None:
        """The net, and the same with pavements. Raises TownError when it is another net."""
        self.lanes = _LaneMap(before, after)
        self.signals = _find_links(before, after, self.lanes)
        self.routes: dict[str, _Way] = {}  # by id, of all files
        # A distribution of routes -> its first, where it names that.
        self.members: dict[str, str] = {}
        self.placed = 0  # elements that lie on a lane
        self.programs = 0
        self.moved_m: dict[str, float] = {}  # element -> how far, where that is farther than FAR_M
        self.lost: list[str] = []  # lanes within junctions that are not found again
        self.never_green: list[_NeverGreen] = []
        self.overridden: set[str] = set()  # signals of which SUMO loads a program after the net's
        self.parking: list[str] = []  # parking areas beside lanes that have a pavement now

    def note_routes(self, root: Element) -> None:
        """Note the edges of every route, and of every distribution of routes, that has a name."""
        for element in root.iter():
            name, tag = element.get("id", ""), _tag(element)
            if name and tag == "route" and (edges := element.get("edges", "").split()):
                self.routes[name] = tuple(edges)
            elif name and tag == "routeDistribution":
                if member := _first_member(element):
                    self.members[name] = member
                elif way := _way(element, self):
                    self.routes[name] = way

    def edit(self, root: Element, *, in_net: bool = False) -> bool:
        """Give attributes of a file, or of the net, their new values; whether any has changed."""
        changed = False
        for element in root.iter():
            tag, before = _tag(element), dict(element.attrib)
            if tag == "tlLogic":
                changed |= _program(element, self, in_net)
            element.attrib |= _placed(element, tag, self) | _travelling(element, tag, self)
            changed |= element.attrib != before
        return changed


class _LaneMap:
    """The lanes of a net before and after it got pavements; from right to left."""

    def __init__(self, before: Net, after: Net) -> None:
        """Raises TownError for an edge of the first that the second lacks, or with fewer lanes."""
        self.before, self.after = (_edges(net, "", "connector") for net in (before, after))
        # Those within junctions too, which other nets call by other names.
        all_edges = (_edges(net, "", "connector", "internal") for net in (before, after))
        self.lines, self.new_lines = (
            {lane.id: lane for lanes in edges.values() for lane in lanes} for edges in all_edges
        )
        self._drawn: dict[tuple[bool, str], shapely.LineString] = {}  # whether before, id
        self.moved: dict[str, str] = {}  # id of every lane before -> after
        for edge, lanes in self.before.items():
            new = self.after.get(edge, ())
            if not 0 <= len(new) - len(lanes) <= 1:
                raise TownError(
                    f"edge {edge!r} has {len(lanes)} lanes, and {len(new)} after netconvert; "
                    "expected at most one more: repair the net in netedit, and try again"
                )
            shifted = new[self.shift(edge) :]
            self.moved |= {lane.id: other.id for lane, other in zip(lanes, shifted, strict=True)}
        vias = {self.key(link, shifted=False): link.via for link in _between_streets(after)}
        for link in _between_streets(before):
            if link.via in self.lines and vias.get(self.key(link)) in self.new_lines:
                self.moved[link.via] = vias[self.key(link)]

    def shift(self, edge: str) -> int:
        """By how many indices the lanes of an edge moved; 0 for one that the net does not have."""
        return len(self.after.get(edge, ())) - len(self.before.get(edge, ()))

    def key(self, link: Connection, *, shifted: bool = True) -> _LinkKey:
        """The edges and lanes of a connection; `shifted`: one of before, counted as after."""
        start, end = (self.shift(edge) if shifted else 0 for edge in (link.start, link.end))
        return link.start, link.end, link.start_lane + start, link.end_lane + end

    def position(self, lane: str, pos_m: float, *, span: bool) -> tuple[float, float]:
        """A position on a lane of before, found again where it lay.

        Args:
            lane: Its id in the net of before.
            pos_m: The position; negative ones count from the end.
            span: Whether it is an end of something long, which may reach to the very ends of the
                lane.

        Returns:
            The position on that lane of after, and how far in m the place has moved along the lane:
            not at all, unless a junction has grown over it.
        """
        old, new = self.lines[lane], self.new_lines[self.moved[lane]]
        old_m, new_m = _length_m(old), _length_m(new)
        old_line, line = self._line(old, before=True), self._line(new, before=False)
        at_m = min(old_m, max(0.0, old_m + pos_m if pos_m < 0.0 else pos_m))
        place = _point(old_line, at_m, old_m)
        found_m = float(line.project(place, normalized=True)) * new_m
        if not span:
            low_m, high_m = min(at_m, _NEAR_END_M), new_m - min(old_m - at_m, _NEAR_END_M)
            found_m = min(max(found_m, min(low_m, high_m)), high_m)
        found_m = math.floor(found_m * 100.0 + 0.5) / 100.0
        found_m = max(0.0, min(found_m, math.floor(new_m * 100.0 + 1e-6) / 100.0))
        return found_m, _along_m(line, place, _point(line, found_m, new_m))

    def _line(self, lane: Lane, *, before: bool) -> shapely.LineString:
        """A lane as it is drawn; made once, for scenarios have a hundred thousand positions."""
        key = before, lane.id
        if key not in self._drawn:
            points_m = list(lane.points_m)
            self._drawn[key] = shapely.LineString(points_m if len(points_m) > 1 else points_m * 2)
        return self._drawn[key]


def _along_m(line: shapely.LineString, old: shapely.Point, new: shapely.Point) -> float:
    """How far two places are from each other in the direction of a line."""
    at_m, step_m = line.project(new), min(0.5, 0.5 * line.length)
    start = line.interpolate(max(0.0, at_m - step_m))
    end = line.interpolate(min(line.length, at_m + step_m))
    way = (end.x - start.x, end.y - start.y)
    size_m = math.hypot(*way)
    if not size_m:
        return float(old.distance(new))
    return float(abs((new.x - old.x) * way[0] + (new.y - old.y) * way[1])) / size_m


def _length_m(lane: Lane) -> float:
    """SUMO's length of a lane, which may be drawn longer or shorter."""
    return max(0.01, lane.length_m)


def _point(line: shapely.LineString, pos_m: float, length_m: float) -> shapely.Point:
    """The place of a position on a lane of that length."""
    point: shapely.Point = line.interpolate(min(1.0, max(0.0, pos_m / length_m)), normalized=True)
    return point


def _edges(net: Net, *functions: str) -> dict[str, tuple[Lane, ...]]:
    """The lanes of edges with these functions, by edge."""
    return {edge.id: edge.lanes for edge in net.edges if edge.function in functions}


def _between_streets(net: Net) -> list[Connection]:
    """The connections between streets that lead over an inner lane."""
    return [link for link in net.connections if link.via and not link.start.startswith(":")]


def _find_links(before: Net, after: Net, lanes: _LaneMap) -> dict[str, _SignalLinks]:
    """The links of all traffic lights of a net that has crossings now."""
    old = {
        (link.tls_id, *lanes.key(link)): max(0, link.tls_link)
        for link in before.connections
        if link.tls_id
    }
    crossings = (edge for edge in after.edges if edge.function == "crossing")
    crossed = {edge.id: frozenset(edge.crossed) for edge in crossings}
    found: dict[str, _SignalLinks] = defaultdict(_SignalLinks)
    for link in after.connections:
        if not (name := link.tls_id):
            continue
        signal, index = found[name], max(0, link.tls_link)
        key = name, *lanes.key(link, shifted=False)
        numbers = (index, link.tls_link2)
        signal.count = max(signal.count, *(number + 1 for number in numbers))
        crossing = next((crossed[name] for name in (link.end, link.start) if name in crossed), None)
        if crossing is not None and key not in old:
            signal.crossings |= {number: crossing for number in numbers if number >= 0}
            continue
        if key in old:
            signal.was[index] = old[key]
        if crossing is None:
            drive = _VehicleLink(link=index, start=link.start, end=link.end, straight=link.straight)
            signal.drives.append(drive)
    return dict(found)


def _placed(element: Element, tag: str, paving: Paving) -> dict[str, str]:
    """New values of an element on a lane or an edge, or that names lanes. Raises TownError."""
    named = ("lanes", *(key for owner, key in _IDS if owner == tag))
    found = {key: _renamed(value, paving) for key in named if (value := element.get(key))}
    name, lanes = element.get("id", ""), _lanes_under(element, tag, paving)
    if element.get("lane"):
        if lanes[0] not in paving.lanes.lines:
            raise TownError(
                f"{tag} {name!r}: names lane {lanes[0]!r}, which the net does not have; "
                "correct that name first"
            )
        paving.placed += 1
        if tag == "parkingArea" and paving.lanes.shift(lanes[0].rpartition("_")[0]):
            paving.parking.append(name)
        found["lane"] = _renamed(element.get("lane", ""), paving)
    if not lanes or lanes[0] not in paving.lanes.moved or lanes[-1] not in paving.lanes.moved:
        return found
    for key in _POSITIONS:
        if (pos_m := _number(element.get(key))) is not None:
            lane = lanes[-1] if key == "endPos" else lanes[0]
            found[key], along_m = _position(lane, pos_m, tag in _SPANS, paving.lanes)
            if along_m > FAR_M:
                moved = f"{_tag(element)} {name or 'on ' + lane}"
                paving.moved_m[moved] = max(along_m, paving.moved_m.get(moved, 0.0))
    return found | _whole(element, tag, lanes, found, paving)


def _lanes_under(element: Element, tag: str, paving: Paving) -> list[str]:
    """The lanes of the old net that it lies on; of an edge that it names instead, the leftmost."""
    edge = element.get("edge", "")
    on_edge = edge in paving.lanes.before and tag in ("stop", "calibrator")
    if on_edge and not element.get("lane"):
        return [paving.lanes.before[edge][-1].id]
    return list(_words(element.get("lane") or element.get("lanes") or ""))


def _whole(
    element: Element, tag: str, lanes: list[str], found: Mapping[str, str], paving: Paving
) -> dict[str, str]:
    """Something is left of an area that a junction has grown into."""
    new_m = _length_m(paving.lanes.new_lines[paving.lanes.moved[lanes[-1]]])
    first = "startPos" if "startPos" in found else "pos"
    start_m, end_m = _number(found.get(first)), _number(found.get("endPos"))
    size_m = _number(element.get("length"))
    if tag in _AREAS and start_m is not None and start_m >= 0.0 and size_m:
        start_m = min(start_m, max(0.0, new_m - LEAST_M))
        return {first: _text(start_m), "length": _text(min(size_m, new_m - start_m))}
    short = start_m is not None and end_m is not None and 0.0 <= end_m < start_m + LEAST_M
    if tag not in _SPANS or len(set(lanes)) > 1 or not short or start_m is None or end_m is None:
        return {}
    end_m = min(max(end_m, LEAST_M), new_m)
    return {first: _text(max(0.0, end_m - LEAST_M)), "endPos": _text(end_m)}


def _position(lane: str, pos_m: float, span: bool, lanes: _LaneMap) -> tuple[str, float]:
    """A position as it is written for the new net, and how far its place moved along the lane."""
    found_m, along_m = lanes.position(lane, pos_m, span=span)
    old_m, new_m = _length_m(lanes.lines[lane]), _length_m(lanes.new_lines[lanes.moved[lane]])
    same_m = pos_m if pos_m >= 0.0 else pos_m + old_m
    is_same = abs(found_m - same_m) <= SAME_M and (pos_m >= 0.0 or abs(new_m - old_m) <= SAME_M)
    return _text(pos_m if is_same else found_m), along_m


def _travelling(element: Element, tag: str, paving: Paving) -> dict[str, str]:
    """Where a traveller departs and arrives: lanes by number, positions on the edges at both ends.

    https://sumo.dlr.de/docs/Definition_of_Vehicles%2C_Vehicle_Types%2C_and_Routes.html
    (departEdge, arrivalEdge)
    """
    way = None
    if tag in (*_VEHICLES, *_WALKS, *_RIDES):
        way = _way(element, paving)
    elif tag in _PEOPLE:
        way = _first_edge(element, paving)
    if way is None:
        return {}
    found = {}
    for word, last in (("depart", 0), ("arrival", len(way) - 1)):
        edge, known = _edge_at(element, f"{word}Edge", way, last)
        lane, pos_m = element.get(f"{word}Lane", ""), _number(element.get(f"{word}Pos"))
        if lane.isdigit():
            found[f"{word}Lane"] = str(int(lane) + paving.lanes.shift(edge))
        lines = paving.lanes.before.get(edge)
        if pos_m is not None and known and lines and edge in paving.lanes.after:
            found[f"{word}Pos"] = _position(lines[-1].id, pos_m, True, paving.lanes)[0]
    return found


def _first_edge(person: Element, paving: Paving) -> _Way | None:
    """Where a person's plan starts: at its first stage, or one after stops at named places."""
    for stage in person:
        if _tag(stage) == "stop":
            edge = stage.get("edge") or stage.get("lane", "").rpartition("_")[0]
        elif _tag(stage) in (*_WALKS, *_RIDES):
            return (way[0], "") if (way := _way(stage, paving)) else None
        else:
            continue
        if edge:
            return edge, ""
    return None


def _edge_at(element: Element, key: str, way: _Way, last: int) -> tuple[str, bool]:
    """The edge that an attribute names by number, else `way[last]`; whether it is sure."""
    number = element.get(key)
    if number is None:
        return way[last], True
    # Those of a trip count along what is routed; "random" is none.
    is_trip = element.get("from") is not None or element.get("to") is not None
    if is_trip or not number.isdigit() or int(number) >= len(way):
        return way[last], False
    return way[int(number)], True


def _way(element: Element, paving: Paving) -> _Way | None:
    """The edges of a route, at least the first and the last; "" for one that is not named."""
    inner = next((child for child in element.iter() if child.get("edges")), None)
    if edges := inner.get("edges", "").split() if inner is not None else []:
        return tuple(edges)
    inside = (child for child in element if _tag(child) == "routeDistribution")
    route = element.get("route", "") or next((_first_member(child) for child in inside), "")
    named = paving.routes.get(paving.members.get(route, route))
    start, end = element.get("from", ""), element.get("to", "")
    return named or ((start, end) if start or end else None)


def _first_member(distribution: Element) -> str:
    """The name of the first route of a distribution; empty where it holds that route itself."""
    if names := distribution.get("routes", "").split():
        return names[0]
    return next((child.get("refId", "") for child in distribution if _tag(child)), "")


def _program(logic: Element, paving: Paving, in_net: bool) -> bool:
    """Give each phase of a program its letters for the new links; whether any has changed."""
    signal = logic.get("id", "")
    links = paving.signals.get(signal)
    phases = [child for child in logic if _tag(child) == "phase" and child.get("state")]
    if links is None or not phases:
        return False
    paving.programs += 1
    if not in_net:
        paving.overridden.add(signal)
    given = [phase.get("state", "") for phase in phases]
    durations_s = [_number(phase.get("duration")) or 0.0 for phase in phases]
    # A state of each ring is shown at once, and none alone tells which vehicles drive.
    rings = logic.get("type") == _RINGS
    states = _all_red(given, links) if rings else _padded(given, durations_s, links)
    for link, edges in links.crossings.items():
        if all(state[link] == "r" for state in states):
            never = _NeverGreen(signal=signal, edge=min(edges), in_net=in_net, rings=rings)
            paving.never_green.append(never)
    for phase, state in zip(phases, states, strict=True):
        phase.set("state", state)
    return tuple(given) != states


def _all_red(states: Sequence[str], links: _SignalLinks) -> tuple[str, ...]:
    """The states of a program, in their order, with each new crossing at red."""
    moved = [_moved(state, links) for state in states]
    return tuple("".join(_with_crossings(lights, frozenset(), links)) for lights in moved)


def _padded(
    states: Sequence[str], durations_s: Sequence[float], links: _SignalLinks
) -> tuple[str, ...]:
    """The states of a program, in their order, with a letter for each new crossing."""
    # 1. Find the crossings that no vehicle drives over but those that turn and have to yield.
    moved = [_moved(state, links) for state in states]
    free = [
        {link: _is_free(lights, edges, links.drives) for link, edges in links.crossings.items()}
        for lights in moved
    ]
    # 2. Find the states in which lights change, or the junction is cleared.
    changing = []
    for state, duration_s in zip(states, durations_s, strict=True):
        shown = set(state)
        clears = not shown & (_GREEN | _OFF) and duration_s < _SHORT_S
        changing.append(bool(shown & _CHANGING) or clears)
    made = []
    for number, state_lights in enumerate(moved):
        # 3. A crossing turns red in time: before it must be red, while lights change.
        then = number
        while changing[then] and (then + 1) % len(changing) != number:
            then = (then + 1) % len(changing)
        green = {link for link, is_free in free[number].items() if is_free and free[then][link]}
        lights = _with_crossings(state_lights, green, links)
        made.append("".join(_with_yields(lights, links)))
    return tuple(made)


def _with_crossings(lights: list[str], green: Set[int], links: _SignalLinks) -> list[str]:
    """A state with the light of each crossing; off where it is off for all vehicles."""
    lit = list(lights)
    for link in links.crossings:
        lit[link] = "G" if link in green else "r"
        if all(lit[drive.link] in _OFF for drive in links.drives):
            lit[link] = "o"
    return lit


def _with_yields(lights: list[str], links: _SignalLinks) -> list[str]:
    """A state in which vehicles that turn into a street with a green crossing have to yield."""
    lit = list(lights)
    for drive in links.drives:
        crossed = (edges for link, edges in links.crossings.items() if lit[link] == "G")
        turns = lit[drive.link] == "G" and not drive.straight
        if turns and any(drive.end in edges for edges in crossed):
            lit[drive.link] = "g"
    return lit


def _moved(state: str, links: _SignalLinks) -> list[str]:
    lights = list(state.ljust(links.count, "r"))
    for link, was in links.was.items():
        if was < len(state):
            lights[link] = state[was]
    return lights


def _is_free(lights: Sequence[str], edges: frozenset[str], drives: Sequence[_VehicleLink]) -> bool:
    """Whether no vehicle with a green or yellow light crosses without having to yield."""
    driven = [drive for drive in drives if lights[drive.link] not in _RED]
    return not any(
        drive.start in edges or (drive.end in edges and drive.straight) for drive in driven
    )


def _renamed(value: str, paving: Paving) -> str:
    """Names of lanes, one or several, as they are in the new net."""
    moved = paving.lanes.moved
    lost = [word for word in _words(value) if word.startswith(":") and word not in moved]
    inner = [word for word in lost if word.rpartition("_")[2].isdigit()]
    paving.lost += [word for word in inner if word not in paving.lost]
    words = {word: moved[word] for word in _words(value) if word in moved}
    comma = "," if "," in value else " "
    return comma.join(words.get(word, word) for word in _words(value)) if words else value


def _words(value: str) -> Iterable[str]:
    return value.replace(",", " ").split()


def _tag(element: Element) -> str:
    """The bare name of an element, "" for a comment."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None  # a word, such as "random"


def _text(number: float) -> str:
    return f"{number:.2f}".rstrip("0").rstrip(".") if number else "0"

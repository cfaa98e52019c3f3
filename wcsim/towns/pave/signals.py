"""Signal programs for a net that has got crossings: each state is given a letter for every new link."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

_SHORT_S = 8.0  # of a phase in which everything is red: shorter ones clear the junction, longer ones are for walkers
_RED = frozenset("rRs")
_GREEN = frozenset("Gg")
_OFF = frozenset("oO")
_CHANGING = frozenset("yYu")
_STRAIGHT = "s"


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleLink:
    """A vehicle's way over a junction, as one of its signal's links."""

    link: int
    start: str  # edge ids
    end: str
    straight: bool


@dataclass(slots=True, kw_only=True)
class SignalLinks:
    """What the links of one traffic light are in the net with crossings."""

    count: int = 0
    was: dict[int, int] = field(default_factory=dict)  # link -> the link that it was before
    drives: list[VehicleLink] = field(default_factory=list)
    crossings: dict[int, frozenset[str]] = field(default_factory=dict)  # link -> the edges that it crosses


def links_of(before: Element, after: Element, shifts: Mapping[str, int]) -> dict[str, SignalLinks]:
    """The links of all traffic lights of a net that has crossings now; `shifts` says how lane indices moved."""
    old: dict[tuple[str, str, str, int, int], int] = {}
    for link in before.iterfind("connection"):
        if link.get("tl"):
            old[_key(link, shifts)] = int(link.get("linkIndex", "0"))
    crossed = {
        edge.get("id", ""): frozenset(edge.get("crossingEdges", "").split())
        for edge in after.iterfind("edge")
        if edge.get("function") == "crossing"
    }
    found: dict[str, SignalLinks] = defaultdict(SignalLinks)
    for link in after.iterfind("connection"):
        if not link.get("tl"):
            continue
        signal, index, key = found[link.get("tl", "")], int(link.get("linkIndex", "0")), _key(link, {})
        numbers = (index, int(link.get("linkIndex2", "-1")))
        signal.count = max(signal.count, *(number + 1 for number in numbers))
        crossing = next((crossed[name] for name in (key[2], key[1]) if name in crossed), None)
        if crossing is not None and key not in old:
            signal.crossings |= {number: crossing for number in numbers if number >= 0}
            continue
        if key in old:
            signal.was[index] = old[key]
        if crossing is None:
            straight = link.get("dir", "").lower() == _STRAIGHT
            signal.drives.append(VehicleLink(link=index, start=key[1], end=key[2], straight=straight))
    return dict(found)


def padded(states: Sequence[str], durations_s: Sequence[float], links: SignalLinks) -> tuple[str, ...]:
    """The states of a program, in their order, with a letter for each new crossing.

    A crossing is green while no vehicle may drive over it, except those that turn into its street and have to yield;
    it turns red in time: while lights change before it must be red.
    """
    moved = [_moved(state, links) for state in states]
    free = [{link: _free(state, edges, links.drives) for link, edges in links.crossings.items()} for state in moved]
    changing = [_changes(state, duration_s) for state, duration_s in zip(states, durations_s, strict=True)]
    made = []
    for number, letters in enumerate(moved):
        then = free[_settled(changing, number)]
        green = {link for link, is_free in free[number].items() if is_free and then[link]}
        made.append("".join(_with_yields(_with_crossings(letters, green, links), links)))
    return tuple(made)


def shut(states: Sequence[str], links: SignalLinks) -> tuple[str, ...]:
    """The states of a program, in their order, with each new crossing at red, and nobody else's letter changed.

    So it is for a NEMA controller: it shows a state of each ring at once, and none of them alone tells who drives.
    """
    return tuple("".join(_with_crossings(_moved(state, links), frozenset(), links)) for state in states)


def _settled(changing: Sequence[bool], number: int) -> int:
    """The first state from `number` on in which lights do not change; the last one before it where all do."""
    later = number
    while changing[later] and (later + 1) % len(changing) != number:
        later = (later + 1) % len(changing)
    return later


def _with_crossings(letters: list[str], green: Set[int], links: SignalLinks) -> list[str]:
    """A state with the light of each crossing; off where it is off for all vehicles."""
    lit = list(letters)
    for link in links.crossings:
        lit[link] = "G" if link in green else "r"
        if all(lit[drive.link] in _OFF for drive in links.drives):
            lit[link] = "o"
    return lit


def _with_yields(letters: list[str], links: SignalLinks) -> list[str]:
    """A state in which vehicles that turn into a street with a green crossing have to yield."""
    lit = list(letters)
    for drive in links.drives:
        crossed = (edges for link, edges in links.crossings.items() if lit[link] == "G")
        if lit[drive.link] == "G" and not drive.straight and any(drive.end in edges for edges in crossed):
            lit[drive.link] = "g"
    return lit


def _moved(state: str, links: SignalLinks) -> list[str]:
    letters = list(state.ljust(links.count, "r"))
    for link, was in links.was.items():
        if was < len(state):
            letters[link] = state[was]
    return letters


def _free(letters: Sequence[str], edges: frozenset[str], drives: Sequence[VehicleLink]) -> bool:
    """Whether nobody with a green or yellow light comes over a crossing who need not yield to walkers."""
    return not any(
        letters[drive.link] not in _RED and (drive.start in edges or (drive.end in edges and drive.straight))
        for drive in drives
    )


def _changes(state: str, duration_s: float) -> bool:
    letters = set(state)
    return bool(letters & _CHANGING) or (not letters & (_GREEN | _OFF) and duration_s < _SHORT_S)


def _key(link: Element, shifts: Mapping[str, int]) -> tuple[str, str, str, int, int]:
    start, end = link.get("from", ""), link.get("to", "")
    lanes = int(link.get("fromLane", "0")) + shifts.get(start, 0), int(link.get("toLane", "0")) + shifts.get(end, 0)
    return link.get("tl", ""), start, end, *lanes

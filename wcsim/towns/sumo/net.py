"""A SUMO net as plain data: lanes with their class and shape, connections, junction outlines."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from wcsim.errors import TownError
from wcsim.towns.sumo.xml_io import is_true, read_root
from wcsim.types import F64

_DEFAULT_LANE_WIDTH_M = 3.2  # SUMO's, for lanes that state none
WIDEST_M = 60.0  # a wider lane is a slip of the pen
_NUMBERS = (
    "shape",
    "outlineShape",
    "customShape",
    "x",
    "y",
    "z",
    "length",
    "width",
    "speed",
    "friction",
    "radius",
)
_SINGLE = ("x", "y")
_NO_Z = np.zeros(1)
_WALKERS = {"pedestrian", "wheelchair"}
_RIDERS = {"bicycle", "scooter"}
_RAILS = {"rail", "tram", "rail_urban", "rail_electric", "rail_fast", "subway", "cable_car", "ship"}


class LaneKind(Enum):
    """What a lane is, for building its ground."""

    MOTOR = "motor"
    RAIL = "rail"
    BIKE = "bike"
    SHARED = "shared"  # walkers and riders together
    SIDEWALK = "sidewalk"
    CROSSING = "crossing"
    WALKINGAREA = "walkingarea"  # its shape is an outline, not a centre line
    CLOSED = "closed"


WALK_KINDS = frozenset({LaneKind.SIDEWALK, LaneKind.SHARED})


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """One lane of a net."""

    id: str
    edge_id: str
    index: int
    kind: LaneKind
    internal: bool  # inside a junction
    points_m: F64  # (K, 2) net coordinates minus the origin
    z_m: F64  # (K,) height above the net's `z_origin_m`
    width_m: float
    length_m: float
    speed_mps: float
    allow: frozenset[str] | None  # None: every class but those in `disallow`
    disallow: frozenset[str]

    @property
    def is_line(self) -> bool:
        """Whether it has a line: two points at least."""
        return len(self.points_m) > 1

    def permits(self, vclass: str) -> bool:
        """True when a SUMO vehicle class may use this lane."""
        return vclass not in self.disallow and (self.allow is None or vclass in self.allow)


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """One edge of a net with its lanes, right to left."""

    id: str
    function: str  # "" for a street; "internal", "crossing", "walkingarea", ...
    start: str  # junction ids, "" inside a junction
    end: str
    lanes: tuple[Lane, ...]
    crossed: tuple[str, ...]  # the edges that a crossing crosses

    def has(self, *kinds: LaneKind) -> bool:
        """Whether any of its lanes is of these kinds."""
        return any(lane.kind in kinds for lane in self.lanes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Connection:
    """Where a lane leads to."""

    start: str  # edge ids
    end: str
    start_lane: int
    end_lane: int
    tls_id: str
    tls_link: int  # -1 for none
    via: str = ""  # the first lane inside the junction, "" for none
    tls_link2: int = -1  # a second link of the same light, which shows the crossing's far half
    straight: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Junction:
    """The outline of a junction; empty for those that have none."""

    id: str
    kind: str
    outline_m: F64  # (K, 2)
    z_m: F64  # (K,) height above the net's `z_origin_m`


@dataclass(frozen=True, slots=True, kw_only=True)
class Net:
    """A whole net."""

    edges: tuple[Edge, ...]
    connections: tuple[Connection, ...]
    junctions: tuple[_Junction, ...]
    lefthand: bool = False  # traffic keeps to the left
    # Traffic light and state string of each phase that the net holds.
    phases: tuple[tuple[str, str], ...] = ()
    z_origin_m: float = 0.0  # the net's own height of W's z = 0

    @property
    def streets(self) -> list[Edge]:
        """The edges outside of junctions, in file order."""
        return [edge for edge in self.edges if not edge.function]

    @property
    def every_lane(self) -> list[Lane]:
        """All lanes, in file order."""
        return [lane for edge in self.edges for lane in edge.lanes]

    def lanes(self, *kinds: LaneKind) -> list[Lane]:
        """All lanes of these kinds, in file order."""
        return [lane for lane in self.every_lane if lane.kind in kinds]

    def corners_m(self) -> tuple[F64, F64]:
        """The lower left (2,) and the upper right (2,) of all lanes."""
        points_m = np.concatenate([lane.points_m for lane in self.every_lane])
        return points_m.min(axis=0), points_m.max(axis=0)

    def signalled(self) -> set[str]:
        """The edges from which or to which a signal lets anybody pass."""
        return {name for link in self.connections if link.tls_id for name in (link.start, link.end)}

    @property
    def paved_streets(self) -> int:
        """How many streets have a pavement."""
        return sum(edge.has(LaneKind.SIDEWALK) for edge in self.streets)

    @property
    def speeds_mps(self) -> dict[str, float]:
        """The speed limit of each street for cars, by its edge."""
        motor = (
            (e.id, [lane.speed_mps for lane in e.lanes if lane.kind is LaneKind.MOTOR])
            for e in self.edges
        )
        return {edge: max(limits) for edge, limits in motor if limits and not edge.startswith(":")}

    @property
    def slowest_mps(self) -> float | None:
        """The lowest speed limit of the streets for cars, None where there are none."""
        return min(filter(None, self.speeds_mps.values()), default=None)

    def crossing_links(self) -> Iterator[tuple[str, Connection]]:
        """Each crossing that has a signal, by its edge, with each link by which it has it."""
        crossings = {lane.edge_id for lane in self.lanes(LaneKind.CROSSING)}
        for link in self.connections:
            edge = link.end if link.end in crossings else link.start
            if link.tls_id and edge in crossings:
                yield edge, link


def read_net(path: Path, origin_m: tuple[int, int] = (0, 0)) -> Net:
    """Read a .net.xml[.gz]; all points are moved by -origin_m.

    Raises TownError when it is not a net.
    """
    return net_of(read_root(path), str(path), origin_m)


def net_of(root: Element, path: str, origin_m: tuple[int, int] = (0, 0)) -> Net:
    """A net by its root element; messages call its file `path`.

    Raises TownError as `read_net` does.
    """
    if root.tag != "net":
        raise TownError(
            f"{path}: its root element is <{root.tag}>; expected <net>: build it with netconvert"
        )
    try:
        net = Net(
            edges=tuple(_edge(element, origin_m) for element in root.iterfind("edge")),
            connections=tuple(_connection(element) for element in root.iterfind("connection")),
            junctions=tuple(_junction(each, origin_m) for each in root.iterfind("junction")),
            lefthand=is_true(root.get("lefthand", "0")),
            phases=read_phases(root),
        )
    except (KeyError, ValueError) as error:
        scan_numbers(root, path)
        raise TownError(
            f"{path}: is not a usable net ({error!r}); build it again with netconvert"
        ) from None
    if not any(edge.lanes for edge in net.edges):
        raise TownError(
            f"{path}: has no edge with lanes; expected a street net: build it with netconvert"
        )

    # Heights are counted from the middle one of the streets, so that a level town lies at 0.
    streets = [lane.z_m for edge in net.streets for lane in edge.lanes]
    heights_m = np.sort(np.concatenate([_NO_Z, *streets])[1 if streets else 0 :])
    if not heights_m.any():
        return net
    level_m = float(heights_m[len(heights_m) // 2])
    edges = tuple(
        replace(edge, lanes=tuple(replace(lane, z_m=lane.z_m - level_m) for lane in edge.lanes))
        for edge in net.edges
    )
    junctions = tuple(replace(junction, z_m=junction.z_m - level_m) for junction in net.junctions)
    return replace(net, edges=edges, junctions=junctions, z_origin_m=level_m)


def scan_numbers(root: Element, where: str) -> None:
    """Raise TownError that names the first element of a net with a number that is none."""
    for element in root.iter():
        for key in _NUMBERS:
            text = element.get(key)
            if text is None:
                continue
            try:
                for part in [text] if key in _SINGLE else text.replace(",", " ").split():
                    _finite(part)
            except ValueError:
                raise TownError(
                    f"{where}: <{element.tag} id={element.get('id')!r}> has {key}={text[:40]!r}; "
                    "expected numbers: correct it, or build the net again"
                ) from None


def read_phases(root: Element) -> tuple[tuple[str, str], ...]:
    """Traffic light and state string of each phase of a file's <tlLogic> elements."""
    return tuple(
        (logic.get("id", ""), phase.get("state", ""))
        for logic in root.iterfind("tlLogic")
        for phase in logic.iterfind("phase")
    )


def points(text: str, origin_m: tuple[int, int]) -> F64:
    """SUMO's "x,y[,z] x,y[,z] ..." as (K, 2), moved by -origin. Raises ValueError."""
    return _shape(text, origin_m)[0]


def _shape(text: str, origin_m: tuple[int, int]) -> tuple[F64, F64]:
    """A shape's points (K, 2), moved by -origin, and heights (K,), 0 where it states none.

    Raises ValueError.
    """
    rows = [(*part.split(","), "0")[:3] for part in text.split()]
    table = np.array(rows, np.float64).reshape(-1, 3)
    if not np.isfinite(table).all():
        raise ValueError(f"a shape holds a number that is not finite: {text[:60]!r}")
    return table[:, :2] - np.asarray(origin_m, np.float64), table[:, 2]


def _edge(element: Element, origin_m: tuple[int, int]) -> Edge:
    function = element.get("function", "normal")
    return Edge(
        id=element.attrib["id"],
        function="" if function == "normal" else function,
        start=element.get("from", ""),
        end=element.get("to", ""),
        lanes=tuple(
            _lane(child, element, function, origin_m) for child in element.iterfind("lane")
        ),
        crossed=tuple(element.get("crossingEdges", "").split()),
    )


def _lane(element: Element, edge: Element, function: str, origin_m: tuple[int, int]) -> Lane:
    # A lane that allows some classes forbids the rest. SUMO's word "all" stands for every class,
    # and -1 for a width that was not set.
    allow: frozenset[str] | None = None
    allowed, forbidden = element.get("allow", "all"), element.get("disallow", "")
    if forbidden == "all":
        allow = frozenset()
    elif allowed != "all":
        allow = frozenset(allowed.split())
    disallow = frozenset(forbidden.split() if allow is None else ())
    points_m, z_m = _shape(element.attrib["shape"], origin_m)
    width_m = _finite(element.get("width", _DEFAULT_LANE_WIDTH_M))
    return Lane(
        id=element.attrib["id"],
        edge_id=edge.attrib["id"],
        index=int(element.attrib["index"]),
        kind=_lane_kind(function, allow),
        internal=function == "internal",
        points_m=points_m,
        z_m=z_m,
        width_m=width_m if 0.0 < width_m < WIDEST_M else _DEFAULT_LANE_WIDTH_M,
        length_m=_finite(element.get("length", "0")),
        speed_mps=_finite(element.get("speed", "13.89")),
        allow=allow,
        disallow=disallow,
    )


def _finite(text: str | float) -> float:
    """A number. Raises ValueError for another one than a finite one."""
    if math.isfinite(value := float(text)):
        return value
    raise ValueError(f"{text!r} is not finite")


def _lane_kind(function: str, allow: frozenset[str] | None) -> LaneKind:
    """What a lane is, from its edge's function and the classes it allows (None: all but a few).

    >>> _lane_kind("normal", frozenset({"pedestrian", "bicycle"})).value
    'shared'
    """
    if function == "crossing":
        return LaneKind.CROSSING
    if function == "walkingarea":
        return LaneKind.WALKINGAREA
    if allow is None:
        return LaneKind.MOTOR
    if not allow:
        return LaneKind.CLOSED
    if allow <= _WALKERS:
        return LaneKind.SIDEWALK
    if allow <= _RIDERS:
        return LaneKind.BIKE
    if allow <= _WALKERS | _RIDERS:
        return LaneKind.SHARED
    return LaneKind.RAIL if allow <= _RAILS else LaneKind.MOTOR


def _connection(element: Element) -> Connection:
    return Connection(
        start=element.attrib["from"],
        end=element.attrib["to"],
        start_lane=int(element.get("fromLane", "0")),
        end_lane=int(element.get("toLane", "0")),
        tls_id=element.get("tl", ""),
        tls_link=int(element.get("linkIndex", "-1")),
        via=element.get("via", ""),
        tls_link2=int(element.get("linkIndex2", "-1")),
        straight=element.get("dir", "").lower() == "s",
    )


def _junction(element: Element, origin_m: tuple[int, int]) -> _Junction:
    outline_m, z_m = _shape(element.get("shape", ""), origin_m)
    return _Junction(
        id=element.attrib["id"], kind=element.get("type", ""), outline_m=outline_m, z_m=z_m
    )

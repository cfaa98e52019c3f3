"""A scene before it is written: street, traffic and joystick as numbers that can be mirrored."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.joystick import advance_drive, drive_limits_from_chair, shape_joystick
from wcsim.types import F64

SAMPLE_S = 0.1  # of a joystick that is written
_STEP_S = 0.05
_LATE_S = 0.2  # from the stick to the chair that obeys it, as in the test that these scenes are for
RECORDING = "stick.csv"
_Y_OF_SHAPE = re.compile(r"(?<=,)-?[0-9.]+")  # of an edge: no other attribute of it has commas

FORE_M, CASTER_M, AFT_M, HALF_M = 0.8, 0.5, 0.34, 0.31
"""The usual chair: from its drive axle to footplate, casters and rear end; half its width."""

XY = tuple[float, float]
END_M = 50.0
LANE_M = 3.25
KERB_Y_M = -LANE_M
_HOUSE_M = 8.0

_EDGES = (
    '<edge id="WE" from="W" to="E" type="street"/>\n<edge id="EW" from="E" to="W" type="street"/>'
)
_CROSSING = '<crossing node="E" edges="WE EW" priority="true" width="3"/>'
WALKER = (
    '<vType id="walker" vClass="pedestrian" length="0.28" width="0.48" height="1.75" speedDev="0" '
    'maxSpeed="{:.2f}"/>'
)


class Node(NamedTuple):
    """A junction of the net."""

    name: str
    x_m: float
    y_m: float
    z_m: float = 0.0


class _Thing(NamedTuple):
    """What stands somewhere: a polygon of SUMO's or wcsim's types, filled."""

    name: str
    kind: str
    outline_m: tuple[XY, ...]


class Push(NamedTuple):
    """A joystick from a second on, until the next one.

    It is in steps of a quarter, which are actions of every action set: an agent that only follows
    then does exactly what the user requests.
    """

    at_s: float
    right: float
    forward: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """The street of a scene; `types`, `edges` and `crossings` are lines of SUMO's plain XML."""

    nodes: tuple[Node, ...]
    types: str
    edges: str
    crossings: str = ""
    things: tuple[_Thing, ...] = ()
    kerb_height_m: float = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """One scene, with the kerb or the danger on the left, in net coordinates.

    `routes` are lines of XML.
    """

    shows: str
    place: Place
    routes: str = ""
    start_m: XY
    heading_deg: float = 90.0
    ahead_m: float = 30.0  # to the goal: east of the start, beyond what is reached
    stick: tuple[Push, ...]
    duration_s: float
    attention_share: float = 0.0
    lefthand: bool = False


def mirrored(draft: Draft) -> Draft:
    """The same with left and right exchanged: y turned over, and traffic on the other side."""
    place = draft.place
    place = replace(
        place,
        nodes=tuple(node._replace(y_m=-node.y_m) for node in place.nodes),
        edges=_Y_OF_SHAPE.sub(lambda y: _text(-float(y[0])), place.edges),
        things=tuple(
            thing._replace(outline_m=tuple((x, -y) for x, y in thing.outline_m))
            for thing in place.things
        ),
    )
    return replace(
        draft,
        place=place,
        start_m=(draft.start_m[0], -draft.start_m[1]),
        heading_deg=180.0 - draft.heading_deg,
        stick=tuple(push._replace(right=-push.right) for push in draft.stick),
        lefthand=not draft.lefthand,
    )


def predict_path(start_m: XY, heading_deg: float, stick: Sequence[Push], until_s: float) -> F64:
    """Where the stick alone leads a chair of the usual settings, on flat ground, obeyed 0.2 s late.

    Returns:
        (N, 4) time in s, x and y of the drive axle in m, heading counter-clockwise from east in
        rad.
    """
    chair = ChairConfig()
    limits = drive_limits_from_chair(chair)
    x, y, yaw, v, w, a = *start_m, np.deg2rad(90.0 - heading_deg), 0.0, 0.0, 0.0
    rows = []
    for step in range(round(until_s / _STEP_S) + 1):
        time_s = step * _STEP_S
        rows.append((time_s, x, y, yaw))
        push = shape_joystick(*_at(stick, time_s - _LATE_S), chair.deadband, chair.shape_exponent)
        v, w, a = advance_drive(v, w, a, *push, limits, _STEP_S)
        yaw += w * _STEP_S
        x, y = x + v * _STEP_S * float(np.cos(yaw)), y + v * _STEP_S * float(np.sin(yaw))
    return np.array(rows)


def files_of(draft: Draft, name: str, seed: int) -> dict[str, str]:
    """The texts of a scene's folder, by file name."""
    place = draft.place
    nodes = [
        f'<node id="{node.name}" x="{_text(node.x_m)}" y="{_text(node.y_m)}" '
        f'z="{_text(node.z_m)}" type="priority"/>'
        for node in place.nodes
    ]
    # The joystick lasts a little longer than the scene, so that the user does not give up before.
    rows = ["time_s,x,y"]
    for number in range(round(draft.duration_s / SAMPLE_S) + 10):
        right, forward = _at(draft.stick, SAMPLE_S * number)
        rows.append(f"{SAMPLE_S * number:.1f},{_text(right)},{_text(forward)}")
    files = {
        "street.nod.xml": _xml("nodes", "\n".join(nodes)),
        "street.typ.xml": _xml("types", place.types),
        "street.edg.xml": _xml("edges", place.edges),
        "street.rou.xml": _xml("routes", draft.routes),
        "scene.toml": _toml(draft, name, seed),
        RECORDING: "\n".join([*rows, ""]),
    }
    if place.crossings:
        files["street.con.xml"] = _xml("connections", place.crossings)
    if place.things:
        polygons = []
        for thing in place.things:
            shape = " ".join(f"{_text(x)},{_text(y)}" for x, y in thing.outline_m)
            polygons.append(
                f'<poly id="{thing.name}" type="{thing.kind}" fill="1" shape="{shape}"/>'
            )
        files["street.add.xml"] = _xml("additional", "\n".join(polygons))
    return files


class Pavement(NamedTuple):
    """The pavement south of a street that runs east, with the kerb on its northern side."""

    width_m: float

    @property
    def outer_y_m(self) -> float:
        """Its side away from the road."""
        return KERB_Y_M - self.width_m

    def at(self, from_kerb_m: float) -> float:
        """Net coordinate y so far from the kerb."""
        return KERB_Y_M - from_kerb_m

    def types(self) -> str:
        """The street's type."""
        return (
            f'<type id="street" priority="3" numLanes="1" speed="8.33" width="{LANE_M}" '
            f'sidewalkWidth="{self.width_m:.2f}" disallow="pedestrian wheelchair"/>'
        )

    def street(self, *things: _Thing, kerb_height_m: float = 0.12) -> Place:
        """A street that runs east between such pavements; `things` stand beside it."""
        return Place(
            nodes=(Node("W", -END_M, 0.0), Node("E", END_M, 0.0)),
            types=self.types(),
            edges=_EDGES,
            crossings=_CROSSING,
            things=things,
            kerb_height_m=kerb_height_m,
        )

    def row(self, away_m: float = 0.0) -> _Thing:
        """A row of houses along it, so far from it."""
        return house("row", (-45.0, 45.0), self.outer_y_m - away_m)


def house(name: str, x_m: XY, near_y_m: float, kind: str = "building") -> _Thing:
    """A house, or the like, south of `near_y_m`."""
    far_y_m = near_y_m - _HOUSE_M
    west_m, east_m = x_m
    corners = (
        (west_m, far_y_m),
        (east_m, far_y_m),
        (east_m, near_y_m),
        (west_m, near_y_m),
        (west_m, far_y_m),
    )
    return _Thing(name, kind, corners)


def path_types(width_m: float, name: str = "shared", priority: int = 1) -> str:
    """A type of path for walkers and riders together."""
    return (
        f'<type id="{name}" priority="{priority}" numLanes="1" speed="8.33" width="{width_m:.2f}" '
        'allow="pedestrian bicycle scooter"/>'
    )


def _at(stick: Sequence[Push], time_s: float) -> XY:
    started = [push for push in stick if push.at_s <= time_s + 1e-9]
    return (started[-1].right, started[-1].forward) if started else (0.0, 0.0)


def _xml(root: str, lines: str) -> str:
    inside = "".join(f"    {line.strip()}\n" for line in lines.splitlines() if line.strip())
    return f"<{root}>\n{inside}</{root}>\n"


def _toml(draft: Draft, name: str, seed: int) -> str:
    return f"""\
name = {json.dumps(name)}
shows = {json.dumps(draft.shows)}
seed = {seed}
duration_s = {_text(draft.duration_s)}
kerb_height_m = {_text(draft.place.kerb_height_m)}
lefthand = {json.dumps(draft.lefthand)}
attention_share = {_text(draft.attention_share)}

[[seats]]
start_m = [{_text(draft.start_m[0])}, {_text(draft.start_m[1])}]
heading_deg = {_text(draft.heading_deg)}
goal_m = [{_text(draft.start_m[0] + draft.ahead_m)}, {_text(draft.start_m[1])}]
recording = "{RECORDING}"
"""


def _text(value: float) -> str:
    """Millimetres are enough; never a minus before nothing."""
    return f"{round(value, 3) + 0.0:.3f}"

"""What cars and buses do at the side of the street: a door that opens, a corner that is too narrow."""

from __future__ import annotations

import numpy as np

from wcsim.towns.scene_folders.families.draft import FORE_M, XY, Draft, Node, Place, Push, way_of
from wcsim.towns.scene_folders.families.scene_streets import END_M, Pavement, house, row, street

_DOOR_M = 0.9
_STOPS_S, _BRAKE_MPS2 = 0.45, 1.5  # from seeing to braking, with the drive's ramp; and how hard
_ARM_M = 40.0
_CORNER_M = 2.0  # before the middle of the junction, along its way, a bus that turns comes to the line of the pavement


def car_door(rng: np.random.Generator) -> Draft:
    """The door of a parked car opens over the pavement, right in front of the chair."""
    pavement = Pavement(width_m=float(rng.uniform(2.0, 2.8)))
    start_m = (-20.0, pavement.at(float(rng.uniform(0.65, 0.9))))
    stick = (Push(0.4, 0.0, float(rng.choice((0.5, 0.75)))),)
    open_s = float(rng.uniform(4.0, 7.0))
    way = way_of(start_m, 90.0, stick, open_s)
    speed_mps = (way[-1, 1] - way[-3, 1]) / (way[-1, 0] - way[-3, 0])
    room_m = _STOPS_S * speed_mps + 0.5 * speed_mps**2 / _BRAKE_MPS2 + rng.uniform(0.05, 0.45)
    door_m = float(way[-1, 1] + FORE_M + room_m) + END_M
    routes = f"""\
<vType id="car" vClass="passenger" length="4.5" width="1.8" height="1.5" latAlignment="right" minGap="0.5"/>
<vType id="door" vClass="ignoring" length="0.1" width="{_DOOR_M}" height="1.3" latAlignment="left"/>
{_standing("parked", "car", 0.0, 1, "right", (door_m - 3.0, door_m + 2.0))}
{_standing("door", "door", open_s, 0, "left", (door_m - 0.1, door_m))}"""
    return Draft(
        shows="The door of a parked car opens over the pavement in front of a wheelchair.",
        routes=routes,
        place=street(pavement, row(pavement)),
        start_m=start_m,
        goal_m=(45.0, start_m[1]),
        stick=stick,
        duration_s=open_s + 8.0,
    )


def _standing(name: str, kind: str, from_s: float, lane: int, side: str, span_m: XY) -> str:
    """A vehicle that stands at one side of a lane of the street from a second on."""
    return (
        f'<vehicle id="{name}" type="{kind}" depart="{from_s:.1f}" departPos="{span_m[1]:.2f}" departLane="{lane}" '
        f'departSpeed="0" departPosLat="{side}"><route edges="WE"/><stop lane="WE_{lane}" '
        f'startPos="{span_m[0]:.2f}" endPos="{span_m[1]:.2f}" duration="100"/></vehicle>'
    )


def bus_at_corner(rng: np.random.Generator) -> Draft:
    """The chair waits at a corner, and rolls on just when a bus turns round it."""
    pavement = Pavement(width_m=float(rng.uniform(2.2, 3.0)))
    length_m, speed_mps = float(rng.uniform(10.0, 12.0)), float(rng.uniform(4.0, 5.2))
    swept_x_m = _swept_x_m(length_m, pavement.width_m)
    start_m = (swept_x_m - FORE_M - float(rng.uniform(0.4, 1.2)), pavement.at(0.5 * pavement.width_m))
    push_s = float(rng.uniform(1.0, 5.0))
    stick = (Push(push_s, 0.0, float(rng.choice((0.5, 0.75)))),)
    way = way_of(start_m, 90.0, stick, push_s + 10.0)
    enters_s = float(way[int(np.argmax(way[:, 1] + FORE_M > swept_x_m)), 0])
    begin_m = _ARM_M - _CORNER_M - speed_mps * (enters_s - float(rng.uniform(0.6, 1.3)))
    west_m = min(0.0, begin_m - length_m - 5.0) - _ARM_M
    begin_m -= west_m + _ARM_M
    routes = (
        f'<vType id="bus" vClass="bus" length="{length_m:.1f}" width="2.55" height="3.2" speedDev="0" sigma="0" '
        f'maxSpeed="{speed_mps:.2f}"/>\n<vehicle id="bus" type="bus" depart="0" departPos="{begin_m:.2f}" '
        'departSpeed="max"><route edges="WC CS"/></vehicle>'
    )
    return Draft(
        shows="A bus comes from behind and turns round the corner from which a wheelchair rolls onto the crossing.",
        place=_junction(pavement, west_m),
        routes=routes,
        start_m=start_m,
        goal_m=(35.0, start_m[1]),
        stick=stick,
        duration_s=enters_s + 9.0,
    )


def _junction(pavement: Pavement, west_m: float) -> Place:
    """Two streets that cross, with a crossing for walkers over each arm."""
    arms = (("W", west_m, 0.0), ("E", 45.0, 0.0), ("N", 0.0, 45.0), ("S", 0.0, -45.0))
    edges = [
        f'<edge id="{arm}C" from="{arm}" to="C" type="{kind}"/>\n<edge id="C{arm}" from="C" to="{arm}" type="{kind}"/>'
        for (arm, _, _), kind in zip(arms, ("street", "street", "side", "side"), strict=True)
    ]
    crossings = [f'<crossing node="C" edges="{arm}C C{arm}" priority="true" width="4"/>' for arm, _, _ in arms]
    side = pavement.types().replace('"street"', '"side"').replace('priority="3"', 'priority="1"')
    return Place(
        nodes=(*(Node(*arm) for arm in arms), Node("C", 0.0, 0.0)),
        types=f"{pavement.types()}\n{side}",
        edges="\n".join(edges),
        crossings="\n".join(crossings),
        things=(house("row", (-45.0, -9.0), pavement.outer_y_m),),
    )


def _swept_x_m(length_m: float, width_m: float) -> float:
    """How far west the flank of a bus comes that turns right here, over a corner of pavements so wide: as measured."""
    return -4.67 - 0.38 * (length_m - 10.0) + 0.35 * (width_m - 2.2)

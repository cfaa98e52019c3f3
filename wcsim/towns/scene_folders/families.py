"""Families of scenes that seeds draw, and a scene of one written as a folder.

They show kerbs and walls that the chair drives over or into, bicycles and e-scooters from behind,
cars and buses at the side of the street, and people on a pavement too narrow to step aside.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from wcsim.config.held_out import HELD_OUT
from wcsim.core import seeding
from wcsim.core.files import write_folder_atomically
from wcsim.errors import ConfigError, meant
from wcsim.towns.scene_folders.draft import (
    AFT_M,
    CASTER_M,
    END_M,
    FORE_M,
    HALF_M,
    KERB_Y_M,
    LANE_M,
    WALKER,
    XY,
    Draft,
    Node,
    Pavement,
    Place,
    Push,
    files_of,
    house,
    mirrored,
    path_types,
    predict_path,
)

_ROAD = (
    f'<type id="road" priority="3" numLanes="1" speed="8.33" width="{LANE_M}" '
    'disallow="pedestrian wheelchair"/>'
)
_WALK = '<type id="walk" priority="1" numLanes="1" speed="2.78" width="{:.2f}" allow="pedestrian"/>'
_ROAD_AND_WALK = """\
<edge id="road" from="W" to="E" type="road" spreadType="center"/>
<edge id="walk" from="w" to="e" type="walk" spreadType="center"/>"""
_NEW, _OLD = ("out-of-place",), ("person-turns-round",)  # families
_DECEL_MPS2 = 3.0
_BEND_M, _BEND_MPS = 3.4, 3.0  # of the way through the junction, and how fast SUMO takes it
_KINDS = (("bicycle", 1.8, 0.65, 1.7), ("scooter", 1.2, 0.6, 1.75))
_DOOR_M = 0.9
_TRACK_M = 1.6  # a cycle path's width
_STOPS_S, _BRAKE_MPS2 = 0.45, 1.5  # from seeing to braking, with the drive's ramp; and how hard
_ARM_M = 40.0
# So far before the middle of the junction a bus that turns is on the line of the pavement.
_CORNER_M = 2.0
_STOPS = '<stop lane="WE_0" startPos="{:.2f}" endPos="{:.2f}" duration="6"/><walk edges="WE"/>'
# SUMO puts a person with a stop aside, by 2.4 m, and back into whoever is there by then. This one
# stands without a stop.
_STANDS = '<walk edges="WE" speed="0.01"/>'


def family_of(seed: int) -> str:
    """The family that a training's seed draws.

    >>> family_of(3)
    'turning-beside-drop'
    """
    # Each family draws a lot of its own, so that a new one moves no other.
    return max(TRAINED, key=lambda name: float(seeding.make_rng(seed, "family", name).random()))


def write_scene(family: str, seed: int, folder: Path) -> Path:
    """Write the scene of a family that a seed draws, whole or not at all, as a folder.

    Args:
        family: One of `FAMILIES`.
        seed: 0 or more; the same seed writes the same bytes.
        folder: To make; its parents are made too.

    Returns:
        The folder.

    Raises:
        ConfigError: There is no such family, the seed is negative, or the folder is there already.
        DiskFullError: It cannot be written.
    """
    if family not in FAMILIES:
        known = ", ".join(FAMILIES)
        raise ConfigError(
            f"unknown family of scenes {family!r}; expected one of: {known}"
            f"{meant(family, FAMILIES)}"
        )
    if seed < 0:
        raise ConfigError(f"seed {seed} cannot be used; expected 0 or more")
    if folder.exists():
        raise ConfigError(f"{folder} already exists; choose another name, or remove it first")
    rng = seeding.make_rng(seed, "scene", family)
    flipped = bool(rng.integers(2))
    draft = (_USUAL | _NEARER)[family](rng)
    draft = mirrored(draft) if flipped else draft
    files = files_of(draft, f"{family}-{seed}", seeding.derive_seed(seed, "scene", family))
    with write_folder_atomically(folder, flush=False) as part:
        for name, text in files.items():
            (part / name).write_text(text, encoding="utf-8")
    return folder


def _reversing_off_kerb(rng: np.random.Generator, near: bool = False) -> Draft:
    """The chair stands across the pavement, its back to the road, and is backed up too far."""
    pavement = Pavement(width_m=rng.uniform(2.4, 3.2))
    heading_deg = rng.uniform(145.0, 215.0)
    start_m = (
        rng.uniform(-20.0, 0.0),
        pavement.at(rng.uniform(*((0.3, 0.45) if near else (0.6, 1.1)))),
    )
    begin_s, back_s = rng.uniform(0.4, 1.2), rng.uniform(3.5, 5.0)
    back = -1.0 if near else float(rng.choice((-0.75, -1.0)))
    stick = (
        Push(begin_s, float(rng.choice((-0.25, 0.0, 0.25))), back),
        Push(begin_s + back_s, 0.0, 0.0),
        Push(begin_s + back_s + 0.6, -0.5, 0.25),
        Push(begin_s + back_s + 3.0, 0.0, 0.5),
    )
    return Draft(
        shows=(
            "A wheelchair stands across the pavement, its back to the road, "
            "and its user backs up too far."
        ),
        place=pavement.street(pavement.row(), kerb_height_m=rng.uniform(0.1, 0.15)),
        start_m=start_m,
        heading_deg=heading_deg,
        stick=stick,
        duration_s=begin_s + back_s + 6.0,
    )


def _turning_beside_drop(rng: np.random.Generator, near: bool = False) -> Draft:
    """The chair is turned beside the kerb, over it or, backing up, back over it."""
    pavement = Pavement(width_m=rng.uniform(2.0, 3.0))
    backs_up = bool(rng.integers(2))
    start_m = (
        rng.uniform(-20.0, 0.0),
        pavement.at(rng.uniform(*((0.34, 0.42) if near else (0.5, 0.75)))),
    )
    turns_s = rng.uniform(0.4, 1.0)
    done_s = turns_s + (rng.uniform(3.0, 4.0) if backs_up else rng.uniform(1.2, 1.8))
    right, forward = (0.5, -0.75) if backs_up else (-0.5, float(rng.choice((0.25, 0.5))))
    stick = (
        Push(turns_s, right, forward),
        Push(done_s, 0.0, 0.0),
        Push(done_s + 0.6, -right if backs_up else 0.5, 0.0),
        Push(done_s + 2.0, 0.0, 0.5),
    )
    return Draft(
        shows=(
            "A wheelchair stands along a kerb, and its user turns it there, "
            "forwards or backing up, over the edge."
        ),
        place=pavement.street(pavement.row(rng.uniform(0.0, 3.0))),
        start_m=start_m,
        heading_deg=90.0 + rng.uniform(-6.0, 6.0),
        stick=stick,
        duration_s=done_s + 5.0,
    )


def _twisted_ramp(rng: np.random.Generator, near: bool = False) -> Draft:
    """A pavement climbs and leans towards the road, and the user's hand pulls to that side."""
    pavement = Pavement(width_m=rng.uniform(1.8, 2.4))
    rise, lean = rng.uniform(-0.06, 0.06), rng.uniform(0.04, 0.09)
    start_m = (
        rng.uniform(-15.0, 0.0),
        pavement.at(rng.uniform(*((0.32, 0.42) if near else (0.9, 1.2)))),
    )
    begin_s, forward = 0.6, 1.0 if near else float(rng.choice((0.5, 0.75)))
    pull_s = begin_s + rng.uniform(1.0, 2.5)
    pulls_s = rng.uniform(0.8, 1.2)
    stick = (
        Push(begin_s, 0.0, forward),
        Push(pull_s, -0.5, forward),
        Push(pull_s + pulls_s, 0.0, forward),
        Push(pull_s + pulls_s + 1.2, 0.5, 0.25),
        Push(pull_s + pulls_s + 4.0, 0.0, 0.5),
    )
    climb_m, walk_y_m, road_y_m = (
        2.0 * END_M * rise,
        pavement.at(0.5 * pavement.width_m),
        KERB_Y_M + 0.5 * LANE_M,
    )
    higher_m = lean * (road_y_m - walk_y_m)
    return Draft(
        shows=(
            "A pavement climbs and leans towards the road; "
            "the wheelchair pulls to that side, where the kerb drops."
        ),
        place=Place(
            nodes=(
                Node("W", -END_M, road_y_m),
                Node("E", END_M, road_y_m, climb_m),
                Node("w", -END_M, walk_y_m, higher_m),
                Node("e", END_M, walk_y_m, climb_m + higher_m),
            ),
            types=f"{_ROAD}\n{_WALK.format(pavement.width_m)}",
            edges=_ROAD_AND_WALK,
            things=(pavement.row(rng.uniform(0.0, 2.0)),),
        ),
        start_m=start_m,
        stick=stick,
        duration_s=pull_s + pulls_s + 7.0,
    )


def _footplate_swing(rng: np.random.Generator, near: bool = False) -> Draft:
    """The chair stands along a wall and turns on the spot: its footplate swings into the wall."""
    pavement = Pavement(width_m=rng.uniform(2.6, 3.4))
    wall_y_m = pavement.at(pavement.width_m - rng.uniform(0.2, 0.5))
    start_m = (
        rng.uniform(-20.0, 0.0),
        wall_y_m + rng.uniform(*((0.35, 0.42) if near else (0.45, 0.62))),
    )
    begin_s, turn_s = rng.uniform(0.4, 1.0), rng.uniform(2.0, 3.0)
    turn = float(rng.choice((0.5, 0.75, 1.0)))
    stick = (
        Push(begin_s, turn, 0.0),
        Push(begin_s + turn_s, 0.0, 0.0),
        Push(begin_s + turn_s + 0.8, -0.5, 0.0),
        Push(begin_s + turn_s + 2.2, -0.25, 0.5),
    )
    kind = str(rng.choice(["wcsim.wall", "wcsim.hedge", "building", "wcsim.fence"]))
    near_y_m = wall_y_m if kind != "building" else pavement.outer_y_m
    if kind == "building":
        start_m = (start_m[0], start_m[1] + pavement.outer_y_m - 0.1 - wall_y_m)
    west_m = start_m[0] - rng.uniform(2.0, 8.0)
    return Draft(
        shows="A wheelchair stands close beside a wall, and its user turns towards it on the spot.",
        place=pavement.street(
            house("wall", (west_m, west_m + rng.uniform(10.0, 20.0)), near_y_m, kind)
        ),
        start_m=start_m,
        heading_deg=90.0 + rng.uniform(-4.0, 4.0),
        stick=stick,
        duration_s=begin_s + turn_s + 6.0,
    )


def _rider(
    rng: np.random.Generator, speed_mps: float, align: str, more: str = ""
) -> tuple[str, float, float]:
    """A vType "rider", its length and its width."""
    vclass, length_m, width_m, height_m = _KINDS[int(rng.integers(len(_KINDS)))]
    text = (
        f'<vType id="rider" vClass="{vclass}" length="{length_m}" width="{width_m}" '
        f'height="{height_m}" maxSpeed="{speed_mps:.2f}" speedDev="0" sigma="0" '
        f'latAlignment="{align}"{more}/>'
    )
    return text, length_m, width_m


def _overtaking_rider(rng: np.random.Generator) -> Draft:
    """A rider passes on the left with little room while the chair drifts there."""
    speed_mps = rng.uniform(3.2, 5.0)
    kind, length_m, width_m = _rider(rng, speed_mps, "left")
    width = rng.uniform(3.0, 3.8)
    drift_s = rng.uniform(3.0, 4.5)
    steer, push_s = -0.25, rng.uniform(0.6, 1.0)
    forward = float(rng.choice((0.5, 0.75)))
    stick = (
        Push(0.3, 0.0, forward),
        Push(drift_s, steer, forward),
        Push(drift_s + push_s, 0.0, forward),
        Push(drift_s + 4.0, -steer, forward),
        Push(drift_s + 4.0 + 2.0 * push_s, 0.0, forward),
        Push(drift_s + 8.0, steer, forward),
        Push(drift_s + 8.0 + push_s, 0.0, forward),
    )
    rider_right_m = 0.5 * width - width_m
    room_m = rng.uniform(0.15, 0.35)  # between the two, if the chair kept straight on
    start_m = (0.0, rider_right_m - room_m - HALF_M)
    way = predict_path(start_m, 90.0, stick, drift_s + 4.0)
    left_m = way[:, 2] + HALF_M * np.cos(way[:, 3]) + CASTER_M * np.sin(way[:, 3])
    meets = int(np.argmax(left_m > rider_right_m + 0.04))
    touch_s, touch_m = float(way[meets, 0]), float(way[meets, 1])
    # By then the rider's front is so far along the chair's side.
    along_m = rng.uniform(0.25, 0.6) * (length_m + AFT_M + FORE_M)
    begin_m = touch_m - AFT_M + along_m - speed_mps * touch_s
    west_m = begin_m - length_m - 5.0
    routes = (
        f'{kind}\n<vehicle id="rider" type="rider" depart="0" departPos="{begin_m - west_m:.2f}" '
        'departSpeed="max" departPosLat="left"><route edges="path"/></vehicle>'
    )
    return Draft(
        shows=(
            "A rider passes from behind with little room, "
            "and the wheelchair drifts to that side just then."
        ),
        place=Place(
            nodes=(Node("W", west_m, 0.0), Node("E", END_M, 0.0)),
            types=path_types(width),
            edges='<edge id="path" from="W" to="E" type="shared" spreadType="center"/>',
        ),
        routes=routes,
        start_m=start_m,
        ahead_m=END_M - 5.0,
        stick=stick,
        duration_s=drift_s + 9.0,
    )


def _scooter_cuts_in(rng: np.random.Generator, near: bool = False) -> Draft:
    """A rider passes on a track that ends, cuts in in front of the chair and slows down."""
    speed_mps, slow_mps = rng.uniform(3.2, 4.5), rng.uniform(0.25, 0.5)
    kind, length_m, _ = _rider(rng, speed_mps, "center", f' decel="{_DECEL_MPS2}"')
    width = rng.uniform(1.7, 2.2)
    forward, merge_s = float(rng.choice((0.5, 0.75))), rng.uniform(4.5, 7.5)
    start_m = (0.0, rng.uniform(-0.15, 0.15))
    stick = (Push(0.3, 0.0, forward),)
    front_m = float(predict_path(start_m, 90.0, stick, merge_s)[-1, 1]) + FORE_M
    # There the rider's front is when it has cut in.
    merge_m = front_m + rng.uniform(*((-0.5, 0.0) if near else (0.8, 1.5))) + length_m
    # It brakes for the bend of the junction, and again at its end, to the speed of the path.
    bend_mps = min(speed_mps, _BEND_MPS)
    before_s = (speed_mps - bend_mps) / _DECEL_MPS2
    before_m = 0.5 * (speed_mps + bend_mps) * before_s
    last_s = (bend_mps - slow_mps) / _DECEL_MPS2
    last_m = 0.5 * (bend_mps + slow_mps) * last_s
    cruise_m = max(0.0, _BEND_M - last_m)
    straight_s = merge_s - before_s - last_s - cruise_m / bend_mps
    begin_m = merge_m - (straight_s * speed_mps + before_m + cruise_m + last_m)
    west_m, track_m = min(begin_m, 0.0) - length_m - 5.0, 0.5 * width + 0.6
    bend = f"{west_m:.2f},{track_m:.2f} {merge_m - 3.3:.2f},{track_m:.2f}"
    edges = f"""\
<edge id="path" from="W" to="M" type="shared" spreadType="center"/>
<edge id="track" from="V" to="M" type="track" spreadType="center" shape="{bend}"/>
<edge id="slow" from="M" to="E" type="shared" speed="{slow_mps:.2f}" spreadType="center"/>"""
    routes = (
        f'{kind}\n<vehicle id="rider" type="rider" depart="0" departPos="{begin_m - west_m:.2f}" '
        'departSpeed="max"><route edges="track slow"/></vehicle>'
    )
    return Draft(
        shows="A rider passes, cuts in closely in front of the wheelchair and slows down.",
        place=Place(
            nodes=(
                Node("W", west_m, 0.0),
                Node("V", west_m, track_m),
                Node("M", merge_m + 0.25, 0.0),
                Node("E", merge_m + END_M, 0.0),
            ),
            types=f"{path_types(width)}\n{path_types(1.2, 'track', 3)}",
            edges=edges,
        ),
        routes=routes,
        start_m=start_m,
        ahead_m=merge_m + END_M - 5.0,
        stick=stick,
        duration_s=merge_s + 8.0,
    )


def _dooring(rng: np.random.Generator, near: bool = False) -> Draft:
    """The door of a parked car opens over the pavement, right in front of the chair."""
    pavement = Pavement(width_m=rng.uniform(2.0, 2.8))
    start_m = (-20.0, pavement.at(rng.uniform(0.65, 0.9)))
    stick = (Push(0.4, 0.0, float(rng.choice((0.5, 0.75)))),)
    open_s = rng.uniform(4.0, 7.0)
    way = predict_path(start_m, 90.0, stick, open_s)
    speed_mps = (way[-1, 1] - way[-3, 1]) / (way[-1, 0] - way[-3, 0])
    room_m = (
        _STOPS_S * speed_mps
        + 0.5 * speed_mps**2 / _BRAKE_MPS2
        + rng.uniform(*((0.06, 0.18) if near else (0.05, 0.45)))
    )
    panel_m = float(way[-1, 1] + FORE_M + room_m) + END_M
    car = (
        '<vType id="car" vClass="passenger" length="4.5" width="1.8" height="1.5" '
        'latAlignment="right" minGap="0.5"/>'
    )
    routes = f"""\
{car}
<vType id="door" vClass="ignoring" length="0.1" width="{_DOOR_M}" height="1.3" latAlignment="left"/>
{_standing("parked", "car", 0.0, 1, "right", (panel_m - 3.0, panel_m + 2.0))}
{_standing("door", "door", open_s, 0, "left", (panel_m - 0.1, panel_m))}"""
    return Draft(
        shows="The door of a parked car opens over the pavement in front of a wheelchair.",
        routes=routes,
        place=pavement.street(pavement.row()),
        start_m=start_m,
        ahead_m=65.0,
        stick=stick,
        duration_s=open_s + 8.0,
    )


def _standing(name: str, kind: str, from_s: float, lane: int, side: str, span_m: XY) -> str:
    """A vehicle that stands at one side of a lane of the street from a second on."""
    return (
        f'<vehicle id="{name}" type="{kind}" depart="{from_s:.1f}" departPos="{span_m[1]:.2f}" '
        f'departLane="{lane}" departSpeed="0" departPosLat="{side}"><route edges="WE"/>'
        f'<stop lane="WE_{lane}" startPos="{span_m[0]:.2f}" endPos="{span_m[1]:.2f}" '
        'duration="100"/></vehicle>'
    )


def _bus_at_corner(rng: np.random.Generator) -> Draft:
    """The chair waits at a corner, and rolls on just when a bus turns round it."""
    pavement = Pavement(width_m=rng.uniform(2.2, 3.0))
    length_m, speed_mps = rng.uniform(10.0, 12.0), rng.uniform(4.0, 5.2)
    # So far west the flank of a bus comes that turns right here, as measured.
    swept_x_m = -4.67 - 0.38 * (length_m - 10.0) + 0.35 * (pavement.width_m - 2.2)
    start_m = (swept_x_m - FORE_M - rng.uniform(0.4, 1.2), pavement.at(0.5 * pavement.width_m))
    push_s = rng.uniform(1.0, 5.0)
    stick = (Push(push_s, 0.0, float(rng.choice((0.5, 0.75)))),)
    way = predict_path(start_m, 90.0, stick, push_s + 10.0)
    enters_s = float(way[int(np.argmax(way[:, 1] + FORE_M > swept_x_m)), 0])
    begin_m = _ARM_M - _CORNER_M - speed_mps * (enters_s - rng.uniform(0.6, 1.3))
    west_m = min(0.0, begin_m - length_m - 5.0) - _ARM_M
    begin_m -= west_m + _ARM_M
    routes = (
        f'<vType id="bus" vClass="bus" length="{length_m:.1f}" width="2.55" height="3.2" '
        f'speedDev="0" sigma="0" maxSpeed="{speed_mps:.2f}"/>\n'
        f'<vehicle id="bus" type="bus" depart="0" departPos="{begin_m:.2f}" departSpeed="max">'
        '<route edges="WC CS"/></vehicle>'
    )
    return Draft(
        shows=(
            "A bus comes from behind and turns round the corner from which a wheelchair rolls onto "
            "the crossing."
        ),
        place=_junction(pavement, west_m),
        routes=routes,
        start_m=start_m,
        ahead_m=35.0 - start_m[0],
        stick=stick,
        duration_s=enters_s + 9.0,
    )


def _junction(pavement: Pavement, west_m: float) -> Place:
    """Two streets that cross, with a crossing for walkers over each arm."""
    arms = (("W", west_m, 0.0), ("E", 45.0, 0.0), ("N", 0.0, 45.0), ("S", 0.0, -45.0))
    edges = [
        f'<edge id="{arm}C" from="{arm}" to="C" type="{kind}"/>\n'
        f'<edge id="C{arm}" from="C" to="{arm}" type="{kind}"/>'
        for (arm, _, _), kind in zip(arms, ("street", "street", "side", "side"), strict=True)
    ]
    crossings = [
        f'<crossing node="C" edges="{arm}C C{arm}" priority="true" width="4"/>'
        for arm, _, _ in arms
    ]
    side = pavement.types().replace('"street"', '"side"').replace('priority="3"', 'priority="1"')
    return Place(
        nodes=(*(Node(*arm) for arm in arms), Node("C", 0.0, 0.0)),
        types=f"{pavement.types()}\n{side}",
        edges="\n".join(edges),
        crossings="\n".join(crossings),
        things=(house("row", (-45.0, -9.0), pavement.outer_y_m),),
    )


def _oncoming_pair(rng: np.random.Generator, near: bool = False) -> Draft:
    """Two people abreast come towards the chair, and fill the pavement with it."""
    pavement = Pavement(width_m=rng.uniform(1.7, 2.1))
    start_m = (-20.0, pavement.at(0.5 * pavement.width_m + rng.uniform(-0.1, 0.1)))
    stick = (Push(0.4, 0.0, float(rng.choice((0.5, 0.75)))),)
    pace_mps = rng.uniform(*((1.6, 2.4) if near else (0.9, 1.4)))
    meet_s = rng.uniform(4.0, 7.0)
    meet_m = float(predict_path(start_m, 90.0, stick, meet_s)[-1, 1]) + FORE_M
    begin_m = meet_m + pace_mps * meet_s + END_M
    people = "\n".join(
        f'<person id="{name}" type="walker" depart="0" departPos="{begin_m + back_m:.2f}">'
        f'<walk edges="WE" arrivalPos="2" departPosLat="{left_m}"/></person>'
        for name, back_m, left_m in (("left", 0.0, 0.4), ("right", rng.uniform(0.0, 0.5), -0.4))
    )
    return Draft(
        shows=(
            "Two people walk abreast towards a wheelchair on a pavement that is too narrow for the "
            "three."
        ),
        routes=f"{WALKER.format(pace_mps)}\n{people}",
        place=pavement.street(pavement.row()),
        start_m=start_m,
        ahead_m=65.0,
        stick=stick,
        duration_s=meet_s + 8.0,
        attention_share=1.0,
    )


def _person_turns_round(
    rng: np.random.Generator, near: bool = False, stands: str = _STANDS
) -> Draft:
    """Somebody walks in front of the chair and turns round, or stops dead."""
    pavement = Pavement(width_m=rng.uniform(1.35, 1.6))
    start_m = (-20.0, pavement.at(0.5 * pavement.width_m + rng.uniform(-0.1, 0.1)))
    stick = (Push(0.4, 0.0, 0.75),)
    pace_mps, turn_s = rng.uniform(0.6, 0.9), rng.uniform(4.0, 7.0)
    chair_m = float(predict_path(start_m, 90.0, stick, turn_s)[-1, 1]) + FORE_M
    turn_m = chair_m + rng.uniform(*((0.15, 0.5) if near else (0.5, 0.9))) + END_M
    begin_m = turn_m - 0.95 * pace_mps * turn_s
    stop = stands.format(turn_m - 0.2, turn_m + 0.2)
    after = '<walk edges="WE" arrivalPos="2"/>' if rng.random() < 0.6 else stop
    person = (
        f'<person id="walker" type="walker" depart="0" departPos="{begin_m:.2f}">'
        f'<walk edges="WE" arrivalPos="{turn_m:.2f}"/>{after}</person>'
    )
    return Draft(
        shows=(
            "Somebody walks in front of a wheelchair on a narrow pavement and turns round, "
            "or stops dead."
        ),
        routes=f"{WALKER.format(pace_mps)}\n{person}",
        place=pavement.street(pavement.row()),
        start_m=start_m,
        ahead_m=65.0,
        stick=stick,
        duration_s=turn_s + 8.0,
        attention_share=1.0,
    )


def _out_of_place(rng: np.random.Generator, near: bool = False) -> Draft:
    """The chair is where it does not belong, and its user pushes on."""
    pavement, x_m = Pavement(width_m=rng.uniform(2.0, 3.0)), rng.uniform(-30.0, -10.0)
    back_m = rng.uniform(*((0.95, 1.5) if near else (1.5, 3.0)))
    outer_y_m = pavement.outer_y_m
    grounds = (
        (
            "on the road before a kerb",
            KERB_Y_M + rng.uniform(*((1.0, 1.3) if near else (1.3, 2.6))),
            rng.uniform(120.0, 240.0),
        ),
        (
            "in the gutter",
            KERB_Y_M + rng.uniform(*((0.8, 1.0) if near else (1.0, 1.3))),
            rng.uniform(100.0, 125.0),
        ),
        ("on grass", outer_y_m - back_m, rng.uniform(-40.0, 40.0)),
        ("in a drive", outer_y_m - back_m, rng.uniform(-8.0, 8.0)),
        ("on the road, against a rider", -rng.uniform(1.2, 1.6), 270.0),
        ("on a cycle path, against a rider", KERB_Y_M - 0.5 * _TRACK_M, 270.0),
    )
    number = int(rng.integers(len(grounds)))
    where, y_m, heading_deg = grounds[number]
    houses = [
        house("w", (-45.0, x_m - 1.3), outer_y_m),
        house("e", (x_m + 1.3, 45.0), outer_y_m),
    ]
    beside = houses if where == "in a drive" else []
    place = pavement.street(*beside, kerb_height_m=rng.uniform(0.08, 0.15))
    kind = _rider(rng, rng.uniform(*((5.0, 7.0) if near else (3.2, 5.0))), "center")[0]
    routes = ""
    if number == len(grounds) - 1:
        track = f'bikeLaneWidth="{_TRACK_M}" sidewalkWidth'
        place = replace(place, types=place.types.replace("sidewalkWidth", track))
        kind = kind.replace("scooter", "bicycle")
    if heading_deg == 270.0:
        routes = (
            f'{kind}\n<vehicle id="rider" type="rider" depart="0" departSpeed="max">'
            '<route edges="WE"/></vehicle>'
        )
    return Draft(
        shows=f"A wheelchair is {where}, and its user pushes on.",
        place=place,
        routes=routes,
        start_m=(x_m, y_m),
        heading_deg=heading_deg,
        stick=(Push(rng.uniform(0.4, 1.4), 0.0, float(rng.choice((0.5, 0.75, 1.0)))),),
        duration_s=10.0,
    )


_USUAL = MappingProxyType[str, Callable[..., Draft]](
    {
        "bus-at-corner": _bus_at_corner,
        "car-door": _dooring,
        "footplate-swing": _footplate_swing,
        "oncoming-pair": _oncoming_pair,
        "out-of-place": _out_of_place,
        "overtaking-rider": _overtaking_rider,
        "person-turns-round": partial(_person_turns_round, stands=_STOPS),
        "person-turns-round-2": _person_turns_round,
        "reversing-off-kerb": _reversing_off_kerb,
        "scooter-cuts-in": _scooter_cuts_in,
        "turning-beside-drop": _turning_beside_drop,
        "twisted-ramp": _twisted_ramp,
    }
)
TRAINED = tuple(name for name in _USUAL if name not in (*HELD_OUT["family"], *_OLD))
"""Families of which trainings draw scenes: none that is held out, or that has a newer version."""
# Families of lists of version 2, which have no new ones.
LISTED = tuple(name for name in _USUAL if name not in (*_NEW, *_OLD))
# A nearer danger, or a faster one: ranges of parameters that no training draws.
_NEARER = {f"{name}-near": partial(_USUAL[name], near=True) for name in TRAINED}
FAMILIES: tuple[str, ...] = (*_USUAL, *_NEARER)

"""Kerbs and walls: what the chair itself drives over or into, where nobody else takes part."""

from __future__ import annotations

import numpy as np

from wcsim.towns.scene_folders.families.draft import Draft, Node, Place, Push
from wcsim.towns.scene_folders.families.scene_streets import END_M, KERB_Y_M, LANE_M, Pavement, house, row, street

_AHEAD_M = 30.0  # the destination, beyond what is reached
_ROAD = f'<type id="road" priority="3" numLanes="1" speed="8.33" width="{LANE_M}" disallow="pedestrian wheelchair"/>'
_WALK = '<type id="walk" priority="1" numLanes="1" speed="2.78" width="{:.2f}" allow="pedestrian"/>'
_ROAD_AND_WALK = """\
<edge id="road" from="W" to="E" type="road" spreadType="center"/>
<edge id="walk" from="w" to="e" type="walk" spreadType="center"/>"""


def reversing_off_kerb(rng: np.random.Generator) -> Draft:
    """The chair stands across the pavement with the road behind it, and the user backs up too far."""
    pavement = Pavement(width_m=float(rng.uniform(2.4, 3.2)))
    heading_deg = float(rng.uniform(145.0, 215.0))
    start_m = (float(rng.uniform(-20.0, 0.0)), pavement.at(float(rng.uniform(0.6, 1.1))))
    begin_s, back_s = float(rng.uniform(0.4, 1.2)), float(rng.uniform(3.5, 5.0))
    back = float(rng.choice((-0.75, -1.0)))
    stick = (
        Push(begin_s, float(rng.choice((-0.25, 0.0, 0.25))), back),
        Push(begin_s + back_s, 0.0, 0.0),
        Push(begin_s + back_s + 0.6, -0.5, 0.25),
        Push(begin_s + back_s + 3.0, 0.0, 0.5),
    )
    return Draft(
        shows="A wheelchair stands across the pavement, its back to the road, and its user backs up too far.",
        place=street(pavement, row(pavement), kerb_height_m=float(rng.uniform(0.1, 0.15))),
        start_m=start_m,
        heading_deg=heading_deg,
        goal_m=(start_m[0] + _AHEAD_M, start_m[1]),
        stick=stick,
        duration_s=begin_s + back_s + 6.0,
    )


def turning_beside_drop(rng: np.random.Generator) -> Draft:
    """The chair stands or drives along the kerb, and the user turns it there: forwards over it, or back over it."""
    pavement = Pavement(width_m=float(rng.uniform(2.0, 3.0)))
    backs_up = bool(rng.integers(2))
    start_m = (float(rng.uniform(-20.0, 0.0)), pavement.at(float(rng.uniform(0.5, 0.75))))
    turns_s = float(rng.uniform(0.4, 1.0))
    done_s = turns_s + (float(rng.uniform(3.0, 4.0)) if backs_up else float(rng.uniform(1.2, 1.8)))
    right, forward = (0.5, -0.75) if backs_up else (-0.5, float(rng.choice((0.25, 0.5))))
    stick = (
        Push(turns_s, right, forward),
        Push(done_s, 0.0, 0.0),
        Push(done_s + 0.6, -right if backs_up else 0.5, 0.0),
        Push(done_s + 2.0, 0.0, 0.5),
    )
    return Draft(
        shows="A wheelchair stands along a kerb, and its user turns it there, forwards or backing up, over the edge.",
        place=street(pavement, row(pavement, float(rng.uniform(0.0, 3.0)))),
        start_m=start_m,
        heading_deg=90.0 + float(rng.uniform(-6.0, 6.0)),
        goal_m=(start_m[0] + _AHEAD_M, start_m[1]),
        stick=stick,
        duration_s=done_s + 5.0,
    )


def twisted_ramp(rng: np.random.Generator) -> Draft:
    """A pavement climbs and leans towards the road, and the user's hand pulls to that side."""
    pavement = Pavement(width_m=float(rng.uniform(1.8, 2.4)))
    rise, lean = float(rng.uniform(-0.06, 0.06)), float(rng.uniform(0.04, 0.09))
    start_m = (float(rng.uniform(-15.0, 0.0)), pavement.at(float(rng.uniform(0.9, 1.2))))
    begin_s, forward = 0.6, float(rng.choice((0.5, 0.75)))
    pull_s = begin_s + float(rng.uniform(1.0, 2.5))
    pulls_s = float(rng.uniform(0.8, 1.2))
    stick = (
        Push(begin_s, 0.0, forward),
        Push(pull_s, -0.5, forward),
        Push(pull_s + pulls_s, 0.0, forward),
        Push(pull_s + pulls_s + 1.2, 0.5, 0.25),
        Push(pull_s + pulls_s + 4.0, 0.0, 0.5),
    )
    climb_m, walk_y_m, road_y_m = 2.0 * END_M * rise, pavement.at(0.5 * pavement.width_m), KERB_Y_M + 0.5 * LANE_M
    higher_m = lean * (road_y_m - walk_y_m)
    return Draft(
        shows="A pavement climbs and leans towards the road; the wheelchair pulls to that side, where the kerb drops.",
        place=Place(
            nodes=(
                Node("W", -END_M, road_y_m),
                Node("E", END_M, road_y_m, climb_m),
                Node("w", -END_M, walk_y_m, higher_m),
                Node("e", END_M, walk_y_m, climb_m + higher_m),
            ),
            types=f"{_ROAD}\n{_WALK.format(pavement.width_m)}",
            edges=_ROAD_AND_WALK,
            things=(row(pavement, float(rng.uniform(0.0, 2.0))),),
        ),
        start_m=start_m,
        goal_m=(start_m[0] + _AHEAD_M, start_m[1]),
        stick=stick,
        duration_s=pull_s + pulls_s + 7.0,
    )


def footplate_swing(rng: np.random.Generator) -> Draft:
    """The chair stands along a wall, and the user turns it on the spot: the footplate swings out into the wall."""
    pavement = Pavement(width_m=float(rng.uniform(2.6, 3.4)))
    wall_y_m = pavement.at(pavement.width_m - float(rng.uniform(0.2, 0.5)))
    start_m = (float(rng.uniform(-20.0, 0.0)), wall_y_m + float(rng.uniform(0.45, 0.62)))
    begin_s, turn_s = float(rng.uniform(0.4, 1.0)), float(rng.uniform(2.0, 3.0))
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
    west_m = start_m[0] - float(rng.uniform(2.0, 8.0))
    return Draft(
        shows="A wheelchair stands close beside a wall, and its user turns towards it on the spot.",
        place=street(pavement, house("wall", (west_m, west_m + float(rng.uniform(10.0, 20.0))), near_y_m, kind)),
        start_m=start_m,
        heading_deg=90.0 + float(rng.uniform(-4.0, 4.0)),
        goal_m=(start_m[0] + _AHEAD_M, start_m[1]),
        stick=stick,
        duration_s=begin_s + turn_s + 6.0,
    )

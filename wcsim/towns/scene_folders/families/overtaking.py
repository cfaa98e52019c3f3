"""Bicycles and e-scooters that come up from behind, where the chair's camera does not look."""

from __future__ import annotations

import numpy as np

from wcsim.towns.scene_folders.families.draft import (
    AFT_M,
    CASTER_M,
    FORE_M,
    HALF_M,
    Draft,
    Node,
    Place,
    Push,
    way_of,
)
from wcsim.towns.scene_folders.families.scene_streets import END_M, path_types

_DECEL_MPS2 = 3.0
_BEND_M, _BEND_MPS = 3.4, 3.0  # of the way through the junction, and how fast SUMO takes it
_KINDS = (("bicycle", 1.8, 0.65, 1.7), ("scooter", 1.2, 0.6, 1.75))


def _rider(rng: np.random.Generator, speed_mps: float, align: str, more: str = "") -> tuple[str, float, float]:
    """A vType "rider", its length and its width."""
    vclass, length_m, width_m, height_m = _KINDS[int(rng.integers(len(_KINDS)))]
    text = (
        f'<vType id="rider" vClass="{vclass}" length="{length_m}" width="{width_m}" height="{height_m}" '
        f'maxSpeed="{speed_mps:.2f}" speedDev="0" sigma="0" latAlignment="{align}"{more}/>'
    )
    return text, length_m, width_m


def overtaking_rider(rng: np.random.Generator) -> Draft:
    """A rider passes on the left with little room while the chair drifts there."""
    speed_mps = float(rng.uniform(3.2, 5.0))
    kind, length_m, width_m = _rider(rng, speed_mps, "left")
    width = float(rng.uniform(3.0, 3.8))
    drift_s = float(rng.uniform(3.0, 4.5))
    steer, push_s = -0.25, float(rng.uniform(0.6, 1.0))
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
    room_m = float(rng.uniform(0.15, 0.35))  # between the two, if the chair kept straight on
    start_m = (0.0, rider_right_m - room_m - HALF_M)
    way = way_of(start_m, 90.0, stick, drift_s + 4.0)
    left_m = way[:, 2] + HALF_M * np.cos(way[:, 3]) + CASTER_M * np.sin(way[:, 3])
    meets = int(np.argmax(left_m > rider_right_m + 0.04))
    touch_s, touch_m = float(way[meets, 0]), float(way[meets, 1])
    # by then the rider's front has come so far along the chair's side
    begin_m = touch_m - AFT_M + float(rng.uniform(0.25, 0.6)) * (length_m + AFT_M + FORE_M) - speed_mps * touch_s
    west_m = begin_m - length_m - 5.0
    routes = (
        f'{kind}\n<vehicle id="rider" type="rider" depart="0" departPos="{begin_m - west_m:.2f}" departSpeed="max" '
        'departPosLat="left"><route edges="path"/></vehicle>'
    )
    return Draft(
        shows="A rider passes from behind with little room, and the wheelchair drifts to that side just then.",
        place=Place(
            nodes=(Node("W", west_m, 0.0), Node("E", END_M, 0.0)),
            types=path_types(width),
            edges='<edge id="path" from="W" to="E" type="shared" spreadType="center"/>',
        ),
        routes=routes,
        start_m=start_m,
        goal_m=(END_M - 5.0, start_m[1]),
        stick=stick,
        duration_s=drift_s + 9.0,
    )


def scooter_cuts_in(rng: np.random.Generator) -> Draft:
    """A rider passes on a track beside the path, which ends there: it cuts in in front of the chair and slows down."""
    speed_mps, slow_mps = float(rng.uniform(3.2, 4.5)), float(rng.uniform(0.25, 0.5))
    kind, length_m, _ = _rider(rng, speed_mps, "center", f' decel="{_DECEL_MPS2}"')
    width = float(rng.uniform(1.7, 2.2))
    forward, merge_s = float(rng.choice((0.5, 0.75))), float(rng.uniform(4.5, 7.5))
    start_m = (0.0, float(rng.uniform(-0.15, 0.15)))
    stick = (Push(0.3, 0.0, forward),)
    front_m = float(way_of(start_m, 90.0, stick, merge_s)[-1, 1]) + FORE_M
    merge_m = front_m + float(rng.uniform(0.8, 1.5)) + length_m  # where the rider's front is when it has cut in
    begin_m = merge_m - _cut_in_m(speed_mps, slow_mps, merge_s)
    west_m, track_m = min(begin_m, 0.0) - length_m - 5.0, 0.5 * width + 0.6
    bend = f"{west_m:.2f},{track_m:.2f} {merge_m - 3.3:.2f},{track_m:.2f}"
    edges = f"""\
<edge id="path" from="W" to="M" type="shared" spreadType="center"/>
<edge id="track" from="V" to="M" type="track" spreadType="center" shape="{bend}"/>
<edge id="slow" from="M" to="E" type="shared" speed="{slow_mps:.2f}" spreadType="center"/>"""
    routes = (
        f'{kind}\n<vehicle id="rider" type="rider" depart="0" departPos="{begin_m - west_m:.2f}" departSpeed="max">'
        '<route edges="track slow"/></vehicle>'
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
        goal_m=(merge_m + END_M - 5.0, start_m[1]),
        stick=stick,
        duration_s=merge_s + 8.0,
    )


def _cut_in_m(speed_mps: float, slow_mps: float, until_s: float) -> float:
    """How far a rider gets who brakes for the bend of the junction in between, and again to `slow_mps` at its end."""
    bend_mps = min(speed_mps, _BEND_MPS)
    before_s = (speed_mps - bend_mps) / _DECEL_MPS2
    before_m = 0.5 * (speed_mps + bend_mps) * before_s
    last_s = (bend_mps - slow_mps) / _DECEL_MPS2
    last_m = 0.5 * (bend_mps + slow_mps) * last_s
    cruise_m = max(0.0, _BEND_M - last_m)
    straight_s = until_s - before_s - last_s - cruise_m / bend_mps
    return straight_s * speed_mps + before_m + cruise_m + last_m

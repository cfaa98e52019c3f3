"""Measures a scene while it runs: how the chairs moved; `scene_others` and `scene_way` see what was around them."""

from __future__ import annotations

import math

import numpy as np

from wcsim.config.scene import SceneFile, SceneSeat
from wcsim.core import frames
from wcsim.scenes.facts import SceneFacts
from wcsim.scenes.others import OthersMeter
from wcsim.scenes.way import WayMeter
from wcsim.types import F64, ClientSnapshot, Outline, Snapshot, Street

STANDS_MPS = 0.05
_SETTLED_S = 0.5  # a chair is put down a little above the ground; what it feels then is not of the scene


class SceneMeter:
    """Adds up what happens in a scene."""

    def __init__(self, first: Snapshot, scene: SceneFile, street: Street, outline: Outline) -> None:
        self._chairs = [_ChairMeter(client, seat) for client, seat in zip(first.clients, scene.seats, strict=True)]
        self._others = OthersMeter(outline)
        self._way = WayMeter(street.grid, street.walk, len(scene.seats), outline)

    def add(self, snapshot: Snapshot, dt_s: float) -> None:
        """One tick."""
        for client, chair in zip(snapshot.clients, self._chairs, strict=True):
            chair.add(client, dt_s)
        self._others.add(snapshot)
        self._way.add(snapshot)

    def facts(self) -> SceneFacts:
        """What it came to."""
        chairs, others, way = self._chairs, self._others, self._way
        return SceneFacts(
            crashed=any(chair.crashed for chair in chairs),
            arrivals=sum(chair.arrived for chair in chairs),
            travelled_m=sum(chair.travelled_m for chair in chairs),
            climb_m=max(chair.climb_m for chair in chairs),
            drop_m=max(chair.drop_m for chair in chairs),
            rolled_back_m=max(chair.rolled_back_m for chair in chairs),
            aside_m=max(chair.aside_m for chair in chairs),
            narrowest_m=way.narrowest_m,
            max_roll_deg=frames.deg(max(chair.roll_rad for chair in chairs)),
            max_pitch_deg=frames.deg(max(chair.pitch_rad for chair in chairs)),
            jolt_mps2=max(chair.jolt_mps2 for chair in chairs),
            standing_s=sum(chair.standing_s for chair in chairs),
            red_starts=way.red_starts,
            green_starts=way.green_starts,
            closest_actor_m=min(others.closest_m.values()),
            closest_vehicle_m=others.closest_m["vehicle"],
            closest_rider_m=others.closest_m["rider"],
            closest_person_m=others.closest_m["person"],
            closest_chair_m=others.closest_m["chair"],
            overtaken=len(others.overtook),
            slowest_mps=others.slowest_mps,
            gave_way=len(others.gave_way),
            went_on=len(others.went_on),
            made_way_m=others.made_way_m,
            actors_seen=len(others.seen),
        )


class _ChairMeter:
    """How one chair moved."""

    def __init__(self, first: ClientSnapshot, wanted: SceneSeat) -> None:
        self.crashed = self.arrived = False
        self.travelled_m = self.climb_m = self.drop_m = self.rolled_back_m = self.aside_m = 0.0
        self.roll_rad = self.pitch_rad = self.jolt_mps2 = self.standing_s = 0.0
        self._with_goal = wanted.goal_m is not None
        self._start_W_m = first.plant.p_WB_m.copy()
        self._ahead_W = _direction(first.plant.yaw_rad, wanted)
        self._backwards_m = self._time_s = 0.0

    def add(self, client: ClientSnapshot, dt_s: float) -> None:
        plant = client.plant
        speed_mps = float(np.hypot(*plant.v_B_mps[:2]))
        rise_m = float(plant.p_WB_m[2] - self._start_W_m[2])
        self._time_s += dt_s
        self.crashed |= client.events.crashed
        self.arrived |= self._with_goal and client.events.arrived
        self.travelled_m += speed_mps * dt_s
        self.standing_s += dt_s * (speed_mps < STANDS_MPS and not self.arrived)
        self.climb_m, self.drop_m = max(self.climb_m, rise_m), max(self.drop_m, -rise_m)
        self._backwards_m = max(0.0, self._backwards_m - float(plant.v_B_mps[0]) * dt_s)
        self.rolled_back_m = max(self.rolled_back_m, self._backwards_m)
        self.roll_rad = max(self.roll_rad, abs(plant.roll_rad))
        self.pitch_rad = max(self.pitch_rad, abs(plant.pitch_rad))
        if self._time_s > _SETTLED_S:
            self.jolt_mps2 = max(self.jolt_mps2, float(np.abs(client.sensors.imu.accel_peak_mps2).max()))
        away_m = plant.p_WB_m[:2] - self._start_W_m[:2]
        self.aside_m = max(self.aside_m, abs(float(self._ahead_W[0] * away_m[1] - self._ahead_W[1] * away_m[0])))


def _direction(yaw_rad: float, wanted: SceneSeat) -> F64:
    """Unit vector (2,) from a seat's start to its goal, or ahead where it has none."""
    way_m = np.subtract(wanted.goal_m or wanted.start_m, wanted.start_m)
    length_m = float(np.hypot(*way_m))
    return way_m / length_m if length_m > 0.1 else np.array([math.cos(yaw_rad), math.sin(yaw_rad)])

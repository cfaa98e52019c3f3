"""A tour: one wheelchair drives over every pavement, walking area and crossing of a town, through its traffic.

It is a test of the ground and of the simulators, not of a driver: where people, poles or walls stop the chair it is put
further on, and no crash ends it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wcsim.bridge.world import World
from wcsim.core import frames
from wcsim.physics.renderer.instances import rotation_of
from wcsim.types import F64, ClassId, Command, Joystick, PlantState

AHEAD_M = 1.2  # where on its line the chair steers to
_FAR_OFF_M = 1.5  # further from its line it is put back
STUCK_S = 3.0
LEVEL_M = 0.03
_SKIP_M = 2.0
# A caster swivels about its stem, and beside a kerb a hand's breadth decides what is below it.
AROUND_M = 0.15 * np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
_SINK_M, _FLOAT_M = 0.06, 0.20  # a chair with a wheel deeper in the ground, or all of them higher, stands on nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class TourReport:
    """What came of a tour."""

    lines: int  # pavements, walking areas and crossings visited
    length_m: float  # of all of them
    driven_m: float
    put_on: int  # times that the chair was put further on
    ticks: int
    on_nothing: int  # ticks in which the chair stood on nothing
    worst_W_m: tuple[float, float, float] | None  # where that was first


class _Tour:
    """The chair's way and what was counted on it."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.chair = world.seats[0].chair
        self.wheels_B_m = np.array([(x, y, 0.0) for x, y in self.chair.spec.stand_m()])
        self.driven_m = 0.0
        self.put_on = self.ticks = self.on_nothing = 0
        self.worst: tuple[float, float, float] | None = None

    def visit(self, line: F64) -> None:
        """Drive along a polyline (K, 2) to its end."""
        arc_m = np.r_[0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]
        done_m, best_m, waited_s, put_m = 0.0, 0.0, 0.0, -_SKIP_M
        while done_m < arc_m[-1] - 0.3:
            plant = self.chair.state()
            near_m, off_m = _nearest(line, arc_m, plant.p_WB_m[:2], done_m)
            if off_m > _FAR_OFF_M or waited_s > STUCK_S:
                done_m = best_m = put_m = self._level_from(line, arc_m, max(done_m, put_m + _SKIP_M))
                waited_s = 0.0
                if done_m < arc_m[-1]:
                    self._put(line, arc_m, done_m)
                continue
            done_m = max(done_m, near_m)
            waited_s = 0.0 if done_m > best_m + 0.1 else waited_s + self.world.config.world.tick_s
            best_m = max(best_m, done_m) if waited_s == 0.0 else best_m
            self._tick(_steer(plant, _at(line, arc_m, done_m + AHEAD_M)))

    def _level_from(self, line: F64, arc_m: F64, at_m: float) -> float:
        """The next place on the line where all wheels stand equally high: a chair put across a kerb would be in it."""
        grid = self.world.street.grid
        while at_m < arc_m[-1]:
            here, ahead = _at(line, arc_m, at_m), _at(line, arc_m, at_m + 0.5)
            yaw_rad = math.atan2(*(ahead - here)[::-1])
            cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
            wheels = here + self.wheels_B_m[:, :2] @ np.array([[cos, sin], [-sin, cos]])
            if float(np.ptp(grid.raised_at(wheels[:, None] + AROUND_M))) < LEVEL_M:
                break
            at_m += 0.25
        return at_m

    def _put(self, line: F64, arc_m: F64, at_m: float) -> None:
        here, ahead = _at(line, arc_m, at_m), _at(line, arc_m, at_m + 0.5)
        if np.allclose(here, ahead):
            here = _at(line, arc_m, at_m - 0.5)
        self.world.put_chair(0, here, math.atan2(*(ahead - here)[::-1]))
        self.put_on += 1
        for _ in range(5):
            self._tick(Joystick(0.0, 0.0))

    def _tick(self, joystick: Joystick) -> None:
        before = self.chair.state()
        self.world.tick((Command(seat=0, tick=self.world.snapshot.tick, joystick=joystick),))
        after = self.chair.state()
        self.ticks += 1
        moved_m = float(np.hypot(*(after.p_WB_m - before.p_WB_m)[:2]))
        self.driven_m += moved_m if moved_m < 1.0 else 0.0
        if not self._stands(after):
            self.on_nothing += 1
            x, y, z = after.p_WB_m.tolist()
            self.worst = self.worst or (x, y, z)

    def _stands(self, plant: PlantState) -> bool:
        """Whether the town has ground under every wheel, and no wheel has sunk into it, nor do all of them float."""
        grid = self.world.street.grid
        wheels_W_m = plant.p_WB_m + self.wheels_B_m @ rotation_of(plant.q_WB).T
        ground_m = grid.height_at(wheels_W_m[:, None, :2] + AROUND_M)  # (wheels, around)
        known = grid.class_at(wheels_W_m) != ClassId.VOID
        above_m = wheels_W_m[:, 2] - ground_m.min(axis=1)
        lifted_m = wheels_W_m[:, 2] - ground_m.max(axis=1)
        return bool(known.all() and above_m.min() > -_SINK_M and lifted_m.min() < _FLOAT_M)


def tour(world: World, lines: tuple[F64, ...], progress: Callable[[int], object]) -> TourReport:
    """Drive the first seat's chair over all lines; `progress` hears of each that is done."""
    trip = _Tour(world)
    for number, line in enumerate(lines):
        trip.visit(line)
        progress(number + 1)
    return TourReport(
        lines=len(lines),
        length_m=float(sum(np.hypot(*np.diff(line, axis=0).T).sum() for line in lines)),
        driven_m=trip.driven_m,
        put_on=trip.put_on,
        ticks=trip.ticks,
        on_nothing=trip.on_nothing,
        worst_W_m=trip.worst,
    )


def _nearest(line: F64, arc_m: F64, here: F64, done_m: float) -> tuple[float, float]:
    """Distance along the line to its point nearest to `here`, not far from what is done, and the distance to it."""
    a, b = line[:-1], line[1:]
    way = b - a
    length2 = np.maximum((way**2).sum(-1), 1e-12)
    share = np.clip(((here - a) * way).sum(-1) / length2, 0.0, 1.0)
    off_m = np.hypot(*(a + share[:, None] * way - here).T)
    at_m = arc_m[:-1] + share * np.sqrt(length2)
    off_m = np.where((at_m < done_m - 1.0) | (at_m > done_m + 3.0), np.inf, off_m)
    best = int(off_m.argmin())
    return float(at_m[best]), float(off_m[best])


def _at(line: F64, arc_m: F64, at_m: float) -> F64:
    return np.array([np.interp(at_m, arc_m, line[:, axis]) for axis in (0, 1)])


def _steer(plant: PlantState, target: F64) -> Joystick:
    """Full ahead towards a point, slower the more it lies aside."""
    dx, dy = (target - plant.p_WB_m[:2]).tolist()
    turn_rad = frames.wrap(math.atan2(dy, dx) - plant.yaw_rad)
    return Joystick(float(np.clip(-1.5 * turn_rad, -1.0, 1.0)), float(np.clip(math.cos(turn_rad), 0.0, 1.0)) ** 3)

"""`python -m benchmarks rolling`: chairs in the engine, beside what each would have done rolling without it."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from wcsim.cli.shared.common import Bounds, OutFile, Repeated, split_nonempty_list, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.config import resolve
from wcsim.core.frames import matrix_from_quaternion, rotate_vector, rpy_from_matrix
from wcsim.towns.scenario.town import find_town
from wcsim.types import Command, SeatSpec

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.bridge.ego.ego import Ego
    from wcsim.physics.wheelchair.rolling import RolledTick

ERRORS = ("ahead_mm", "aside_mm", "up_mm", "yaw_mrad", "pitch_mrad", "wheels_mmps")
PEAKS = ("peak_ahead", "peak_aside", "peak_up")
"""In m/s2, of the accelerometer's low-passed signal."""


@dataclass
class RollingOptions:
    """One tick of a chair that rolls without the engine, beside the same tick of that chair in it."""

    towns: str = "helsinki,manhattan"
    """Where: each a town's name, its folder, or a .sumocfg file; separated by commas."""
    plants: str = "rwd,mwd,whill"
    """Chairs (plants), separated by commas."""
    chairs: int = 8
    """Wheelchairs in each street, all driven by simulated users."""
    km: float = 1.0
    """Way of all chairs together, for each town and plant."""
    seed: int = 7
    """Random seed of the worlds."""
    set: Repeated = ()
    """section.key=value, over preset `quick`. (repeatable)"""
    json: OutFile = None
    """Write the result to this file."""


def run(options: RollingOptions) -> int:
    """Drive, print, write; 1 when a chair touched anything in a tick in which it would have rolled."""
    from wcsim.bridge.world import World
    from wcsim.bridge.world_rollout import rollout

    Bounds(0.001, 1000.0).check("--km", options.km)

    class Shadow(World):
        """A world that notes, before it drives, what each chair would do without the engine."""

        guesses: dict[int, tuple[RolledTick, Any]]

        def _drive(self, commands: Sequence[Command]) -> None:
            planes, steps = self._find_planes(), round(self.config.world.tick_s / self._open.engine.step_s)
            self.guesses = {}
            for seat, command in zip(self.seats, commands, strict=True):
                if seat.index in planes:
                    seat.chair.command(command.joystick)
                    guess = seat.chair.rolled(planes[seat.index], steps)
                    imu = copy.deepcopy(seat.chair.sensors._sensors["imu"])
                    imu.sample_rows(guess.rows, (0.0, 0.0))
                    self.guesses[seat.index] = guess, imu.end_tick(None)
            super()._drive(commands)

    result = []
    for town in split_nonempty_list("--towns", options.towns):
        for plant in split_nonempty_list("--plants", options.plants):
            own = (f"chair.plant={plant}", "imu.noise=false", "world.draw_threads=1", *options.set)
            specs = (SeatSpec(profile="inattentive"),) * options.chairs
            with Shadow(find_town(town), resolve("quick", own), specs, options.seed) as world:
                way_m, ticks, missed, found = 0.0, 0, 0, []
                while way_m < 1000.0 * options.km:
                    next(rollout(world))
                    ticks += len(world.seats)
                    way_m += sum(abs(float(seat.plant.v_B_mps[0])) * world.config.world.tick_s for seat in world.seats)
                    for seat in world.seats:
                        if seat.index in world.guesses and seat._stands:
                            missed += bool(seat.chair.contacts())
                            found.append(_errors(seat, *world.guesses[seat.index]))
            result.append(_row(town, plant, way_m, ticks, missed, np.array(found)))
    stdout_console().print(_table(result))
    write_json(options.json, {"rows": result})
    return 1 if any(row["missed"] for row in result) else 0


def _errors(seat: Ego, guess: RolledTick, felt: Any) -> list[float]:
    """Those of one tick, in the order of `ERRORS` and `PEAKS`; all zero after a new start."""
    after, rotation = seat.plant, matrix_from_quaternion(guess.motion.q_WB)
    _, pitch_rad, yaw_rad = rpy_from_matrix(rotation)
    off_m = np.subtract(guess.motion.p_W_m, rotate_vector(rotation, *seat.chair.spec.frame_com_m)) - after.p_WB_m
    if np.hypot(*off_m[:2]) > 1.0:
        return [0.0] * (len(ERRORS) + len(PEAKS))
    cos, sin = math.cos(after.yaw_rad), math.sin(after.yaw_rad)
    joints, radius_m = guess.motion.joints, seat.chair.spec.wheel.radius_m
    wheels_mps = radius_m * (np.array([joints[0][1], joints[1][1]]) - after.wheel_radps)
    turns_rad = math.remainder(yaw_rad - after.yaw_rad, math.tau), pitch_rad - after.pitch_rad
    metres = off_m[0] * cos + off_m[1] * sin, off_m[1] * cos - off_m[0] * sin, off_m[2]
    peaks_mps2 = felt.accel_peak_mps2 - seat.chair.imu().accel_peak_mps2
    return [*(1000.0 * np.array([*metres, *turns_rad, float(np.abs(wheels_mps).max())])), *peaks_mps2]


def _row(town: str, plant: str, way_m: float, ticks: int, missed: int, found: Any) -> dict[str, Any]:
    rms = np.sqrt((found**2).mean(axis=0)) if len(found) else np.zeros(len(ERRORS) + len(PEAKS))
    p99 = np.quantile(np.abs(found), 0.99, axis=0) if len(found) else rms
    named = {"rms": rms.round(3).tolist(), "p99": p99.round(3).tolist(), "of": [*ERRORS, *PEAKS]}
    share = round(len(found) / max(ticks, 1), 3)
    return {"town": town, "plant": plant, "km": round(0.001 * way_m, 3), "share": share, "missed": missed, **named}


def _table(rows: Sequence[dict[str, Any]]) -> Table:
    out = Table("town", "chair", "km", "rolls", "contacts missed", *(f"{name}: rms, p99" for name in (*ERRORS, *PEAKS)))
    for row in rows:
        errors = (f"{rms:.2f}, {p99:.2f}" for rms, p99 in zip(row["rms"], row["p99"], strict=True))
        out.add_row(row["town"], row["plant"], f"{row['km']:g}", f"{row['share']:.0%}", str(row["missed"]), *errors)
    return out

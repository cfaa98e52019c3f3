"""The oracle: which commands end badly, on the true geometry.

It is for metrics and baselines, never part of an observation. A command is dangerous when holding
it for 0.5 s and then releasing the stick (the chair brakes at its comfortable rate) would touch
something, drop off or bump into a kerb, or tip; others are taken to go on as they do. So is one
that lets the chair run into a person who does otherwise, although the stick is released after a
tick (`rollout.py`). Everything else is free. Where commands reach the chair late, those that still
wait are driven first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.constants import OTHER_LEVEL_M
from wcsim.core.frames import matrix_from_quaternion
from wcsim.core.joystick import drive_limits_from_chair, shape_joysticks
from wcsim.supervisor.rollout import (
    HOLD_S,
    STEP_S,
    ChairShape,
    StreetRasters,
    compute_clearance_m,
    compute_max_prediction_s,
    predict_crash_times,
)
from wcsim.types import (
    F64,
    ActorKind,
    ActorState,
    Ground,
    Joystick,
    Outline,
    PlantState,
    StreetGrid,
    Truth,
    Verdict,
)
from wcsim.types.street import FLAT

# How far a chair with its footprint may get in one roll-out, and how long that may take, at least;
# both are more for a chair that brakes softly.
_REACH_M: Final = 4.0
_ROLL_OUT_S: Final = 2.5
_FASTEST_MPS: Final = 5.0  # of any chair
_FAR_M: Final = 25.5
LABEL_MARGIN_M: Final = 0.065  # that `reassess` keeps of what stands


class CrashOracle:
    """Looks half a second and a braking distance ahead, for one street, chair and action set."""

    def __init__(
        self,
        grid: Ground,
        chair: ChairConfig,
        outline: Outline,
        wheels_m: F64,
        rims_m: F64,
        actions: F64,
        tick_s: float = 0.1,
    ) -> None:
        """Prepare the arrays.

        Args:
            grid: The street from above.
            chair: The limits of the drive.
            outline: The chair seen from above.
            wheels_m: (W, 3) where its wheels stand in B, and their trail behind a swivel: the left
                and right drive wheel, then pairs of casters.
            rims_m: (n, 3) what can meet a step of the ground in B, and the step that it takes.
            actions: (A, 2) joystick positions of the action set.
            tick_s: How long a command lasts.
        """
        self._grid = grid
        self._chair = chair
        self._body = ChairShape(
            hull=np.array([outline.middle_x_m, 0.5 * outline.length_m, 0.5 * outline.width_m]),
            wheels=np.ascontiguousarray(wheels_m, np.float64),
            rims=rims_m * (1.0, 1.0, 100.0),  # the raster has centimetres
        )
        self._commands = shape_joysticks(actions, chair)
        self._limits = drive_limits_from_chair(chair)
        self._tick_s = tick_s
        roll_s = float(compute_max_prediction_s(self._limits))
        self._roll_s = max(_ROLL_OUT_S, roll_s)
        self._reach_m = max(_REACH_M, outline.length_m + chair.v_max_mps * 0.5 * (HOLD_S + roll_s))

    def assess(
        self,
        plant: PlantState,
        joystick: Joystick,
        actors: Iterable[ActorState],
        waiting: Sequence[Joystick] = (),
        known: Iterable[ActorState] | None = None,
        accel_mps2: float = 0.0,
    ) -> Truth:
        """All answers at once, with the stick for the intent and no progress: a seat knows these.

        Args:
            plant: The chair.
            joystick: The user's.
            actors: The others, this chair not among them.
            waiting: Commands that the chair obeys before the next one, one a tick.
            known: Those of the actors with which alone `visible` is answered; None for no such
                answer.
            accel_mps2: What the drive gives now: it fades with the drive's jerk, whatever the
                stick is.
        """
        later_s = len(waiting) * self._tick_s
        others = self._near(plant, actors, later_s)
        verdict, visible = self._verdict(plant, joystick, others, waiting, accel_mps2), None
        if known is not None:
            few = self._near(plant, known, later_s)
            # The known ones are among the others: if they are as many, one roll-out is enough.
            same = few.total == others.total
            visible = verdict if same else self._verdict(plant, joystick, few, waiting, accel_mps2)
        grid = self._grid.around(plant.p_WB_m)
        gap_m = compute_clearance_m(
            _state(plant), self._body.hull, _land(grid), others.boxes, others.people
        )
        return Truth(
            danger=verdict.danger,
            first_s=verdict.first_s,
            clearance_m=min(float(gap_m), _FAR_M),
            visible=visible,
            intent=joystick,
            progress_m=0.0,
        )

    def reassess(
        self,
        plant: PlantState,
        known: Sequence[ActorState],
        ids: Set[str],
        waiting: Sequence[Joystick],
        accel_mps2: float,
        later: Mapping[str, ActorState],
        after_s: float,
    ) -> F64:
        """(A,) when each action would have gone wrong, seconds, as the others did go on.

        A label asks for more than the metric: it keeps LABEL_MARGIN_M of what stands.

        Args:
            plant: Of an earlier tick, as `waiting` and `accel_mps2`, see `assess`.
            known: The actors that counted then.
            ids: Of all that were there then.
            waiting: Commands that wait.
            accel_mps2: Of the drive.
            later: The actors `after_s` later, by their id. Who is new among them, such as a door
                that was opened, counts as if it had come as it goes on.
            after_s: Above 0.
        """
        moved = [
            replace(actor, v_W_mps=(later[actor.id].p_W_m - actor.p_W_m) / after_s)
            if actor.id in later
            else actor
            for actor in known
        ]
        new = [
            replace(actor, p_W_m=actor.p_W_m - after_s * actor.v_W_mps)
            for name, actor in later.items()
            if name not in ids
        ]
        others = self._near(plant, [*moved, *new], len(waiting) * self._tick_s)
        return self._roll_out(plant, self._commands, others, waiting, accel_mps2, LABEL_MARGIN_M)

    def _verdict(
        self,
        plant: PlantState,
        joystick: Joystick,
        others: _Others,
        waiting: Sequence[Joystick],
        accel_mps2: float,
    ) -> Verdict:
        own = shape_joysticks(np.array([[joystick.x, joystick.y]]), self._chair)
        first_s = self._roll_out(
            plant, np.concatenate([self._commands, own]), others, waiting, accel_mps2
        )
        return Verdict(danger=bool(np.isfinite(first_s[-1])), first_s=first_s[:-1])

    def _near(
        self, plant: PlantState, actors: Iterable[ActorState], later_s: float = 0.0
    ) -> _Others:
        """The actors that can meet the chair, or are within `_FAR_M`.

        The roll-out of a command begins `later_s` from now.
        """
        reach_m, meets_s = self._reach_m + later_s * _FASTEST_MPS, self._roll_s + later_s
        x, y, z = plant.p_WB_m.tolist()
        boxes, people = [], []
        for actor in actors:
            ax, ay, az = actor.p_W_m.tolist()
            vx, vy, _ = actor.v_W_mps.tolist()
            length, width, _ = actor.size_lwh_m
            # |vx| + |vy| is never less than the speed: this leaves out no actor that may meet it.
            reach = max(reach_m + meets_s * (abs(vx) + abs(vy)), _FAR_M) + 0.5 * (length + width)
            if not (abs(ax - x) < reach and abs(ay - y) < reach and abs(az - z) < OTHER_LEVEL_M):
                continue
            cos, sin = math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)
            if actor.kind is ActorKind.PEDESTRIAN:
                ahead, left = vx * cos + vy * sin, vy * cos - vx * sin
                people.append(
                    (ax, ay, cos, sin, 0.5 * max(length, width), ahead, left, actor.deflect_m, 0.0)
                )
            else:
                boxes.append((ax, ay, cos, sin, 0.5 * length, 0.5 * width, vx, vy, 0.0))
        return _Others(*(np.array(rows, np.float64).reshape(-1, 9) for rows in (boxes, people)))

    def _roll_out(
        self,
        plant: PlantState,
        commands: F64,
        others: _Others,
        waiting: Sequence[Joystick],
        accel_mps2: float,
        margin_m: float = 0.0,
    ) -> F64:
        grid = self._grid.around(plant.p_WB_m)
        # Where each wheel is, as the chair lies: beside a kerb it may stand on both sides.
        r, wheels = matrix_from_quaternion(plant.q_WB.tolist()), self._body.wheels[:, :2]
        wheels_W_m = plant.p_WB_m + wheels @ np.array([(r[0], r[3], r[6]), (r[1], r[4], r[7])])
        above_m = wheels_W_m[:, 2] - (0.0 if grid.relief is FLAT else grid.relief.at(wheels_W_m))
        return predict_crash_times(
            _state(plant, accel_mps2),
            self._steps(waiting),
            commands,
            self._limits,
            self._body,
            np.rint(100.0 * above_m).astype(np.int64),
            self._reach_m + len(waiting) * self._tick_s * _FASTEST_MPS,
            _land(grid),
            others.boxes,
            others.people,
            self._tick_s,
            margin_m,
        )

    def _steps(self, waiting: Sequence[Joystick]) -> F64:
        """The waiting commands, shaped, one for each step of the roll-out (M, 2)."""
        sticks = shape_joysticks(
            np.array([(stick.x, stick.y) for stick in waiting]).reshape(-1, 2), self._chair
        )
        # A hair against rounding, here and below: each step takes the command of its tick.
        steps = np.arange(math.ceil(len(waiting) * self._tick_s / STEP_S - 1e-6))
        return np.ascontiguousarray(sticks[(steps * STEP_S / self._tick_s + 1e-6).astype(np.intp)])


class _Others(NamedTuple):
    """Those near a chair, as the kernels take them."""

    boxes: F64  # (n, 9) vehicles, see `rollout`
    people: F64  # (m, 9) those who walk, see `walkers`

    @property
    def total(self) -> int:
        """How many they are."""
        return len(self.boxes) + len(self.people)


def _land(grid: StreetGrid) -> StreetRasters:
    return StreetRasters(
        grid.height_cm,
        grid.edge_cm,
        grid.clearance_dm,
        np.array([*grid.origin_W_m, grid.cell_m], np.float64),
    )


def _state(plant: PlantState, accel_mps2: float = 0.0) -> F64:
    x, y, _ = plant.p_WB_m
    return np.array([x, y, plant.yaw_rad, plant.v_B_mps[0], plant.w_B_radps[2], accel_mps2])

"""Long vehicles take bends wide: how far each swings out of its lane, and where it is shown then.

SUMO leads the front of a
vehicle along the middle of its lanes and drags its rear along the same line: a bus of 12 m cuts a
corner by more than a metre. A driver takes such a bend wide, so that the body stays off the
pavement. Here the line itself is moved sideways, by as little as keeps the body over the
carriageway; where it is too narrow for that, by what leaves the least of it outside.

SUMO itself gets no order. Front and rear follow the moved line, so that the body stays one box
which drives along its own heading; the mirror, the cameras, the oracle and the reaction all see it
there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wcsim.bridge.reaction.articulated import piece_lengths
from wcsim.bridge.reaction.swept_path import AHEAD_M, TAIL_M, Roads, Tube, way_ahead
from wcsim.core import frames
from wcsim.core.jit import compile_exact_kernel
from wcsim.core.joystick import move_towards
from wcsim.types import F64, U8, ActorKind, ActorState, ClassId, Ground

STEP_M = 0.5  # places on the line
# Between the offsets that are tried; from place to place they differ by one of these at most.
SIDE_STEP_M = 0.2
MOST_M = 3.0  # the furthest that a line is moved: no further than the next lane
_ALONG_M = 0.5  # the body is looked at in strips of so much, and `SIDE_STEP_M` across
_MARGIN_M = 0.05  # the body is looked at as if it were wider by so much on either side
_SMOOTH_M = 6.0  # the line's direction is that of a chord so far to either side
# Of a square metre, of a metre squared, of a step sideways.
_OFF_COST, _FAR_COST, _STEER_COST = 20.0, 0.02, 0.02
_ROUNDS = 6  # the body turns with its line, so what it covers is reckoned anew so often
LOW = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK, ClassId.PARKING, ClassId.VOID)
_IS_LOW = np.isin(np.arange(256), [int(c) for c in LOW])
_STATES = round(MOST_M / SIDE_STEP_M)

_LONG_M = 7.0  # what is shorter stays off the pavement by itself
_LINE_ERROR_M = 0.1  # between the line laid out ahead and where the body comes to run
_JUMP_M = 2.0  # SUMO has put it elsewhere when it is so much further than its speed leads it
# Of the way it drives that a body is moved sideways at most, where its way has become another one.
ASIDE_SHARE = 0.6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Way:
    """A vehicle's way and how far it swings out along it."""

    tube: Tube
    first_m: float  # of the offsets on the way's line
    offsets_m: F64  # (n,) to the left, in steps of STEP_M
    left: F64  # (n, 2) that direction

    def at_m(self, line_m: F64) -> F64:
        """The offsets at these places of the line."""
        known_m = self.first_m + STEP_M * np.arange(len(self.offsets_m))
        return np.interp(line_m, known_m, self.offsets_m)

    def left_of(self, line_m: F64) -> F64:
        """The directions (n, 2) to the left of these places of the line."""
        known_m = self.first_m + STEP_M * np.arange(len(self.left))
        return np.stack([np.interp(line_m, known_m, self.left[:, k]) for k in (0, 1)], axis=1)

    @property
    def straight(self) -> bool:
        """Whether it stays in the middle of its lanes."""
        return not self.offsets_m.any()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Driven:
    """What is remembered of a vehicle from tick to tick."""

    way: _Way | None
    front_W_m: F64  # (2,) as SUMO has it
    aside_m: tuple[float, float]  # of its front and rear, to the left
    left: F64  # (2, 2) that direction, of each of them
    speed_mps: float  # as SUMO has it
    shown_W_m: F64  # (2,) where it is shown: its middle, or the front of one that bends
    yaw_rad: float = 0.0
    v_W_mps: F64 | None = None  # (2,) of that place; None for one that has just come near


class SwingOut:
    """All long vehicles near a wheelchair."""

    def __init__(self, ground: Ground, tick_s: float) -> None:
        self._ground = ground
        self._tick_s = tick_s
        self._driven: dict[str, _Driven] = {}
        self._lines: dict[str, tuple[Tube, _Way, Tube]] = {}

    def shown(self, actors: Sequence[ActorState], roads: Roads) -> tuple[ActorState, ...]:
        """The actors of now, given at SUMO's own places; long ones beside where they swing out.

        Who has left its lanes (parked, stopped by its plan) stays as far aside as it was.
        """
        driven: dict[str, _Driven] = {}
        found = []
        for actor in actors:
            if actor.size_lwh_m[0] < _LONG_M or actor.kind is ActorKind.TRAM or actor.is_person:
                found.append(actor)
                continue
            now = driven[actor.id] = self._followed(actor, roads)
            if now.aside_m == (0.0, 0.0):
                found.append(actor)
                continue
            ahead = frames.forward_vector(now.yaw_rad, actor.pitch_rad)
            back_m = 0.5 * actor.size_lwh_m[0] * ahead[:2] if _bends(actor) else 0.0
            middle = now.shown_W_m - back_m
            x, y = middle - actor.p_W_m[:2]
            v_W_mps = actor.v_W_mps
            if now.v_W_mps is not None and v_W_mps.any():
                v_W_mps = np.array([*now.v_W_mps, v_W_mps[2]])
            beside = replace(
                actor,
                p_W_m=np.array([*middle, actor.p_W_m[2]]),
                yaw_rad=now.yaw_rad,
                v_W_mps=v_W_mps,
                deflect_m=float(y * math.cos(actor.yaw_rad) - x * math.sin(actor.yaw_rad)),
            )
            found.append(beside)
        self._driven = driven
        self._lines = {name: line for name, line in self._lines.items() if name in driven}
        return tuple(found)

    def led(self, actor: ActorState) -> ActorState:
        """The actor as its driver sees it: a little wider, and as fast as on SUMO's own line."""
        known = self._driven.get(actor.id)
        if known is None or known.v_W_mps is None or known.aside_m == (0.0, 0.0):
            return actor
        length_m, width_m, height_m = actor.size_lwh_m
        return replace(
            actor,
            v_W_mps=known.speed_mps * frames.forward_vector(actor.yaw_rad, actor.pitch_rad),
            size_lwh_m=(length_m, width_m + 2.0 * _LINE_ERROR_M, height_m),
        )

    def line(self, actor: ActorState, tube: Tube) -> Tube:
        """The way of a body that swings out, given the way in the middle of its lanes."""
        known = self._driven.get(actor.id)
        if known is None or known.way is None or known.way.straight:
            return tube
        way, old = known.way, self._lines.get(actor.id)
        if old is not None and old[0] is tube and old[1] is way:
            return old[2]
        shift_m = _shift_m(tube, way.tube)
        if shift_m is None:
            return tube
        at_m = np.arange(float(tube.arc_m[0]), tube.end_m, STEP_M)
        aside_m = way.at_m(at_m - shift_m)
        line_W_m = tube.at(at_m) + aside_m[:, None] * way.left_of(at_m - shift_m)
        moved = tube.moved(at_m, line_W_m, actor.size_lwh_m[0])
        self._lines[actor.id] = tube, way, moved
        return moved

    def _followed(self, actor: ActorState, roads: Roads) -> _Driven:
        """Where a vehicle has come to since the last tick."""
        old = self._driven.get(actor.id)
        length_m = actor.size_lwh_m[0]
        place = actor.p_W_m, actor.yaw_rad, actor.pitch_rad
        front_W_m = frames.front_from_centre(*place, length_m)[:2]
        speed_mps = float(np.linalg.norm(actor.v_W_mps))
        # A vehicle that stands stays where it is shown, to the bit.
        if old is not None and np.array_equal(front_W_m, old.front_W_m):
            return replace(old, speed_mps=speed_mps)
        driven_m = 0.0 if old is None else math.dist(front_W_m, old.front_W_m)
        # After a jump of SUMO what it drove before says nothing of where it is.
        if driven_m > speed_mps * self._tick_s + _JUMP_M:
            old = None
        way, (ahead_m, behind_m), left = self._aside(actor, roads, old)
        # Onto another way by degrees.
        if old is not None:
            ahead_m = move_towards(old.aside_m[0], ahead_m, ASIDE_SHARE * driven_m)
            behind_m = move_towards(old.aside_m[1], behind_m, ASIDE_SHARE * driven_m)
        # Front and rear lie on the moved line.
        flat_m = length_m * math.cos(actor.pitch_rad)
        heading = np.array([math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)])
        shown_W_m = front_W_m + ahead_m * left[0]
        x, y = (shown_W_m - front_W_m + flat_m * heading - behind_m * left[1]).tolist()
        if not _bends(actor):
            shown_W_m = shown_W_m - 0.5 * flat_m / math.hypot(x, y) * np.array([x, y])
        v_W_mps = None if old is None else (shown_W_m - old.shown_W_m) / self._tick_s
        return _Driven(
            way=way,
            front_W_m=front_W_m,
            aside_m=(ahead_m, behind_m),
            left=left,
            speed_mps=speed_mps,
            shown_W_m=shown_W_m,
            yaw_rad=math.atan2(y, x),
            v_W_mps=v_W_mps,
        )

    def _aside(
        self, actor: ActorState, roads: Roads, old: _Driven | None
    ) -> tuple[_Way | None, tuple[float, float], F64]:
        """A vehicle's way, how far aside its front and rear should be, and which ways that is."""
        place = roads.on_lane(actor.id)
        if place is None:
            if old is not None:
                return None, old.aside_m, old.left
            here = np.array([-math.sin(actor.yaw_rad), math.cos(actor.yaw_rad)])
            return None, (0.0, 0.0), np.stack([here, here])
        before = None if old is None else old.way
        tube = way_ahead(actor, place, roads, None if before is None else before.tube)
        line_m = tube.front_m(place)
        way = before
        if way is None or way.tube is not tube:
            way = self._laid_out(actor, tube, line_m, before)
        both_m = np.array([line_m, line_m - actor.size_lwh_m[0]])
        ahead_m, behind_m = way.at_m(both_m).tolist()
        return way, (ahead_m, behind_m), way.left_of(both_m)

    def _laid_out(self, actor: ActorState, tube: Tube, line_m: float, old: _Way | None) -> _Way:
        first_m = line_m - actor.size_lwh_m[0] - TAIL_M
        at_m = np.arange(first_m, min(line_m + AHEAD_M, tube.end_m), STEP_M)
        line_W_m = tube.at(at_m)
        left, held_m = _normals(line_W_m), np.zeros(0)
        shift_m = None if old is None else _shift_m(tube, old.tube)
        # What has been driven stays as it was.
        if old is not None and shift_m is not None:
            driven_m = at_m[at_m <= line_m] - shift_m
            held_m, left[: len(driven_m)] = old.at_m(driven_m), old.left_of(driven_m)
        body_m = max(piece_lengths(actor.kind, actor.size_lwh_m[0])), actor.size_lwh_m[1]
        return _Way(
            tube=tube,
            first_m=first_m,
            offsets_m=_offsets_m(line_W_m, body_m, self._ground, held_m),
            left=left,
        )


def _offsets_m(line_W_m: F64, body_m: tuple[float, float], ground: Ground, held_m: F64) -> F64:
    """How far to the left each place of a line is moved.

    Args:
        line_W_m: (n, 2) the way of the front's middle, in steps of `STEP_M`.
        body_m: Length and width of the longest rigid piece that follows it.
        ground: What it drives on.
        held_m: (k,) offsets of the first k places, which have been driven already.

    Returns:
        (n,) offsets; nothing but zeros where the body covers no pavement.
    """
    found = np.zeros(len(line_W_m))
    found[: len(held_m)] = held_m
    behind = max(1, round(body_m[0] / STEP_M))
    if len(line_W_m) <= behind + 2:
        return found
    wide_m, left = (body_m[0], body_m[1] + 2.0 * _MARGIN_M), _normals(line_W_m)
    # Most ways are wide enough: no line is searched where the middle of the lane will do.
    if not _covered_m2(line_W_m + found[:, None] * left, wide_m, ground).any():
        return found
    best, least = found, np.inf
    for _ in range(_ROUNDS + 1):
        moved = line_W_m + found[:, None] * left
        off_m2 = _covered(_profiles(moved, behind, wide_m, ground, _STATES), wide_m[1])
        now = float(off_m2[:, off_m2.shape[1] // 2].sum())
        # Rounds may swing between two lines: the first that is no better than the best ends them.
        if now >= least - 1e-9:
            break
        best, least = found, now
        if now == 0.0:
            break
        found = _cheapest(off_m2, found, behind // 2, len(held_m))
    return best


def _normals(line_W_m: F64) -> F64:
    """Unit vectors (n, 2) to the left of a line of places (n, 2), `STEP_M` apart, smoothed."""
    reach = min(round(_SMOOTH_M / STEP_M), max(len(line_W_m) - 1, 1))
    at = np.arange(len(line_W_m))
    along = line_W_m[np.minimum(at + reach, at[-1])] - line_W_m[np.maximum(at - reach, 0)]
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _covered_m2(line_W_m: F64, body_m: tuple[float, float], ground: Ground) -> F64:
    """(n - k,) square metres of the body off the carriageway, at its front's places from k on.

    k is the body's own length, in steps.
    """
    behind = max(1, round(body_m[0] / STEP_M))
    return np.asarray(_covered(_profiles(line_W_m, behind, body_m, ground, 0), body_m[1])[:, 0])


def _profiles(
    line_W_m: F64, behind: int, body_m: tuple[float, float], ground: Ground, aside: int
) -> F64:
    """(poses, strips) square metres off the carriageway in each lengthwise strip.

    The strips lie beside the body's middle line. They make up the body's width when it is moved by
    up to `aside` of them to either side.
    """
    front, rear = line_W_m[behind:], line_W_m[:-behind]
    chord = front - rear
    chord /= np.maximum(np.hypot(*chord.T), 1e-9)[:, None]
    middle = front - 0.5 * body_m[0] * chord
    strips = 2 * (aside + _half_strips(body_m[1])) + 1
    found = np.zeros((len(front), strips))
    for row, (x, y), (cos, sin) in zip(found, middle.tolist(), chord.tolist(), strict=True):
        grid = ground.around(np.array((x, y)))
        raster = grid.ground_class, *grid.origin_W_m, grid.cell_m
        _fill(row, *raster, _IS_LOW, x, y, cos, sin, 0.5 * body_m[0])
    return found


@compile_exact_kernel
def _fill(
    row: F64, classes: U8, first_x: float, first_y: float, cell_m: float, is_low: np.ndarray,
    x: float, y: float, cos: float, sin: float, half_m: float,
) -> None:  # fmt: skip
    rows, cols = classes.shape
    count = max(1, math.ceil(2.0 * half_m / _ALONG_M))
    along_m = 2.0 * half_m / count
    middle = len(row) // 2
    for i in range(len(row)):
        aside = (i - middle) * SIDE_STEP_M
        for k in range(count):
            ahead = -half_m + (k + 0.5) * along_m
            col = math.floor((x + ahead * cos - aside * sin - first_x) / cell_m)
            line = math.floor((y + ahead * sin + aside * cos - first_y) / cell_m)
            # Beyond the raster nothing is known to be pavement.
            if 0 <= col < cols and 0 <= line < rows and not is_low[classes[line, col]]:
                row[i] += along_m * SIDE_STEP_M


def _covered(profile: F64, width_m: float) -> F64:
    """(poses, offsets) square metres off the carriageway under a body moved left by each."""
    wide = _half_strips(width_m)
    # Running sums: what a body covers at any offset is a single difference.
    sums = np.concatenate([np.zeros((len(profile), 1)), np.cumsum(profile, axis=1)], axis=1)
    at = np.arange(profile.shape[1] - 2 * wide)
    return np.asarray(sums[:, at + 2 * wide + 1] - sums[:, at])


def _half_strips(width_m: float) -> int:
    """Strips to either side of the middle one that make up a width."""
    return math.ceil(0.5 * (width_m / SIDE_STEP_M - 1.0))


def _cheapest(off_m2: F64, now_m: F64, lag: int, held: int) -> F64:
    """The offsets with the least cost over the whole line.

    Each is at most one step of `SIDE_STEP_M` from the one before. `off_m2` says what the body
    covers when it is moved on from `now_m`; its middle is `lag` places behind its front.
    """
    states = np.arange(-_STATES, _STATES + 1)
    cost = np.tile(_FAR_COST * (states * SIDE_STEP_M) ** 2, (len(now_m), 1))
    first = np.rint(now_m / SIDE_STEP_M).astype(np.int64)
    for pose, covered in enumerate(off_m2):
        place = pose + lag
        at = np.minimum(np.maximum(states - first[place] + _STATES, 0), 2 * _STATES)
        cost[place] += _OFF_COST * covered[at]
    for place in range(held):
        cost[place, states != first[place]] = np.inf
    chosen = (_path(cost, held) - _STATES) * SIDE_STEP_M
    # To the bit what was driven, which need not be a whole number of steps.
    chosen[:held] = now_m[:held]
    return chosen


@compile_exact_kernel
def _path(cost: F64, held: int) -> F64:
    """The cheapest state (n,) in each row of (n, states), the same or one beside the last.

    In the first `held` rows the step is free, where it has to be.
    """
    count, states = cost.shape
    total = cost[0].copy()
    steps = np.zeros((count, states), np.int8)
    for place in range(1, count):
        new = np.empty(states)
        for state in range(states):
            best, step = total[state], 0
            for side in (-1, 1):
                # Strictly cheaper: at a tie the line goes on as it is.
                if 0 <= state + side < states and total[state + side] + _STEER_COST < best:
                    best, step = total[state + side] + _STEER_COST, side
            # What was driven is what it was, however steep.
            if place < held and best == np.inf:
                best = total.min()
            new[state], steps[place, state] = best + cost[place, state], step
        total = new
    chosen = np.zeros(count)
    # At a tie the first, which is the one furthest to the right.
    at = np.argmin(total)
    for place in range(count - 1, -1, -1):
        chosen[place] = at
        at += steps[place, at]
    return chosen


def _shift_m(tube: Tube, other: Tube) -> float | None:
    """How much further on the one line the lanes start; None when they share no lane."""
    for name, (start_m, _) in tube.start_m.items():
        if name in other.start_m:
            return start_m - other.start_m[name][0]
    return None


def _bends(actor: ActorState) -> bool:
    return len(piece_lengths(actor.kind, actor.size_lwh_m[0])) > 1

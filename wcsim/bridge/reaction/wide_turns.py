"""Long vehicles take bends wide: how far each swings out of its lane's middle, and where it is shown then.

SUMO leads the front of a vehicle along the middle of its lanes and drags its rear along the same line: a bus of 12 m
cuts a corner by more than a metre. A driver takes such a bend wide, so that the body stays off the pavement. Here the
line itself is moved sideways, by as little as keeps the body over the carriageway; where it is too narrow for that, by
what leaves the least of it outside.

SUMO itself gets no order. Front and rear follow the moved line, so that the body stays one box which drives along its
own heading; the mirror, the cameras, the oracle and the reaction all see it there.
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
SIDE_STEP_M = 0.2  # offsets that are tried; from one place to the next they differ by one of these at most
MOST_M = 3.0  # the furthest that a line is moved: no further than the next lane
ALONG_M = 0.5  # the body is looked at in strips of so much, and `SIDE_STEP_M` across
MARGIN_M = 0.05  # the body is looked at as if it were wider by so much on either side
SMOOTH_M = 6.0  # the line's direction is that of a chord so far to either side
OFF_COST, FAR_COST, STEER_COST = 20.0, 0.02, 0.02  # of a square metre, of a metre squared, of a step sideways
ROUNDS = 6  # the body turns with its line, so what it covers is reckoned anew so often
LOW = (ClassId.ROAD, ClassId.CROSSWALK, ClassId.RAIL_TRACK, ClassId.PARKING, ClassId.VOID)
_IS_LOW = np.isin(np.arange(256), [int(c) for c in LOW])
_STATES = round(MOST_M / SIDE_STEP_M)


def _normals(line_W_m: F64) -> F64:
    """Unit vectors (n, 2) to the left of a line of places (n, 2) that are `STEP_M` apart, without its kinks."""
    reach = min(round(SMOOTH_M / STEP_M), max(len(line_W_m) - 1, 1))
    at = np.arange(len(line_W_m))
    along = line_W_m[np.minimum(at + reach, at[-1])] - line_W_m[np.maximum(at - reach, 0)]
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


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
    wide_m, left = (body_m[0], body_m[1] + 2.0 * MARGIN_M), _normals(line_W_m)
    # Most ways are wide enough: no line is searched where the middle of the lane will do.
    if not _covered_m2(line_W_m + found[:, None] * left, wide_m, ground).any():
        return found
    best, least = found, np.inf
    for _ in range(ROUNDS + 1):
        moved = line_W_m + found[:, None] * left
        off_m2 = _covered(_profiles(moved, behind, wide_m, ground, _STATES), wide_m[1])
        now = float(off_m2[:, off_m2.shape[1] // 2].sum())
        # Rounds may swing between two lines, so the best one is kept and the first that is no better ends them.
        if now < least - 1e-9:
            best, least = found, now
        else:
            break
        if now == 0.0:
            break
        found = _cheapest(off_m2, found, behind // 2, len(held_m))
    return best


def _covered_m2(line_W_m: F64, body_m: tuple[float, float], ground: Ground) -> F64:
    """(n - k,) how much of the body is off the carriageway, at each place of its front from its own length k on."""
    behind = max(1, round(body_m[0] / STEP_M))
    return np.asarray(_covered(_profiles(line_W_m, behind, body_m, ground, 0), body_m[1])[:, 0])


def _profiles(line_W_m: F64, behind: int, body_m: tuple[float, float], ground: Ground, aside: int) -> F64:
    """(poses, strips) square metres off the carriageway in each lengthwise strip beside the body's middle line.

    The strips make up the body's width when it is moved by up to `aside` of them to either side.
    """
    front, rear = line_W_m[behind:], line_W_m[:-behind]
    chord = front - rear
    chord /= np.maximum(np.hypot(*chord.T), 1e-9)[:, None]
    middle = front - 0.5 * body_m[0] * chord
    strips = 2 * (aside + _half_strips(body_m[1])) + 1
    found = np.zeros((len(front), strips))
    for row, (x, y), (cos, sin) in zip(found, middle.tolist(), chord.tolist(), strict=True):
        grid = ground.around(np.array((x, y)))
        _fill(row, grid.ground_class, *grid.origin_W_m, grid.cell_m, _IS_LOW, x, y, cos, sin, 0.5 * body_m[0])
    return found


@compile_exact_kernel
def _fill(
    row: F64, classes: U8, first_x: float, first_y: float, cell_m: float, is_low: np.ndarray,
    x: float, y: float, cos: float, sin: float, half_m: float,
) -> None:  # fmt: skip
    rows, cols = classes.shape
    count = max(1, math.ceil(2.0 * half_m / ALONG_M))
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
    """(poses, offsets) square metres off the carriageway that the body covers when it is moved to the left by each."""
    wide = _half_strips(width_m)
    # Running sums: what a body covers at any offset is a single difference.
    sums = np.concatenate([np.zeros((len(profile), 1)), np.cumsum(profile, axis=1)], axis=1)
    at = np.arange(profile.shape[1] - 2 * wide)
    return np.asarray(sums[:, at + 2 * wide + 1] - sums[:, at])


def _half_strips(width_m: float) -> int:
    """Strips to either side of the middle one that make up a width."""
    return math.ceil(0.5 * (width_m / SIDE_STEP_M - 1.0))


def _cheapest(off_m2: F64, now_m: F64, lag: int, held: int) -> F64:
    """The offsets with the least cost over the whole line, each one step of `SIDE_STEP_M` at most from the one before.

    `off_m2` says what the body covers when it is moved on from `now_m`; its middle is `lag` places behind its front.
    """
    states = np.arange(-_STATES, _STATES + 1)
    cost = np.tile(FAR_COST * (states * SIDE_STEP_M) ** 2, (len(now_m), 1))
    first = np.rint(now_m / SIDE_STEP_M).astype(np.int64)
    for pose, covered in enumerate(off_m2):
        place = pose + lag
        at = np.minimum(np.maximum(states - first[place] + _STATES, 0), 2 * _STATES)
        cost[place] += OFF_COST * covered[at]
    for place in range(held):
        cost[place, states != first[place]] = np.inf
    chosen = (_path(cost, held) - _STATES) * SIDE_STEP_M
    # To the bit what was driven, which need not be a whole number of steps.
    chosen[:held] = now_m[:held]
    return chosen


@compile_exact_kernel
def _path(cost: F64, held: int) -> F64:
    """The cheapest state (n,) in each row of (n, states), from row to row the same or one beside; free when held."""
    count, states = cost.shape
    total = cost[0].copy()
    came = np.zeros((count, states), np.int8)
    for place in range(1, count):
        new = np.empty(states)
        for state in range(states):
            best, step = total[state], 0
            for side in (-1, 1):
                # Strictly cheaper: at a tie the line goes on as it is.
                if 0 <= state + side < states and total[state + side] + STEER_COST < best:
                    best, step = total[state + side] + STEER_COST, side
            if place < held and best == np.inf:  # what was driven is what it was, however steep
                best = total.min()
            new[state], came[place, state] = best + cost[place, state], step
        total = new
    chosen = np.zeros(count)
    # At a tie the first, which is the one furthest to the right.
    at = np.argmin(total)
    for place in range(count - 1, -1, -1):
        chosen[place] = at
        at += came[place, at]
    return chosen


LONG_M = 7.0  # what is shorter keeps off the pavement by itself
LINE_ERROR_M = 0.1  # between the line laid out ahead and where the body comes to run
JUMP_M = 2.0  # SUMO has put it elsewhere when it is so much further than its speed leads it
ASIDE_SHARE = 0.6  # of the way it drives that a body is moved sideways at most, where its way has become another one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Way:
    """A vehicle's way and how far it swings out along it."""

    tube: Tube
    first_m: float  # of the offsets on the way's line
    offsets_m: F64  # (n,) to the left, in steps of STEP_M
    left: F64  # (n, 2) that direction

    def at_m(self, line_m: F64) -> F64:
        """The offsets at these places of the line."""
        return np.interp(line_m, self.first_m + STEP_M * np.arange(len(self.offsets_m)), self.offsets_m)

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
        """The actors of now, SUMO's own places given; long vehicles beside theirs where they swing out.

        Who has left its lanes (parked, stopped by its plan) stays as far aside as it was.
        """
        driven: dict[str, _Driven] = {}
        found = []
        for actor in actors:
            if actor.size_lwh_m[0] < LONG_M or actor.kind is ActorKind.TRAM or actor.is_person:
                found.append(actor)
                continue
            now = driven[actor.id] = self._followed(actor, roads)
            found.append(actor if now.aside_m == (0.0, 0.0) else _beside(actor, now))
        self._driven = driven
        self._lines = {name: line for name, line in self._lines.items() if name in driven}
        return tuple(found)

    def led(self, actor: ActorState) -> ActorState:
        """The actor as its driver reckons: as fast as SUMO drives it, whose line is shorter, and a little wider."""
        known = self._driven.get(actor.id)
        if known is None or known.v_W_mps is None or known.aside_m == (0.0, 0.0):
            return actor
        length_m, width_m, height_m = actor.size_lwh_m
        return replace(
            actor,
            v_W_mps=known.speed_mps * frames.forward_vector(actor.yaw_rad, actor.pitch_rad),
            size_lwh_m=(length_m, width_m + 2.0 * LINE_ERROR_M, height_m),
        )

    def line(self, actor: ActorState, tube: Tube) -> Tube:
        """The way that a vehicle's body sweeps when it swings out, for one that keeps to the middle of its lanes."""
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
        front_W_m = _front(actor)
        speed_mps = float(np.linalg.norm(actor.v_W_mps))
        # A vehicle that stands stays where it is shown, to the bit.
        if old is not None and np.array_equal(front_W_m, old.front_W_m):
            return replace(old, speed_mps=speed_mps)
        # After a jump of SUMO what it drove before says nothing of where it is.
        if old is not None and math.dist(front_W_m, old.front_W_m) > speed_mps * self._tick_s + JUMP_M:
            old = None
        way, aside_m, left = self._aside(actor, roads, old)
        if old is not None:  # onto another way by degrees
            most_m = ASIDE_SHARE * math.dist(front_W_m, old.front_W_m)
            aside_m = move_towards(old.aside_m[0], aside_m[0], most_m), move_towards(old.aside_m[1], aside_m[1], most_m)
        shown_W_m, yaw_rad = _place(actor, front_W_m, aside_m, left)
        v_W_mps = None if old is None else (shown_W_m - old.shown_W_m) / self._tick_s
        return _Driven(
            way=way,
            front_W_m=front_W_m,
            aside_m=aside_m,
            left=left,
            speed_mps=speed_mps,
            shown_W_m=shown_W_m,
            yaw_rad=yaw_rad,
            v_W_mps=v_W_mps,
        )

    def _aside(
        self, actor: ActorState, roads: Roads, old: _Driven | None
    ) -> tuple[_Way | None, tuple[float, float], F64]:
        """A vehicle's way, how far aside its front and rear should be, and the directions of that."""
        place = roads.on_lane(actor.id)
        if place is None:
            here = np.array([-math.sin(actor.yaw_rad), math.cos(actor.yaw_rad)])
            return (None, (0.0, 0.0), np.stack([here, here])) if old is None else (None, old.aside_m, old.left)
        before = None if old is None else old.way
        tube = way_ahead(actor, place, roads, None if before is None else before.tube)
        line_m = tube.front_m(place)
        known = before is not None and before.tube is tube
        way = before if before is not None and known else self._laid_out(actor, tube, line_m, before)
        both_m = np.array([line_m, line_m - actor.size_lwh_m[0]])
        ahead_m, behind_m = way.at_m(both_m).tolist()
        return way, (ahead_m, behind_m), way.left_of(both_m)

    def _laid_out(self, actor: ActorState, tube: Tube, line_m: float, old: _Way | None) -> _Way:
        first_m = line_m - actor.size_lwh_m[0] - TAIL_M
        at_m = np.arange(first_m, min(line_m + AHEAD_M, tube.end_m), STEP_M)
        line_W_m = tube.at(at_m)
        left, held_m = _normals(line_W_m), np.zeros(0)
        shift_m = None if old is None else _shift_m(tube, old.tube)
        if old is not None and shift_m is not None:  # what has been driven stays as it was
            driven_m = at_m[at_m <= line_m] - shift_m
            held_m, left[: len(driven_m)] = old.at_m(driven_m), old.left_of(driven_m)
        body_m = max(piece_lengths(actor.kind, actor.size_lwh_m[0])), actor.size_lwh_m[1]
        return _Way(
            tube=tube,
            first_m=first_m,
            offsets_m=_offsets_m(line_W_m, body_m, self._ground, held_m),
            left=left,
        )


def _front(actor: ActorState) -> F64:
    length_m = actor.size_lwh_m[0]
    return frames.front_from_centre(actor.p_W_m, actor.yaw_rad, actor.pitch_rad, length_m)[:2]


def _shift_m(tube: Tube, other: Tube) -> float | None:
    """How much further on the one line the lanes begin than on the other; None when they share no lane."""
    for name, (start_m, _) in tube.start_m.items():
        if name in other.start_m:
            return start_m - other.start_m[name][0]
    return None


def _place(actor: ActorState, front_W_m: F64, aside_m: tuple[float, float], left: F64) -> tuple[F64, float]:
    """Where a vehicle is shown (2,), as in `_Driven`, and its yaw."""
    flat_m = actor.size_lwh_m[0] * math.cos(actor.pitch_rad)
    heading = np.array([math.cos(actor.yaw_rad), math.sin(actor.yaw_rad)])
    front = front_W_m + aside_m[0] * left[0]
    x, y = (front - front_W_m + flat_m * heading - aside_m[1] * left[1]).tolist()
    long = math.hypot(x, y)
    bends = len(piece_lengths(actor.kind, actor.size_lwh_m[0])) > 1
    return (front if bends else front - 0.5 * flat_m / long * np.array([x, y])), math.atan2(y, x)


def _beside(actor: ActorState, now: _Driven) -> ActorState:
    """The actor where it is shown."""
    ahead = frames.forward_vector(now.yaw_rad, actor.pitch_rad)
    bends = len(piece_lengths(actor.kind, actor.size_lwh_m[0])) > 1
    middle = now.shown_W_m - (0.5 * actor.size_lwh_m[0] * ahead[:2] if bends else 0.0)
    moved = middle - actor.p_W_m[:2]
    v_W_mps = actor.v_W_mps
    if now.v_W_mps is not None and v_W_mps.any():
        v_W_mps = np.array([*now.v_W_mps, v_W_mps[2]])
    return replace(
        actor,
        p_W_m=np.array([*middle, actor.p_W_m[2]]),
        yaw_rad=now.yaw_rad,
        v_W_mps=v_W_mps,
        deflect_m=float(moved[1] * math.cos(actor.yaw_rad) - moved[0] * math.sin(actor.yaw_rad)),
    )

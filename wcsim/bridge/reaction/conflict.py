"""One driver who looks at one wheelchair.

It asks whether the way ahead touches the chair, where there is room, and how fast it may drive.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from wcsim.bridge.reaction.swept_path import AHEAD_M, STEP_M, Tube
from wcsim.core import frames
from wcsim.core.boxes import boxes_touch
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import F64, I32, ActorState

ROOM_M = 0.6  # free width beside a vehicle's own that lets it pass
_EDGE_M = 0.1  # of it, kept to the lane's edge
_WIDEST_M = 1.0  # more than this is not left beside the wheelchair
_LONGEST_LOOK_S = 3.0  # how far ahead others foresee where a chair will be

STOP_SHORT_M = 2.0  # drivers stop this far before a chair
LAST_GAP_M = 0.5  # an emergency brake may leave only this
# Never nearer sideways; and nearer than the second only when alongside already.
NO_TOUCH_M, SIDE_GAP_M = 0.1, 0.4
# Passing a chair nearer than the first (m), a vehicle is no faster than the second (m/s).
_SLOW_PASS = (0.8, 3.0), (1.4, 8.0)
_LANE_GAP_M = 3.2  # who is this near sideways does not change lanes before a chair
ON_ROAD_M = np.array([NO_TOUCH_M, SIDE_GAP_M, *(gap for gap, _ in _SLOW_PASS), _LANE_GAP_M])
ON_PAVEMENT_M = np.array([0.5 * NO_TOUCH_M, NO_TOUCH_M])
_SLOW_CHAIR_MPS = 2.0  # a chair that is faster, or that moves across, is not passed
_DRIFTING_MPS = 0.3
# Going before a chair that comes across takes this much time to spare, unless it would take a
# harder brake to let it go first.
_SOONER_S = 0.5
_HARD_MPS2 = 6.0
_MOST_SKEW_RAD = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class SweptOverlap:
    """Where a way meets a wheelchair, for each side gap, and the chair's place across the way."""

    at: tuple[int, ...]  # index of the first pose that touches, by gap; -1 where none does
    right_m: float  # the chair's right and left end, left of the vehicle's line
    left_m: float

    def room(self, width_m: float, lane_width_m: float) -> tuple[float, ...]:
        """Places of the vehicle's middle, left of the lane's, where it has room; nearest first.

        >>> SweptOverlap(at=(9,), right_m=-1.6, left_m=-1.0).room(0.6, 3.2)
        (0.3,)
        """
        edge_m = 0.5 * lane_width_m
        places = []
        left_room, right_room = edge_m - self.left_m, self.right_m + edge_m
        if left_room >= width_m + ROOM_M:
            gap_m = min(_WIDEST_M, left_room - width_m - _EDGE_M)
            places.append(self.left_m + gap_m + 0.5 * width_m)
        if right_room >= width_m + ROOM_M:
            gap_m = min(_WIDEST_M, right_room - width_m - _EDGE_M)
            places.append(self.right_m - gap_m - 0.5 * width_m)
        # The sort is stable: of two places equally near the one left of the chair is first.
        return tuple(sorted(places, key=abs))


@dataclass(slots=True, kw_only=True)
class ConflictCheck:
    """One vehicle that looks at one chair. Made for every vehicle near one in every tick."""

    actor: ActorState
    tube: Tube
    front_m: float
    speed_mps: float
    row: F64

    now: int = field(init=False)  # index of the pose that the body has reached
    _here: list[float] = field(init=False)  # that pose
    _stands: bool = field(init=False)  # the chair

    def __post_init__(self) -> None:
        """Find the vehicle on its way."""
        self.now = int((self.front_m - self.tube.first_m) / STEP_M)
        self._here = self._pose(self.now)
        vx, vy = self.row[6:].tolist()
        self._stands = vx == vy == 0.0

    def _pose(self, at: int) -> list[float]:
        at = min(max(at, 0), len(self.tube.poses) - 1)
        return self.tube.poses[at].tolist()  # type: ignore[no-any-return]

    def front_of(self, at: int) -> float:
        """The front bumper's place on the line at a pose."""
        return self.tube.first_m + at * STEP_M

    def distance_m(self, at: int) -> float:
        """How far the vehicle can go before the pose at which it touches."""
        return max(0.0, self.front_of(at - 1) - self.front_m)

    @property
    def skew(self) -> float:
        """Tangent of the angle between body and line: changing lanes, the tail drags behind."""
        _, _, cos, sin = self._here
        turned_rad = self.actor.yaw_rad - math.atan2(sin, cos)
        return math.tan(max(-_MOST_SKEW_RAD, min(_MOST_SKEW_RAD, frames.wrap_angle(turned_rad))))

    def touch(self, left_m: float, gaps_m: F64, straight: bool = False) -> SweptOverlap:
        """Where its way touches the chair, `left_m` left of the middle of its lane."""
        long_m, width_m, _ = self.actor.size_lwh_m
        last = min(len(self.tube.poses), self.now + int(look_m(self.speed_mps, 3.0) / STEP_M) + 2)
        # At least 0.5 m/s: one that stands would never reach the next pose, and the chair could be
        # anywhere by then.
        pace = (self.front_m - self.tube.first_m) / STEP_M, STEP_M / max(self.speed_mps, 0.5)
        body = 0.5 * long_m, 0.5 * width_m, left_m, 0.0 if straight else self.skew
        span = max(0, self.now), last
        careful = _first_touches(self.tube.poses, span, body, gaps_m, self.row, pace, _SOONER_S)
        # With time to spare only while there is room to brake, or nothing to brake for. Who cannot
        # stop may still have left in time.
        at = careful.at[1]
        can_stop = at < 0 or self.speed_mps**2 <= 2.0 * _HARD_MPS2 * self.distance_m(at)
        if self._stands or can_stop:
            return careful
        return _first_touches(self.tube.poses, span, body, gaps_m, self.row, pace)

    def limit(self, touch: SweptOverlap, left_m: float, brake_mps2: float, tick_s: float) -> float:
        """The speed from which it can stop short of the chair, or pass it as its gap allows."""
        # One that is this near already drives on, unless it would touch.
        alongside = touch.at[1] <= self.now + 1
        at = touch.at[0] if alongside else touch.at[1]
        limit_mps = math.inf
        if at >= 0:
            # The chair may move on in front. On one beside it a turning body closes in.
            goes_on_mps = 0.0
            x, y, cos, sin = self._here
            ahead_m = (self.row[0] - x) * cos + (self.row[1] - y) * sin
            if not self._stands and ahead_m >= 0.5 * self.actor.size_lwh_m[0]:
                _, _, cos, sin = self._pose(at)
                goes_on_mps = max(0.0, float(self.row[6] * cos + self.row[7] * sin))
            room_m = self.distance_m(at) - (0.0 if alongside else STOP_SHORT_M)
            limit_mps = approach_mps(room_m, brake_mps2, tick_s, goes_on_mps)
        for (_, pace_mps), at in zip(_SLOW_PASS, touch.at[2:4], strict=False):
            if at >= 0 and self.passable(at):
                slow_mps = approach_mps(self.distance_m(at), brake_mps2, tick_s, pace_mps)
                limit_mps = min(limit_mps, slow_mps)
        return limit_mps

    def passable(self, at: int) -> bool:
        """Whether the chair there stands, or rolls slowly along the way and not across it."""
        if self._stands:
            return True
        vx, vy = self.row[6:].tolist()
        _, _, cos, sin = self._pose(at)
        return bool(
            math.hypot(vx, vy) < _SLOW_CHAIR_MPS and abs(vy * cos - vx * sin) < _DRIFTING_MPS
        )


def look_m(speed_mps: float, brake_mps2: float) -> float:
    """How far ahead a driver at this speed looks for wheelchairs."""
    return min(AHEAD_M, speed_mps**2 / brake_mps2 + 1.4 * speed_mps + STOP_SHORT_M + 8.0)


def approach_mps(room_m: float, brake_mps2: float, tick_s: float, end_mps: float = 0.0) -> float:
    """The speed from which one can brake to `end_mps` within the room, decided anew each tick.

    >>> approach_mps(0.0, 4.5, 0.1)
    0.0
    """
    # A commanded speed is driven for a whole tick before the next look.
    b = brake_mps2 * tick_s
    return max(0.0, math.sqrt(b * b + 2.0 * brake_mps2 * max(0.0, room_m) + end_mps**2) - b)


def _first_touches(
    poses: F64,
    span: tuple[int, int],
    body: tuple[float, float, float, float],
    gaps_m: F64,
    chair: F64,
    pace: tuple[float, float],
    sooner_s: float = 0.0,
) -> SweptOverlap:
    """Where the body first comes nearer to the chair, sideways, than each of the gaps.

    Args:
        poses: (n, 4) x, y, cos, sin of the body's middle along the way.
        span: The poses to look at, first and one past the last.
        body: Half its length and width, how far left of the poses its front runs, and its skew.
            Skew is the tangent of the angle by which it is turned against its pose now, as in a
            change of lanes; its tail comes in line again as it drives on.
        gaps_m: (g,) gaps to either side, rising, at least two; the chair's ends are those seen at
            the second.
        chair: (8,) x, y, cos, sin, half length, half width, velocity x and y.
        pace: Pose index of the body now, and seconds from pose to pose.
        sooner_s: A chair that comes across may be there this much sooner than it seems.
    """
    out = np.empty(len(gaps_m), np.int32)
    # Plain numbers: an array of them costs more than the look.
    low, high = _first_touching_poses(poses, *span, *body, gaps_m, chair, *pace, sooner_s, out)
    return SweptOverlap(at=tuple(out.tolist()), right_m=low, left_m=high)


@compile_exact_kernel
def _touches(
    poses: F64, i: int, left_m: float, skew: float, long: float, wide: float,
    chair: F64, chair_x: float, chair_y: float,
) -> bool:  # fmt: skip
    """Whether the body, so far left of pose i and skewed against it, touches a chair there."""
    line_cos, line_sin = poses[i, 2], poses[i, 3]
    cos, sin = line_cos - skew * line_sin, line_sin + skew * line_cos
    size = math.sqrt(1.0 + skew * skew)
    cos, sin = cos / size, sin / size
    x = poses[i, 0] + long * (line_cos - cos) - line_sin * left_m
    y = poses[i, 1] + long * (line_sin - sin) + line_cos * left_m
    return boxes_touch(
        x, y, cos, sin, long, wide, chair_x, chair_y, chair[2], chair[3], chair[4], chair[5]
    )


@compile_exact_kernel
def _first_touching_poses(
    poses: F64, first: int, last: int, long: float, wide: float, left_m: float, skew: float,
    gaps_m: F64, chair: F64, now: float, pose_s: float, sooner_s: float, out: I32,
) -> tuple[float, float]:  # fmt: skip
    """Fill `out` with the first pose that touches the chair with each gap.

    Chair: x, y, cos, sin, halves, v_x, v_y. long, wide: half the body; now: index of its pose.
    Returns the chair's ends across the way.
    """
    out[:] = -1
    low, high = 0.0, 0.0
    moving = chair[6] ** 2 + chair[7] ** 2 > 0.01
    # A chair that moves may be anywhere on its way by then: four places stand for that way.
    views = 4 if moving else 1
    missing = len(gaps_m)
    reach = long + wide + gaps_m[-1] + chair[4] + chair[5] + abs(left_m) + 2.0 * long * abs(skew)
    if moving:
        reach += _LONGEST_LOOK_S * math.hypot(chair[6], chair[7])
    for i in range(first, last):
        cos, sin = poses[i, 2], poses[i, 3]
        if (poses[i, 0] - chair[0]) ** 2 + (poses[i, 1] - chair[1]) ** 2 > reach * reach:
            continue
        until_s = (
            min(max(0.0, (i - now) * pose_s) + sooner_s, _LONGEST_LOOK_S) if i > first else 0.0
        )
        # What is left of the skew.
        still = skew * math.exp(-0.5 * STEP_M * max(0.0, i - now) / long)
        for view in range(views):
            ahead_s = until_s * view / 3.0
            cx, cy = chair[0] + chair[6] * ahead_s, chair[1] + chair[7] * ahead_s
            # From the widest gap down: a body clear with one is clear with the smaller ones.
            for j in range(len(gaps_m) - 1, -1, -1):
                if out[j] >= 0:
                    continue
                side = wide + gaps_m[j]
                if not _touches(poses, i, left_m, still, long, side, chair, cx, cy):
                    break
                # For a chair that comes across it stops before its body reaches that place at all.
                at = i
                while at > first and moving:
                    if not _touches(poses, at - 1, left_m, still, long, side, chair, cx, cy):
                        break
                    at -= 1
                # Its front has gone by that place: it leaves it free soonest by driving on.
                if at == first and i > first + 1:
                    continue
                out[j] = at
                missing -= 1
                if j == 1:
                    middle = (cy - poses[i, 1]) * cos - (cx - poses[i, 0]) * sin
                    turn = abs(chair[3] * cos - chair[2] * sin)
                    across = chair[4] * turn + chair[5] * abs(chair[2] * cos + chair[3] * sin)
                    low, high = middle - across, middle + across
        if missing == 0:
            break
    return low, high

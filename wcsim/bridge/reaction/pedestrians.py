"""People step aside for a wheelchair: an offset beside SUMO's pose, because SUMO itself does not know the chair.

The offset is a vector in W, so that it stays continuous when a person turns; it moves by at most 0.8 m/s, only onto
walkable ground that is clear of solid things and of others, and goes back to nothing after the person has passed. Who
cannot pass stops short, and people near a chair keep clear of those who stepped aside, of whom SUMO knows nothing
either: who is nearer to the chair goes first, the others make room.

Where a person finds a way past what stands in front of it: plain geometry in the person's own frame.

Where a person can stand and walk: small looks at the street's raster, many of them in every tick.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from wcsim.bridge.reaction.attention import Attention
from wcsim.bridge.reaction.commands import CHAIR, LET_GO, VEHICLE, ActorCommand, Blocked, ChairInStreet
from wcsim.bridge.reaction.crowd import PEOPLE_AHEAD_M, Vehicle, Walker, crowd_of, near, vehicles_near
from wcsim.core.boxes import Box, gap_to_box
from wcsim.core.jit import exact_kernel
from wcsim.types import U8, ActorState, ClassId, Ground, StreetGrid

SOLID_GAP_M = 0.3
SHOULDER = 0.8  # of a body's radius stays over walkable ground
EVERY_M = 0.5  # the way ahead is looked at in steps of so much
ACROSS = 5  # places looked at on the way across
_SIDEWALK, _CROSSWALK, _TERRAIN = int(ClassId.SIDEWALK), int(ClassId.CROSSWALK), int(ClassId.TERRAIN)
_GROUND, _PARKING = int(ClassId.GROUND), int(ClassId.PARKING)


@exact_kernel
def _cell(at_m: float, first_m: float, cell_m: float, count: int) -> int:
    return min(max(math.floor((at_m - first_m) / cell_m), 0), count - 1)


@exact_kernel
def _stands(
    classes: U8,
    clearance_dm: U8,
    first_x: float,
    first_y: float,
    cell_m: float,
    x: float,
    y: float,
    sx: float,
    sy: float,
) -> bool:
    """Whether the middle is clear of solid things, and it and both shoulders, sx, sy beside it, on walkable ground."""
    rows, cols = classes.shape
    row, col = _cell(y, first_y, cell_m, rows), _cell(x, first_x, cell_m, cols)
    if clearance_dm[row, col] * 0.1 < SOLID_GAP_M:
        return False
    for side in range(-1, 2):
        row, col = _cell(y + side * sy, first_y, cell_m, rows), _cell(x + side * sx, first_x, cell_m, cols)
        here = classes[row, col]
        if here != _SIDEWALK and here != _CROSSWALK and here != _TERRAIN and here != _GROUND and here != _PARKING:
            return False
    return True


@exact_kernel
def _opens(
    classes: U8, clearance_dm: U8, first_x: float, first_y: float, cell_m: float, at_x: float, at_y: float,
    x: float, y: float, cos: float, sin: float, ahead_m: float, side_m: float,
) -> bool:  # fmt: skip
    sx, sy = -side_m * sin, side_m * cos
    steps = math.ceil(ahead_m / EVERY_M)
    for i in range(steps + 1):
        far_m = ahead_m * i / max(steps, 1)
        if not _stands(classes, clearance_dm, first_x, first_y, cell_m, x + far_m * cos, y + far_m * sin, sx, sy):
            return False
    for i in range(1, ACROSS + 1):  # but for the place one has already
        t = i / ACROSS
        px, py = (1.0 - t) * at_x + t * x, (1.0 - t) * at_y + t * y
        if not _stands(classes, clearance_dm, first_x, first_y, cell_m, px, py, sx, sy):
            return False
    return True


def _can_stand(grid: StreetGrid, x: float, y: float, cos: float, sin: float, radius_m: float) -> bool:
    """Whether a person of this radius that looks along (cos, sin) can stand at a place with both shoulders."""
    side_m = SHOULDER * radius_m
    here = grid.ground_class, grid.clearance_dm, *grid.origin_W_m, grid.cell_m
    return _stands(*here, x, y, -side_m * sin, side_m * cos)


def _way_is_open(
    grid: StreetGrid,
    at_W_m: tuple[float, float],
    there_W_m: tuple[float, float],
    heading: tuple[float, float],
    ahead_m: float,
    radius_m: float,
) -> bool:
    """Whether a person can step from where it is over to a place beside, and walk so far ahead from there."""
    here = grid.ground_class, grid.clearance_dm, *grid.origin_W_m, grid.cell_m
    return _opens(*here, *at_W_m, *there_W_m, *heading, ahead_m, SHOULDER * radius_m)


FURTHEST_M = 2.0
FOREGO_RIGHT_M = 0.2  # how much shorter the way on the left must be
BACK_PULL = 1.2  # a metre off one's own line counts as this much walking across: who can go back does


class _Block(NamedTuple):  # made for everybody near a chair in every tick: a frozen dataclass costs twice as much
    """Something in the way: where it begins and ends ahead, and to the left of the person's own line, gaps included."""

    near_m: float
    far_m: float
    right_m: float
    left_m: float

    def blocks(self, left_m: float) -> bool:
        """Whether a person that walks so far left of its line would run into it."""
        return self.right_m < left_m < self.left_m

    @property
    def beside(self) -> bool:
        """Whether it is neither ahead nor behind: a step sideways may lead against it."""
        return self.near_m < 0.0 < self.far_m

    def parts(self, here_m: float, there_m: float) -> bool:
        """Whether it lies beside the person and between two places: nobody steps through it."""
        return self.beside and min(here_m, there_m) < 0.5 * (self.right_m + self.left_m) < max(here_m, there_m)


def _block_around(x: float, y: float, cos: float, sin: float, box: Box, gap_m: float, end_gap_m: float) -> _Block:
    """A box as somebody at (x, y) who looks along (cos, sin) sees it, with gaps at its sides and ends."""
    dx, dy = box[0] - x, box[1] - y
    turn_cos, turn_sin = abs(box[2] * cos + box[3] * sin), abs(box[3] * cos - box[2] * sin)
    ahead_m, aside_m = dx * cos + dy * sin, dy * cos - dx * sin
    long_m = box[4] * turn_cos + box[5] * turn_sin + end_gap_m
    wide_m = box[4] * turn_sin + box[5] * turn_cos + gap_m
    return _Block(near_m=ahead_m - long_m, far_m=ahead_m + long_m, right_m=aside_m - wide_m, left_m=aside_m + wide_m)


def _block_around_disc(ahead_m: float, aside_m: float, radius_m: float) -> _Block:
    """Somebody round, so far ahead and to the left; of one that is behind, only what still is beside."""
    wide_m = radius_m if ahead_m >= 0.0 else math.sqrt(max(0.0, radius_m**2 - ahead_m**2))
    return _Block(
        near_m=ahead_m - radius_m, far_m=ahead_m + radius_m, right_m=aside_m - wide_m, left_m=aside_m + wide_m
    )


def _ways_round(blocks: Sequence[_Block], now_m: float) -> Iterable[float]:
    """Places left of one's own line that no block covers and one can get to, the one with the shortest way first.

    >>> list(_ways_round([_Block(near_m=1.0, far_m=2.0, right_m=-0.6, left_m=0.8)], 0.0))
    [-0.6, 0.8]
    """
    ends = {end for block in blocks for end in (block.right_m, block.left_m)}
    free = {
        m
        for m in (0.0, now_m, *ends)
        if abs(m) <= FURTHEST_M and not any(block.blocks(m) or block.parts(now_m, m) for block in blocks)
    }
    # Of ways that cost the same the one further to the right is first: it is the smaller number.
    return sorted(free, key=lambda m: (_cost(m, now_m), m))


def _cost(left_m: float, now_m: float) -> float:
    away_m = 0.0 if math.isclose(left_m, 0.0) else BACK_PULL * abs(left_m)
    return abs(left_m - now_m) + away_m + (FOREGO_RIGHT_M if left_m > max(now_m, 0.0) + 1e-9 else 0.0)


SIDESTEP_MPS = 0.8
LOOK_AHEAD_M = 4.0
CHAIR_GAP_M, TIGHT_GAP_M = 0.25, 0.08  # beside a chair, and when there is no more room for long
PERSON_GAP_M = 0.12  # what a way round keeps to people and vehicles
TIGHT_PERSON_GAP_M = 0.07
BRUSH_M = 0.06  # nearer than this one stands, and does not step
BEHIND_M = 0.2  # clear of its rear before one steps back
STOP_SHORT_M = 0.45
PATIENCE_S = 3.0
BEGIN_BESIDE_M = (-0.6, 0.6, -1.0, 1.0, -1.5, 1.5)
FASTEST_MPS = 1.6  # a walker that stands may be this fast at the next tick


class _Chair(NamedTuple):
    """A wheelchair's footprint, and who of the people on foot looks for it."""

    box: Box
    people: Attention


class _Others(NamedTuple):
    """Whom a person could run into; a walker of the crowd is among them itself."""

    chairs: Sequence[_Chair]
    crowd: Sequence[Walker]
    vehicles: Sequence[Vehicle]


class PedestrianAvoidance:
    """Offsets of all persons near a wheelchair, and who of them has to stand for now."""

    def __init__(self, ground: Ground, tick_s: float, attention: Attention) -> None:
        self._ground = ground
        self._tick_s = tick_s
        self._attention = attention
        self._offsets: dict[str, tuple[float, float]] = {}  # by actor id
        self._standing_s: dict[str, float] = {}  # who is held, and for how long
        self._stuck: set[str] = set()  # who found no way past a chair
        self._seen: set[str] = set()  # everybody near a chair a tick ago
        self._holders: dict[str, str] = {}  # whom each of these stands before
        self._places: dict[str, tuple[float, float]] = {}  # where they were a tick ago
        self._speeds: dict[str, float] = {}  # as SUMO has them

    def shifted(self, actors: Sequence[ActorState]) -> tuple[ActorState, ...]:
        """The actors where they really walk; `deflect_m` is the offset's part to their left."""
        if not self._offsets:
            return tuple(actors)
        return tuple(self._shift(actor) if actor.id in self._offsets else actor for actor in actors)

    def blocked(self) -> tuple[Blocked, ...]:
        """The persons that stand because of a chair, or of somebody who steps aside for one."""
        return tuple(
            Blocked(actor_id=name, for_s=for_s, could_pass=name not in self._stuck, behind=self._holders[name])
            for name, for_s in self._standing_s.items()
        )

    def holds(self, actors: Sequence[ActorState], chairs: Sequence[ChairInStreet]) -> tuple[ActorCommand, ...]:
        """Who has to stand during this tick, and who walks on again; `actors` where and as they really move."""
        crowd = crowd_of(actors, chairs, self._offsets, shifted=True)
        if not (crowd or self._standing_s):
            return ()
        for walker in crowd:
            # As fast as SUMO drives them: the velocity that is shown has the step aside in it.
            walker.speed_mps = self._speeds.get(walker.id, walker.speed_mps)
        others = _Others(
            self._boxes(chairs, self._tick_s), crowd, vehicles_near(actors, crowd) if self._offsets else ()
        )
        holders = ((walker.id, self._held_by(walker, others)) for walker in crowd)
        self._holders = {name: holder for name, holder in holders if holder is not None}
        standing_s = {name: self._standing_s.get(name, 0.0) + self._tick_s for name in self._holders}
        go_on = [name for name in self._standing_s if name not in standing_s]
        self._standing_s = standing_s
        orders = [ActorCommand(actor_id=name, speed_mps=0.0) for name in standing_s]
        return (*orders, *(ActorCommand(actor_id=name, speed_mps=LET_GO) for name in go_on))

    def update(self, actors: Sequence[ActorState], chairs: Sequence[ChairInStreet]) -> None:
        """Move every offset by one tick; `actors` as SUMO has them, without offsets."""
        crowd = crowd_of(actors, chairs, self._offsets, shifted=False)
        others = _Others(self._boxes(chairs, 0.0), crowd, vehicles_near(actors, crowd) if crowd else ())
        self._stuck.intersection_update([walker.id for walker in crowd])
        self._speeds = {walker.id: walker.speed_mps for walker in crowd}
        for walker in crowd:
            self._stay_clear(walker, others)
        # The nearer to a chair, the earlier: the others see where these have gone. The id decides between equals.
        for walker in sorted(crowd, key=lambda walker: (walker.chair_m, walker.id)):
            self._move(walker, self._desired_left_m(walker, others), others)
        self._offsets = {walker.id: (walker.ox, walker.oy) for walker in crowd if walker.aside}
        self._places = {walker.id: walker.at for walker in crowd}
        self._seen = {actor.id for actor in actors}

    def _stay_clear(self, walker: Walker, others: _Others) -> None:
        """SUMO lets people jump a little at the ends of lanes; a body does not jump into a chair or another body."""
        before = self._places.get(walker.id)
        jumped = before is not None and math.dist(before, walker.at) > FURTHEST_M
        if jumped:  # SUMO has put it elsewhere
            walker.ox = walker.oy = 0.0
        if before is None or jumped:
            fresh = jumped or walker.id not in self._seen
            if fresh and self._overlaps(walker, walker.at, others):
                self._begin_beside(walker, others)
            return
        hits = self._overlaps(walker, walker.at, others)
        # Only a jump into somebody is undone: who overlaps already has to get out.
        if hits and not self._overlaps(walker, before, others):
            walker.ox, walker.oy = before[0] - walker.x, before[1] - walker.y

    def _begin_beside(self, walker: Walker, others: _Others) -> None:
        """SUMO has just put this person where somebody is that it does not see there: it comes into being beside."""
        # Near before far, and right before left, as people keep to the right.
        for left_m in BEGIN_BESIDE_M:
            walker.ox, walker.oy = -left_m * walker.sin, left_m * walker.cos
            free = not self._overlaps(walker, walker.at, others)
            if free and self._walkable(walker, *walker.at):
                return
        walker.ox = walker.oy = 0.0

    def _overlaps(
        self,
        walker: Walker,
        at: tuple[float, float],
        others: _Others,
    ) -> bool:
        if any(gap_to_box(*at, *box) < walker.radius_m for box in _noticed_boxes(others.chairs, walker)):
            return True
        if walker.aside and any(
            gap_to_box(*at, *vehicle.box) < walker.radius_m
            for vehicle in near(others.vehicles, *at)
            if not vehicle.moves
        ):
            return True
        return any(
            math.dist(at, other.at) < walker.radius_m + other.radius_m
            for other in others.crowd
            if other.id != walker.id and (other.aside or walker.aside)
        )

    def _held_by(self, walker: Walker, others: _Others) -> str | None:
        """What a step ahead would bring this person against: CHAIR, VEHICLE or somebody's id; None if nothing.

        Of people only those count that SUMO does not see where they are.
        """
        x, y = walker.at
        reach_m = max(FASTEST_MPS, 1.3 * walker.speed_mps) * self._tick_s
        nx, ny = x + reach_m * walker.cos, y + reach_m * walker.sin
        for box in _noticed_boxes(others.chairs, walker):
            gap_m = gap_to_box(nx, ny, *box) - walker.radius_m
            # Only a step that leads nearer is held up: who is too near already may walk away.
            if gap_m < STOP_SHORT_M and gap_m < gap_to_box(x, y, *box) - walker.radius_m:
                side_m = walker.radius_m + 0.5 * TIGHT_GAP_M  # less than who squeezes past keeps
                if _block_around(x, y, walker.cos, walker.sin, box, side_m, walker.radius_m).blocks(0.0):
                    return CHAIR
        for other in others.crowd:
            if other.id == walker.id or not (other.aside or walker.aside):
                continue
            ax, ay = other.at
            near_m = math.hypot(nx - ax, ny - ay)
            apart_m = walker.radius_m + other.radius_m + BRUSH_M
            if near_m < apart_m and near_m < math.hypot(x - ax, y - ay):
                return other.id
        hits = walker.aside and any(
            gap_to_box(nx, ny, *vehicle.box) < min(walker.radius_m + BRUSH_M, gap_to_box(x, y, *vehicle.box))
            for vehicle in near(others.vehicles, x, y)
            if gap_to_box(walker.x, walker.y, *vehicle.box) > 0.0  # else SUMO itself leads it through
        )
        return VEHICLE if hits else None

    def _desired_left_m(self, walker: Walker, others: _Others) -> float:
        """How far left of its line this person would like to be now."""
        now_m = walker.left_m
        tight = self._standing_s.get(walker.id, 0.0) > PATIENCE_S
        blocks = self._blocks(walker, others.chairs, TIGHT_GAP_M if tight else CHAIR_GAP_M)
        people = self._people(walker, others.crowd, TIGHT_PERSON_GAP_M if tight else PERSON_GAP_M)
        if not walker.aside and not any([block.blocks(0.0) for block in (*blocks, *people)]):
            self._stuck.discard(walker.id)
            return 0.0
        stand, drive = self._riders(walker, others.vehicles)
        people += stand + drive
        ahead_m = max((min(block.far_m, LOOK_AHEAD_M) for block in (*blocks, *people)), default=0.0)
        past_m = self._way_round(walker, (*blocks, *people), ahead_m)
        if past_m is not None:
            self._stuck.discard(walker.id)
            return past_m
        if any(block.blocks(now_m) for block in blocks):
            self._stuck.add(walker.id)
        # No way past the chair: wait, but out of the way of those who have one.
        away_m = self._way_round(walker, people, 0.0)
        if away_m is not None:
            return away_m
        run_over = any(block.beside and block.blocks(now_m) for block in drive)
        return 0.0 if run_over else now_m  # SUMO lets people stand only where it lets nobody drive

    def _way_round(self, walker: Walker, blocks: Sequence[_Block], ahead_m: float) -> float | None:
        """The nearest place left of its line that no block covers, with walkable ground so far ahead; None if none."""
        ways_m = _ways_round(blocks, walker.left_m)
        return next((m for m in ways_m if m == 0.0 or self._open_way(walker, m, ahead_m)), None)

    def _blocks(self, walker: Walker, chairs: Sequence[_Chair], gap_m: float) -> list[_Block]:
        seen = [
            _block_around(
                walker.x, walker.y, walker.cos, walker.sin, box, walker.radius_m + gap_m, walker.radius_m + BEHIND_M
            )
            for box in _noticed_boxes(chairs, walker)
        ]
        return [block for block in seen if block.far_m > 0.0 and block.near_m < LOOK_AHEAD_M]

    def _people(self, walker: Walker, crowd: Sequence[Walker], gap_m: float) -> list[_Block]:
        """Those who are where SUMO does not see them, or in whose way this person is, and who go first."""
        found = []
        for other in crowd:
            if other.id == walker.id or not (other.aside or walker.aside):
                continue
            # The one nearer to a chair goes first, so of two people one makes room and never both.
            if (other.chair_m, other.id) > (walker.chair_m, walker.id) and other.id not in self._standing_s:
                continue
            along = walker.cos * other.cos + walker.sin * other.sin
            # Who walks ahead at nearly the same pace is not in the way until it is close.
            same_way = along > 0.5 and other.speed_mps > 0.5 * walker.speed_mps > 0.0
            x, y = other.at
            dx, dy = x - walker.x, y - walker.y
            block = _block_around_disc(
                dx * walker.cos + dy * walker.sin,
                dy * walker.cos - dx * walker.sin,
                walker.radius_m + other.radius_m + gap_m,
            )
            if block.far_m > 0.0 and block.near_m < (0.3 if same_way else PEOPLE_AHEAD_M):
                found.append(block)
        return found

    def _riders(self, walker: Walker, vehicles: Sequence[Vehicle]) -> tuple[list[_Block], list[_Block]]:
        """The vehicles beside that stand, and where those that move are going to be."""
        gap_m, now_m = walker.radius_m + PERSON_GAP_M, walker.left_m
        stand, drive = [], []
        for vehicle in near(vehicles, *walker.at):
            block = _block_around(walker.x, walker.y, walker.cos, walker.sin, vehicle.sweep, gap_m, gap_m)
            if block.far_m <= 0.0 or block.near_m >= PEOPLE_AHEAD_M:
                continue
            if vehicle.moves:
                drive.append(block)
            elif not (block.beside and block.blocks(now_m)):  # else one is in the gap already, and may move along it
                stand.append(block)
        return stand, drive

    def _move(
        self,
        walker: Walker,
        desired_m: float,
        others: _Others,
    ) -> None:
        """One tick's step of the offset, unless it leads too near to somebody or off the walkable ground."""
        wx, wy = -desired_m * walker.sin - walker.ox, desired_m * walker.cos - walker.oy
        length_m = math.hypot(wx, wy)
        if length_m < 1e-9:
            if not desired_m:
                walker.ox = walker.oy = 0.0
            return
        share = min(1.0, SIDESTEP_MPS * self._tick_s / length_m)
        x, y = walker.at
        nx, ny = x + share * wx, y + share * wy
        back = math.hypot(nx - walker.x, ny - walker.y) < math.hypot(walker.ox, walker.oy)
        if self._crowded(walker, (x, y), (nx, ny), others):
            return
        leaves = not self._walkable(walker, nx, ny) and self._walkable(walker, x, y)
        if not back and leaves:  # SUMO itself may have it walk where one does not: from there it may step off
            return
        walker.ox, walker.oy = (
            (-desired_m * walker.sin, desired_m * walker.cos) if share >= 1.0 else (nx - walker.x, ny - walker.y)
        )
        # Exactly nothing: a rest of rounding would keep this person aside for ever.
        if share >= 1.0 and not desired_m:
            walker.ox = walker.oy = 0.0

    def _crowded(
        self,
        walker: Walker,
        here: tuple[float, float],
        there: tuple[float, float],
        others: _Others,
    ) -> bool:
        """Whether a sideways step comes too near to a chair, a vehicle or a person, and nearer than before."""
        for other in others.crowd:
            if other.id != walker.id:
                ax, ay = other.at
                near_m = math.hypot(there[0] - ax, there[1] - ay)
                apart_m = walker.radius_m + other.radius_m + BRUSH_M
                if near_m < apart_m and near_m < math.hypot(here[0] - ax, here[1] - ay):
                    return True
        beside = [vehicle.box for vehicle in near(others.vehicles, *here)]
        for boxes, gap_m in (([chair.box for chair in others.chairs], 0.5 * TIGHT_GAP_M), (beside, BRUSH_M)):
            for box in boxes:
                near_m = gap_to_box(*there, *box)
                if near_m < walker.radius_m + gap_m and near_m < gap_to_box(*here, *box):
                    return True
        return False

    def _open_way(self, walker: Walker, left_m: float, ahead_m: float) -> bool:
        """Whether the ground beside the line is walkable, from here to where the way round ends."""
        grid = self._ground.around(walker.p_W_m)
        there = walker.x - left_m * walker.sin, walker.y + left_m * walker.cos
        return _way_is_open(grid, walker.at, there, (walker.cos, walker.sin), max(ahead_m, 0.0), walker.radius_m)

    def _walkable(self, walker: Walker, x: float, y: float) -> bool:
        """Whether this person can stand there with both shoulders."""
        return _can_stand(self._ground.around(walker.p_W_m), x, y, walker.cos, walker.sin, walker.radius_m)

    def _boxes(self, chairs: Sequence[ChairInStreet], ahead_s: float) -> list[_Chair]:
        return [
            _Chair(_chair_box(chair, ahead_s), self._attention if chair.habits is None else chair.habits.people)
            for chair in chairs
        ]

    def _shift(self, actor: ActorState) -> ActorState:
        ox, oy = self._offsets[actor.id]
        x, y, z = actor.p_W_m.tolist()
        left_m = oy * math.cos(actor.yaw_rad) - ox * math.sin(actor.yaw_rad)
        return replace(actor, p_W_m=np.array([x + ox, y + oy, z]), deflect_m=left_m)


def _noticed_boxes(chairs: Sequence[_Chair], walker: Walker) -> list[Box]:
    """The chairs that this person notices."""
    return [chair.box for chair in chairs if chair.people.looks(walker.id)]


def _chair_box(chair: ChairInStreet, ahead_s: float) -> Box:
    """The chair's footprint, where it is going to be; it turns so little in that time that its heading stays."""
    x, y = (chair.p_W_m + ahead_s * chair.v_W_mps).tolist()
    return x, y, math.cos(chair.yaw_rad), math.sin(chair.yaw_rad), *chair.half_m

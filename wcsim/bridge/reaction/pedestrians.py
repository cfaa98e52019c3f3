"""People step aside for a wheelchair.

An offset beside SUMO's pose, because SUMO itself does not know the chair. The offset is a vector in
W, so that it stays continuous when a person turns. It changes by at most SIDESTEP_MPS, leads only
onto walkable ground that is clear of solid things and of others, and goes back to nothing after the
person has passed. Who cannot pass stops short. SUMO does not know of those who stepped aside
either, so people near a chair keep clear of them here: who is nearer to the chair goes first, the
others make room.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from wcsim.bridge.reaction.attention import Attention
from wcsim.bridge.reaction.commands import (
    CHAIR,
    LET_GO,
    VEHICLE,
    ActorCommand,
    Blocked,
    ChairInStreet,
)
from wcsim.bridge.reaction.crowd import (
    PEOPLE_AHEAD_M,
    Vehicle,
    Walker,
    crowd_of,
    near,
    vehicles_near,
)
from wcsim.core.boxes import Box, gap_to_box
from wcsim.core.constants import SIDESTEP_MPS
from wcsim.core.jit import compile_exact_kernel
from wcsim.types import U8, ActorState, ClassId, Ground, StreetGrid

# Walking round
_LOOK_AHEAD_M = 4.0
_FURTHEST_M = 2.0  # from one's own line
_FOREGO_RIGHT_M = 0.2  # how much shorter the way on the left must be
# A metre off one's own line counts as this much walking across: who can go back does.
_BACK_PULL = 1.2
# Near before far, and right before left, as people keep to the right.
_BEGIN_BESIDE_M = (-0.6, 0.6, -1.0, 1.0, -1.5, 1.5)

# Gaps to bodies
CHAIR_GAP_M = 0.25  # beside a chair
_TIGHT_GAP_M = 0.08  # beside a chair, after _PATIENCE_S without a way past it
# At this nobody steps nearer to a chair. It is less than the gap of those who squeeze past.
_LEAST_CHAIR_GAP_M = 0.5 * _TIGHT_GAP_M
PERSON_GAP_M = 0.12  # from a way round to people and vehicles
_TIGHT_PERSON_GAP_M = 0.07  # to people, after _PATIENCE_S
_BRUSH_M = 0.06  # nearer than this one stands, and does not step
_BEHIND_M = 0.2  # clear of a chair's rear before one steps back
# Who walks ahead at nearly the same pace is not in the way until it is so close.
_SAME_WAY_AHEAD_M = 0.3

# Standing
_STOP_SHORT_M = 0.45
_PATIENCE_S = 3.0
_FASTEST_MPS = 1.6  # a walker that stands may be this fast at the next tick

# Ground
SOLID_GAP_M = 0.3
SHOULDER = 0.8  # of a body's radius stays over walkable ground
_EVERY_M = 0.5  # the way ahead is looked at in steps of so much
_ACROSS = 5  # places looked at on the way across
# Plain numbers, which a kernel can read.
_SIDEWALK, _CROSSWALK = int(ClassId.SIDEWALK), int(ClassId.CROSSWALK)
_TERRAIN, _GROUND, _PARKING = int(ClassId.TERRAIN), int(ClassId.GROUND), int(ClassId.PARKING)


class _Chair(NamedTuple):
    """A wheelchair's footprint, and who of the people on foot looks for it."""

    box: Box
    people: Attention


class _Others(NamedTuple):
    """Whom a person could run into; a walker of the crowd is among them itself."""

    chairs: Sequence[_Chair]
    crowd: Sequence[Walker]
    vehicles: Sequence[Vehicle]


# Made for everybody near a chair in every tick: a frozen dataclass costs twice as much.
class _Block(NamedTuple):
    """Where something in the way is, ahead and left of the person's own line, gaps included."""

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
        middle_m = 0.5 * (self.right_m + self.left_m)
        return self.beside and min(here_m, there_m) < middle_m < max(here_m, there_m)


class PedestrianAvoidance:
    """Offsets of all persons near a wheelchair, and who of them has to stand for now.

    In each tick the world calls `holds` before SUMO's step, then `update` with SUMO's new poses,
    then `shifted`.
    """

    def __init__(self, ground: Ground, tick_s: float, attention: Attention) -> None:
        self._ground = ground
        self._tick_s = tick_s
        self._attention = attention
        self._offsets: dict[str, tuple[float, float]] = {}  # by actor id
        # Since the last `holds`
        self._standing_s: dict[str, float] = {}  # who has to stand, and for how long
        self._holders: dict[str, str] = {}  # before whom each of these stands
        # Since the last `update`
        self._stuck: set[str] = set()  # who found no way past a chair
        self._seen: set[str] = set()  # everybody whom SUMO had
        self._places: dict[str, tuple[float, float]] = {}  # where they were
        self._speeds: dict[str, float] = {}  # as SUMO has them

    def shifted(self, actors: Sequence[ActorState]) -> tuple[ActorState, ...]:
        """The actors where they really walk; `deflect_m` is the offset's part to their left."""
        moved = []
        for actor in actors:
            if actor.id in self._offsets:
                ox, oy = self._offsets[actor.id]
                x, y, z = actor.p_W_m.tolist()
                left_m = oy * math.cos(actor.yaw_rad) - ox * math.sin(actor.yaw_rad)
                actor = replace(actor, p_W_m=np.array([x + ox, y + oy, z]), deflect_m=left_m)
            moved.append(actor)
        return tuple(moved)

    def blocked(self) -> tuple[Blocked, ...]:
        """The persons that stand because of a chair, or of somebody who steps aside for one."""
        return tuple(
            Blocked(
                actor_id=name,
                for_s=for_s,
                could_pass=name not in self._stuck,
                behind=self._holders[name],
            )
            for name, for_s in self._standing_s.items()
        )

    def holds(
        self, actors: Sequence[ActorState], chairs: Sequence[ChairInStreet]
    ) -> tuple[ActorCommand, ...]:
        """Who has to stand in this tick, and who walks on; `actors` where they really move."""
        crowd = crowd_of(actors, chairs, self._offsets, shifted=True)
        if not (crowd or self._standing_s):
            return ()
        for walker in crowd:
            # As fast as SUMO drives them: the velocity that is shown has the step aside in it.
            walker.speed_mps = self._speeds.get(walker.id, walker.speed_mps)
        vehicles = vehicles_near(actors, crowd) if self._offsets else ()
        others = _Others(self._chairs(chairs, self._tick_s), crowd, vehicles)
        holders = ((walker.id, self._held_by(walker, others)) for walker in crowd)
        self._holders = {name: holder for name, holder in holders if holder is not None}
        standing_s = {
            name: self._standing_s.get(name, 0.0) + self._tick_s for name in self._holders
        }
        stand = [ActorCommand(actor_id=name, speed_mps=0.0) for name in standing_s]
        go_on = [
            ActorCommand(actor_id=name, speed_mps=LET_GO)
            for name in self._standing_s
            if name not in standing_s
        ]
        self._standing_s = standing_s
        return (*stand, *go_on)

    def update(self, actors: Sequence[ActorState], chairs: Sequence[ChairInStreet]) -> None:
        """Move every offset by one tick; `actors` as SUMO has them, without offsets."""
        crowd = crowd_of(actors, chairs, self._offsets, shifted=False)
        vehicles = vehicles_near(actors, crowd) if crowd else ()
        others = _Others(self._chairs(chairs, 0.0), crowd, vehicles)
        self._stuck.intersection_update([walker.id for walker in crowd])
        self._speeds = {walker.id: walker.speed_mps for walker in crowd}

        # 1. SUMO lets people jump at the ends of lanes, and puts new ones anywhere. A body does
        #    neither into another.
        for walker in crowd:
            self._undo_jump(walker, others)

        # 2. Everybody takes a step. The nearer to a chair, the earlier: the others see where these
        #    are then. The id decides between equals.
        for walker in sorted(crowd, key=lambda walker: (walker.chair_m, walker.id)):
            self._step(walker, self._desired_left_m(walker, others), others)

        # 3. What the next tick needs to know.
        self._offsets = {walker.id: (walker.ox, walker.oy) for walker in crowd if walker.aside}
        self._places = {walker.id: walker.at for walker in crowd}
        self._seen = {actor.id for actor in actors}

    def _held_by(self, walker: Walker, others: _Others) -> str | None:
        """What a step ahead would hit: CHAIR, VEHICLE, somebody's id; None for nothing."""
        x, y = walker.at
        reach_m = max(_FASTEST_MPS, 1.3 * walker.speed_mps) * self._tick_s
        nx, ny = x + reach_m * walker.cos, y + reach_m * walker.sin

        # 1. Chairs. Only a step that leads nearer is held up: who is too near already may leave.
        for box in _boxes_in_sight(others.chairs, walker):
            gap_m = gap_to_box(nx, ny, *box) - walker.radius_m
            if gap_m < _STOP_SHORT_M and gap_m < gap_to_box(x, y, *box) - walker.radius_m:
                heading, side_m = (walker.cos, walker.sin), walker.radius_m + _LEAST_CHAIR_GAP_M
                if _block_around(x, y, *heading, box, side_m, walker.radius_m).blocks(0.0):
                    return CHAIR

        # 2. People, but only those that SUMO does not see where they are.
        for other in others.crowd:
            if other.id == walker.id or not (other.aside or walker.aside):
                continue
            ax, ay = other.at
            near_m = math.hypot(nx - ax, ny - ay)
            apart_m = walker.radius_m + other.radius_m + _BRUSH_M
            if near_m < apart_m and near_m < math.hypot(x - ax, y - ay):
                return other.id

        # 3. Vehicles, beside the own line: on it SUMO itself leads this person through.
        if not walker.aside:
            return None
        for vehicle in near(others.vehicles, x, y):
            if gap_to_box(walker.x, walker.y, *vehicle.box) > 0.0:
                most_m = min(walker.radius_m + _BRUSH_M, gap_to_box(x, y, *vehicle.box))
                if gap_to_box(nx, ny, *vehicle.box) < most_m:
                    return VEHICLE
        return None

    def _undo_jump(self, walker: Walker, others: _Others) -> None:
        """Bring a person back whom SUMO has put into somebody that it does not see there."""
        before = self._places.get(walker.id)
        jumped = before is not None and math.dist(before, walker.at) > _FURTHEST_M
        if jumped:
            walker.ox = walker.oy = 0.0

        # 1. A little jump into somebody is undone. Who overlaps already has to get out.
        if before is not None and not jumped:
            overlaps = self._overlaps(walker, walker.at, others)
            if overlaps and not self._overlaps(walker, before, others):
                walker.ox, walker.oy = before[0] - walker.x, before[1] - walker.y
            return

        # 2. Who has just come into being, or anew far away, does so beside.
        if not jumped and walker.id in self._seen:
            return
        if not self._overlaps(walker, walker.at, others):
            return
        for left_m in _BEGIN_BESIDE_M:
            walker.ox, walker.oy = -left_m * walker.sin, left_m * walker.cos
            if not self._overlaps(walker, walker.at, others) and self._walkable(walker, *walker.at):
                return
        walker.ox = walker.oy = 0.0

    def _overlaps(self, walker: Walker, at: tuple[float, float], others: _Others) -> bool:
        """Whether a person there would be in a chair, a standing vehicle or somebody aside."""
        boxes = _boxes_in_sight(others.chairs, walker)
        if any(gap_to_box(*at, *box) < walker.radius_m for box in boxes):
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

    def _desired_left_m(self, walker: Walker, others: _Others) -> float:
        """How far left of its line this person would like to be now."""
        now_m = walker.left_m
        waited = self._standing_s.get(walker.id, 0.0) > _PATIENCE_S

        # 1. Who has nothing in its way stays on its line.
        chairs = _chairs_in_way(walker, others.chairs, _TIGHT_GAP_M if waited else CHAIR_GAP_M)
        gap_m = _TIGHT_PERSON_GAP_M if waited else PERSON_GAP_M
        people = self._people_in_way(walker, others.crowd, gap_m)
        if not walker.aside and not any([block.blocks(0.0) for block in (*chairs, *people)]):
            self._stuck.discard(walker.id)
            return 0.0

        # 2. Who leaves it takes the nearest way past all of them, and past vehicles beside.
        standing, driving = _vehicles_beside(walker, others.vehicles)
        bodies = (*people, *standing, *driving)
        ahead_m = max(
            (min(block.far_m, _LOOK_AHEAD_M) for block in (*chairs, *bodies)), default=0.0
        )
        past_m = self._way_round(walker, (*chairs, *bodies), ahead_m)
        if past_m is not None:
            self._stuck.discard(walker.id)
            return past_m

        # 3. No way past the chair: wait, but out of the way of those who have one.
        if any(block.blocks(now_m) for block in chairs):
            self._stuck.add(walker.id)
        away_m = self._way_round(walker, bodies, 0.0)
        if away_m is not None:
            return away_m

        # 4. No such place either: stay here, or go back to where SUMO lets people stand, which is
        #    where nobody drives.
        run_over = any(block.beside and block.blocks(now_m) for block in driving)
        return 0.0 if run_over else now_m

    def _people_in_way(self, walker: Walker, crowd: Sequence[Walker], gap_m: float) -> list[_Block]:
        """Those whom SUMO does not see, or in whose way this person is, and who go first."""
        found = []
        own_turn = walker.chair_m, walker.id
        for other in crowd:
            if other.id == walker.id or not (other.aside or walker.aside):
                continue
            # The one nearer to a chair goes first, so of two people one makes room and never both.
            is_later = (other.chair_m, other.id) > own_turn
            if is_later and other.id not in self._standing_s:
                continue
            along = walker.cos * other.cos + walker.sin * other.sin
            same_way = along > 0.5 and other.speed_mps > 0.5 * walker.speed_mps > 0.0
            x, y = other.at
            dx, dy = x - walker.x, y - walker.y
            block = _block_around_disc(
                dx * walker.cos + dy * walker.sin,
                dy * walker.cos - dx * walker.sin,
                walker.radius_m + other.radius_m + gap_m,
            )
            look_m = _SAME_WAY_AHEAD_M if same_way else PEOPLE_AHEAD_M
            if block.far_m > 0.0 and block.near_m < look_m:
                found.append(block)
        return found

    def _way_round(self, walker: Walker, blocks: Sequence[_Block], ahead_m: float) -> float | None:
        """The nearest free place left of its line, walkable so far ahead; None without one."""
        for left_m in _ways_round(blocks, walker.left_m):
            # Its own line is where SUMO has it walk.
            if left_m == 0.0:
                return left_m
            grid = self._ground.around(walker.p_W_m)
            there = walker.x - left_m * walker.sin, walker.y + left_m * walker.cos
            heading = walker.cos, walker.sin
            if _way_is_open(grid, walker.at, there, heading, max(ahead_m, 0.0), walker.radius_m):
                return left_m
        return None

    def _step(self, walker: Walker, desired_m: float, others: _Others) -> None:
        """Move the offset by a tick, unless too near to somebody or off the walkable ground."""
        wx, wy = -desired_m * walker.sin - walker.ox, desired_m * walker.cos - walker.oy
        length_m = math.hypot(wx, wy)
        if length_m < 1e-9:
            if not desired_m:
                walker.ox = walker.oy = 0.0
            return
        share = min(1.0, SIDESTEP_MPS * self._tick_s / length_m)
        x, y = walker.at
        nx, ny = x + share * wx, y + share * wy

        # 1. No step leads too near to a body, and nearer than before.
        if _is_too_near(walker, (nx, ny), others):
            return

        # 2. None leads off the walkable ground. SUMO itself may have it walk where one does not:
        #    from there it may.
        back = math.hypot(nx - walker.x, ny - walker.y) < math.hypot(walker.ox, walker.oy)
        if not back and not self._walkable(walker, nx, ny) and self._walkable(walker, x, y):
            return

        # 3. The last step ends exactly on its line: a rest of rounding would hold this person aside
        #    for ever.
        if share < 1.0:
            walker.ox, walker.oy = nx - walker.x, ny - walker.y
        elif desired_m:
            walker.ox, walker.oy = -desired_m * walker.sin, desired_m * walker.cos
        else:
            walker.ox = walker.oy = 0.0

    def _walkable(self, walker: Walker, x: float, y: float) -> bool:
        """Whether this person can stand there with both shoulders."""
        grid = self._ground.around(walker.p_W_m)
        return _can_stand(grid, x, y, walker.cos, walker.sin, walker.radius_m)

    def _chairs(self, chairs: Sequence[ChairInStreet], ahead_s: float) -> list[_Chair]:
        """The chairs where they are going to be; their headings stay, they turn so little."""
        found = []
        for chair in chairs:
            x, y = (chair.p_W_m + ahead_s * chair.v_W_mps).tolist()
            box = x, y, math.cos(chair.yaw_rad), math.sin(chair.yaw_rad), *chair.half_m
            people = self._attention if chair.habits is None else chair.habits.people
            found.append(_Chair(box, people))
        return found


def _boxes_in_sight(chairs: Sequence[_Chair], walker: Walker) -> list[Box]:
    """The chairs that this person notices."""
    return [chair.box for chair in chairs if chair.people.looks(walker.id)]


def _chairs_in_way(walker: Walker, chairs: Sequence[_Chair], gap_m: float) -> list[_Block]:
    """The chairs ahead that this person notices, with such a gap at their sides."""
    place = walker.x, walker.y, walker.cos, walker.sin
    seen = [
        _block_around(*place, box, walker.radius_m + gap_m, walker.radius_m + _BEHIND_M)
        for box in _boxes_in_sight(chairs, walker)
    ]
    return [block for block in seen if block.far_m > 0.0 and block.near_m < _LOOK_AHEAD_M]


def _vehicles_beside(
    walker: Walker, vehicles: Sequence[Vehicle]
) -> tuple[list[_Block], list[_Block]]:
    """The vehicles that stand, and where those that drive are going to be."""
    gap_m = walker.radius_m + PERSON_GAP_M
    place = walker.x, walker.y, walker.cos, walker.sin
    standing, driving = [], []
    for vehicle in near(vehicles, *walker.at):
        block = _block_around(*place, vehicle.sweep, gap_m, gap_m)
        if block.far_m <= 0.0 or block.near_m >= PEOPLE_AHEAD_M:
            continue
        if vehicle.moves:
            driving.append(block)
        # Who is in the gap already may move along.
        elif not (block.beside and block.blocks(walker.left_m)):
            standing.append(block)
    return standing, driving


def _is_too_near(walker: Walker, there: tuple[float, float], others: _Others) -> bool:
    """Whether a step there leads too near to a person, chair or vehicle, and nearer than now."""
    (x, y), (nx, ny) = walker.at, there
    for other in others.crowd:
        if other.id == walker.id:
            continue
        ax, ay = other.at
        near_m = math.hypot(nx - ax, ny - ay)
        apart_m = walker.radius_m + other.radius_m + _BRUSH_M
        if near_m < apart_m and near_m < math.hypot(x - ax, y - ay):
            return True
    bodies = [(chair.box, _LEAST_CHAIR_GAP_M) for chair in others.chairs]
    bodies += [(vehicle.box, _BRUSH_M) for vehicle in near(others.vehicles, x, y)]
    for box, gap_m in bodies:
        near_m = gap_to_box(nx, ny, *box)
        if near_m < walker.radius_m + gap_m and near_m < gap_to_box(x, y, *box):
            return True
    return False


def _block_around(
    x: float, y: float, cos: float, sin: float, box: Box, gap_m: float, end_gap_m: float
) -> _Block:
    """A box as seen from (x, y) along (cos, sin), with gaps at its sides and ends."""
    dx, dy = box[0] - x, box[1] - y
    turn_cos, turn_sin = abs(box[2] * cos + box[3] * sin), abs(box[3] * cos - box[2] * sin)
    ahead_m, aside_m = dx * cos + dy * sin, dy * cos - dx * sin
    long_m = box[4] * turn_cos + box[5] * turn_sin + end_gap_m
    wide_m = box[4] * turn_sin + box[5] * turn_cos + gap_m
    return _Block(
        near_m=ahead_m - long_m,
        far_m=ahead_m + long_m,
        right_m=aside_m - wide_m,
        left_m=aside_m + wide_m,
    )


def _block_around_disc(ahead_m: float, aside_m: float, radius_m: float) -> _Block:
    """Somebody round, so far ahead and left; of one behind, only what still is beside."""
    wide_m = radius_m if ahead_m >= 0.0 else math.sqrt(max(0.0, radius_m**2 - ahead_m**2))
    return _Block(
        near_m=ahead_m - radius_m,
        far_m=ahead_m + radius_m,
        right_m=aside_m - wide_m,
        left_m=aside_m + wide_m,
    )


def _ways_round(blocks: Sequence[_Block], now_m: float) -> Iterable[float]:
    """Free places left of one's own line that one can get to, the shortest way first.

    >>> list(_ways_round([_Block(near_m=1.0, far_m=2.0, right_m=-0.6, left_m=0.8)], 0.0))
    [-0.6, 0.8]
    """

    def cost_m(left_m: float) -> float:
        away_m = 0.0 if math.isclose(left_m, 0.0) else _BACK_PULL * abs(left_m)
        forego_m = _FOREGO_RIGHT_M if left_m > max(now_m, 0.0) + 1e-9 else 0.0
        return abs(left_m - now_m) + away_m + forego_m

    ends = {end for block in blocks for end in (block.right_m, block.left_m)}
    free = {
        m
        for m in (0.0, now_m, *ends)
        if abs(m) <= _FURTHEST_M
        and not any(block.blocks(m) or block.parts(now_m, m) for block in blocks)
    }
    # Of ways that cost the same the one further to the right is first: it is the smaller number.
    return sorted(free, key=lambda m: (cost_m(m), m))


def _way_is_open(
    grid: StreetGrid,
    at_W_m: tuple[float, float],
    there_W_m: tuple[float, float],
    heading: tuple[float, float],
    ahead_m: float,
    radius_m: float,
) -> bool:
    """Whether a person can step over to a place beside, and walk so far ahead from there."""
    here = grid.ground_class, grid.clearance_dm, *grid.origin_W_m, grid.cell_m
    return _opens(*here, *at_W_m, *there_W_m, *heading, ahead_m, SHOULDER * radius_m)


def _can_stand(
    grid: StreetGrid, x: float, y: float, cos: float, sin: float, radius_m: float
) -> bool:
    """Whether a person of this radius, heading (cos, sin), can stand there with both shoulders."""
    side_m = SHOULDER * radius_m
    here = grid.ground_class, grid.clearance_dm, *grid.origin_W_m, grid.cell_m
    return _stands(*here, x, y, -side_m * sin, side_m * cos)


@compile_exact_kernel
def _cell(at_m: float, first_m: float, cell_m: float, count: int) -> int:
    return min(max(math.floor((at_m - first_m) / cell_m), 0), count - 1)


@compile_exact_kernel
def _stands(
    classes: U8, clearance_dm: U8, first_x: float, first_y: float, cell_m: float,
    x: float, y: float, sx: float, sy: float,
) -> bool:  # fmt: skip
    """Whether the middle is clear of solid things, and on walkable ground with both shoulders.

    The shoulders are at (sx, sy) beside the middle. Many such looks happen in every tick.
    """
    rows, cols = classes.shape
    row, col = _cell(y, first_y, cell_m, rows), _cell(x, first_x, cell_m, cols)
    if clearance_dm[row, col] * 0.1 < SOLID_GAP_M:
        return False
    for side in range(-1, 2):
        row = _cell(y + side * sy, first_y, cell_m, rows)
        col = _cell(x + side * sx, first_x, cell_m, cols)
        here = classes[row, col]
        if (
            here != _SIDEWALK
            and here != _CROSSWALK
            and here != _TERRAIN
            and here != _GROUND
            and here != _PARKING
        ):
            return False
    return True


@compile_exact_kernel
def _opens(
    classes: U8, clearance_dm: U8, first_x: float, first_y: float, cell_m: float,
    at_x: float, at_y: float, x: float, y: float, cos: float, sin: float,
    ahead_m: float, side_m: float,
) -> bool:  # fmt: skip
    """See `_way_is_open`."""
    sx, sy = -side_m * sin, side_m * cos
    steps = math.ceil(ahead_m / _EVERY_M)
    for i in range(steps + 1):
        far_m = ahead_m * i / max(steps, 1)
        px, py = x + far_m * cos, y + far_m * sin
        if not _stands(classes, clearance_dm, first_x, first_y, cell_m, px, py, sx, sy):
            return False
    # The place that one has already is not looked at.
    for i in range(1, _ACROSS + 1):
        t = i / _ACROSS
        px, py = (1.0 - t) * at_x + t * x, (1.0 - t) * at_y + t * y
        if not _stands(classes, clearance_dm, first_x, first_y, cell_m, px, py, sx, sy):
            return False
    return True

"""Statics of a chair on a tilted table: the load of each wheel, and the tilt at which it tips.

Everything is computed from masses and contact points alone, as a plant's file declares them, never
from the simulated body. Table frame T: z normal to the table, x and y of the chair before it moves
on its springs. The chair does not slide: friction holds it in the plane of the table, so that only
the height, pitch and roll of the frame are unknown.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final, Self

import numpy as np

from wcsim.config.plant import CasterArmPart, CasterPart
from wcsim.core.frames import deg2rad
from wcsim.errors import PhysicsError
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.physics.wheelchair.plant import FORK_COM_M, FORK_M, PlantSpec
from wcsim.types import F64

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
# Unit vectors in the table that point downhill.
FORWARD_DOWN: Final[Vec2] = (1.0, 0.0)
REAR_DOWN: Final[Vec2] = (-1.0, 0.0)
LEFT_DOWN: Final[Vec2] = (0.0, 1.0)

# The chair and its contacts.
_SIDES: Final = (("l", 1.0), ("r", -1.0))
_UP: Final = np.array([0.0, 0.0, 1.0])
# Swivel angles among which the worst is looked for.
_SWIVEL_ANGLES: Final = 72
# Feet that are less than this behind the farthest one downhill belong to the same pair.
_GROUP_M: Final = 0.05
# A wheel on the table gives by 0.1 mm under a whole chair.
_TYRE_N_PER_M: Final = 1e7
_SAME_HEIGHT_M: Final = 1e-6

# The search for the tip angle.
_COARSE_STEP_RAD: Final = deg2rad(1.0)
_FINE_STEP_RAD: Final = deg2rad(0.01)
_MAX_TILT_RAD: Final = deg2rad(60.0)
# Of the weight: uphill feet with less carry nothing.
_LEAST_LOAD_SHARE: Final = 1e-6
# Guesses of a pose downhill, where the chair may lean on an anti-tip or a stop in the end.
_LEANS_RAD: Final = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2)
# Apart: leans between which the chair may fall from one pair of feet onto another.
_LEAN_STEP_RAD: Final = 0.05
_LEAN_PRECISION_RAD: Final = 1e-6

# Newton's method.
# Every wheel touches at first: one that just does not gives Newton no slope.
_START_POSE: Final = np.array([-5e-5, 0.0, 0.0])
_MAX_NEWTON_STEPS: Final = 60
# Of the weight.
_TOLERANCE_SHARE: Final = 1e-6
_MAX_LEAN_RAD: Final = 0.5
# Times the stiffness of a wheel: with more, moves are too small to get anywhere.
_MAX_DAMPING: Final = 100.0

_TIPS_AT_REST: Final = (
    "the plant tips at rest; expected one that stands: check its masses and wheels"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Beam:
    """A beam that carries feet and rocks freely about a lengthwise pivot in the middle plane."""

    pivot_z_m: float
    stop_rad: float
    # Of all that rocks.
    weight_N: float
    com_z_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SupportFoot:
    """A wheel or ball that can stand on the table, in B with its arm at rest."""

    name: str
    centre_m: Vec3
    radius_m: float
    axis: Vec3 = (0.0, 0.0, 0.0)  # unit vector along the axle; none for a ball
    half_width_m: float = 0.0
    friction: float = 1.0
    arm: CasterArmPart | None = None  # sprung, upright in B
    unsprung_kg: float = 0.0  # what hangs on the arm
    beam: _Beam | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticChair:
    """A chair on level ground before it moves on its springs: its mass and its feet."""

    mass_kg: float
    com_m: Vec3
    feet: tuple[SupportFoot, ...]

    def without(self, prefix: str) -> Self:
        """The same chair without the feet whose names begin so."""
        feet = tuple(foot for foot in self.feet if not foot.name.startswith(prefix))
        return replace(self, feet=feet)


def make_static_chair(spec: PlantSpec, swivel_rad: float = 0.0) -> StaticChair:
    """The chair with every caster's fork turned to an angle (0 is trailing), arms at rest."""
    feet = [*_wheels(spec), *_casters(spec, swivel_rad), *_antitips(spec)]
    return StaticChair(mass_kg=spec.whole_kg, com_m=_com_m(spec, swivel_rad), feet=tuple(feet))


def find_worst_swivel_rad(spec: PlantSpec, downhill: Vec2) -> float:
    """The swivel angle with the tip line nearest to the centre of mass, without anti-tips."""
    angles = [2.0 * math.pi * k / _SWIVEL_ANGLES for k in range(_SWIVEL_ANGLES)]
    return min(
        angles,
        key=lambda angle: _rigid_tip_angle_rad(
            make_static_chair(spec, angle).without("antitip"), downhill
        ),
    )


def compute_inertia_kgm2(spec: PlantSpec) -> F64:
    """Moments of inertia (3,) about the centre of mass, along B's axes, casters trailing."""
    about = np.array(_com_m(spec))
    total = np.zeros(3)
    frame = (
        spec.frame_mass_kg,
        spec.frame_com_m,
        tuple(0.5 * one for one in spec.frame_inertia_kgm2),
    )
    for mass_kg, place, own in (frame, *spec.parts()):
        arm = np.array(place) - about
        total += 2.0 * np.array(own) + mass_kg * (arm @ arm - arm**2)
    return total


def find_uphill_feet(chair: StaticChair, downhill: Vec2) -> frozenset[str]:
    """Names of the feet that carry nothing when the chair tips downhill.

    Sideways these are the feet of the upper side; forward and back all but those farthest downhill.
    """
    along = {
        foot.name: foot.centre_m[0] * downhill[0] + foot.centre_m[1] * downhill[1]
        for foot in chair.feet
    }
    sideways = abs(downhill[1]) > abs(downhill[0])
    least = 0.0 if sideways else max(along.values()) - _GROUP_M
    return frozenset(name for name, place_m in along.items() if place_m < least)


def compute_level_loads_N(chair: StaticChair) -> dict[str, float]:
    """Normal load of each foot on level ground. Raises PhysicsError when it does not stand."""
    level = _TiltedChair(chair, 0.0, FORWARD_DOWN)
    pose = level.solve_rest(_START_POSE)
    if pose is None:
        raise PhysicsError(_TIPS_AT_REST)
    return level.loads(pose)


def compute_tip_angle_rad(chair: StaticChair, downhill: Vec2) -> float:
    """Tilt of the table at which the uphill feet carry nothing, with springs and anti-tips.

    Args:
        chair: The chair.
        downhill: Unit vector in the table, from the chair's own x and y.

    Raises:
        PhysicsError: It does not tip below 60 degrees, or never stands.
    """
    # 1. Find the rest on level ground.
    upper = find_uphill_feet(chair, downhill)
    rest = partial(_rest_with_uphill_load, chair, downhill, upper)
    pose = rest(0.0, _START_POSE, (0.0,))
    if pose is None:
        raise PhysicsError(_TIPS_AT_REST)

    # 2. See whether the chair can lean: on a foot that hangs in the air, or on the stop of a beam.
    hanging = any(load == 0.0 for load in _TiltedChair(chair, 0.0, downhill).loads(pose).values())
    leans = _LEANS_RAD if hanging or any(foot.beam for foot in chair.feet) else (0.0,)

    # 3. Tilt on from each rest to the next, in halved steps where there is none.
    tilt = 0.0
    step = _COARSE_STEP_RAD
    while step > _FINE_STEP_RAD:
        after = rest(tilt + step, pose, leans)
        if after is None:
            step *= 0.5
        else:
            tilt += step
            pose = after
        if tilt > _MAX_TILT_RAD:
            raise PhysicsError(
                "the plant does not tip at 60 degrees; expected less: check its masses and wheels"
            )
    return tilt


def _rest_with_uphill_load(
    chair: StaticChair,
    downhill: Vec2,
    upper: frozenset[str],
    tilt_rad: float,
    pose: F64,
    leans_rad: tuple[float, ...],
) -> F64 | None:
    """A pose with a load on its uphill feet, near `pose` or leaning on an anti-tip or stop."""
    least_N = _LEAST_LOAD_SHARE * chair.mass_kg * GRAVITY_MPS2
    tilted = _TiltedChair(chair, tilt_rad, downhill)
    guesses = [pose - lean * np.array([0.0, *downhill]) for lean in leans_rad]
    if len(leans_rad) > 1:
        guesses += tilted.poses_after_falls()
    for guess in guesses:
        found = tilted.solve_rest(guess)
        if found is None:
            continue
        loads = tilted.loads(found)
        if sum(load for name, load in loads.items() if name in upper) > least_N:
            return found
    return None


class _TiltedChair:
    """The equations of one chair at one tilt; vectors over the edges of its feet."""

    def __init__(self, chair: StaticChair, tilt_rad: float, downhill: Vec2) -> None:
        edges = [
            (foot, edge, share)
            for foot in chair.feet
            for edge, share in _contact_edges(foot, downhill)
        ]
        self._names = [foot.name for foot, _, _ in edges]
        self._centre = np.array([edge for _, edge, _ in edges])
        self._axis = np.array([foot.axis for foot, _, _ in edges])
        self._radius = np.array([foot.radius_m for foot, _, _ in edges])
        self._share = np.array([share for _, _, share in edges])
        arms = [(foot.arm, foot.unsprung_kg) for foot, _, _ in edges]
        self._sprung = np.array([arm is not None for arm, _ in arms])
        numbers = [
            (arm.stiffness_Npm, arm.preload_N, -arm.down_m, arm.up_m, unsprung_kg)
            if arm
            else (1.0, 0.0, 0.0, 0.0, 0.0)
            for arm, unsprung_kg in arms
        ]
        self._stiff, self._preload, self._least, self._most, self._unsprung = np.array(numbers).T
        beams = [foot.beam for foot, _, _ in edges]
        self._beams = [
            (beam, np.array([b == beam for b in beams])) for beam in dict.fromkeys(beams) if beam
        ]
        self._mass_kg = chair.mass_kg
        self._weight_N = chair.mass_kg * GRAVITY_MPS2
        self._com = np.array(chair.com_m)
        self._down = np.array(downhill)
        self._cos = math.cos(tilt_rad)
        self._sin = math.sin(tilt_rad)

    def _contacts(self, pose: F64) -> tuple[F64, F64, F64]:
        """Lowest points (E, 3) in T, their normal loads (E,), and their arms' compressions (E,)."""
        turn = _rotation_TB(pose[1], pose[2])
        axis = self._axis @ turn.T
        # Straight down, but in the wheel's plane.
        low = axis * axis[:, 2:] - _UP
        place = self._centre @ turn.T + low * (self._radius / np.linalg.norm(low, axis=1))[:, None]
        depth = -(place[:, 2] + pose[0])
        for beam, carried in self._beams:
            depth[carried] -= self._rocked_m(
                beam, place[carried], depth[carried], self._share[carried], turn
            )
        firm = _TYRE_N_PER_M * np.maximum(depth, 0.0)
        load, compressed = self._sprung_loads(depth, turn[:, 2])
        place = place + np.where(self._sprung, compressed, 0.0)[:, None] * turn[:, 2]
        return place, self._share * np.where(self._sprung, load, firm), compressed

    def _rocked_m(self, beam: _Beam, place: F64, depth: F64, share: F64, turn: F64) -> F64:
        """How far a beam lifts its feet, (E,), at rest between them or leaning on a stop.

        Friction that holds the chair is taken in proportion to the load, as for arms.
        """
        axis, arm = turn[:, 0], place - beam.pivot_z_m * turn[:, 2]
        push = np.append(-self._sin / self._cos * self._down, 1.0)
        lift_m = np.cross(axis, arm)[:, 2]
        moment_m = np.cross(arm, push) @ axis
        firm = _TYRE_N_PER_M * share
        hangs = beam.weight_N * np.append(self._sin * self._down, -self._cos)
        own_Nm = (beam.com_z_m - beam.pivot_z_m) * float(np.cross(turn[:, 2], hangs) @ axis)

        def turned_Nm(angle_rad: float) -> float:
            return own_Nm + float((firm * np.maximum(depth - angle_rad * lift_m, 0.0)) @ moment_m)

        return lift_m * _root_of_falling(turned_Nm, beam.stop_rad, depth / lift_m)

    def _sprung_loads(self, depth: F64, arm: F64) -> tuple[F64, F64]:
        """Loads and compressions of sprung feet whose arms move along `arm`, a unit vector in T.

        The foot pushes its arm with its load and with its share of the friction that holds the
        chair, which is taken in proportion to the load.
        """
        along = arm[2] - self._sin / self._cos * (self._down @ arm[:2])
        hangs = GRAVITY_MPS2 * (self._cos * arm[2] - self._sin * (self._down @ arm[:2]))
        pushed = depth / arm[2]
        force = self._preload + self._unsprung * hangs + self._stiff * pushed
        force = force + _TYRE_N_PER_M * np.maximum(pushed - self._most, 0.0)
        hanging = np.maximum(-(self._preload + self._unsprung * hangs) / self._stiff, self._least)
        in_air = pushed < hanging
        load = np.where(in_air, 0.0, np.maximum(force, 0.0) / along)
        return load, np.where(in_air, hanging, pushed)

    def poses_after_falls(self) -> list[F64]:
        """The poses after a fall downhill from its lowest feet onto others, as onto anti-tips."""
        found = []
        for start in np.arange(0.0, _MAX_LEAN_RAD, _LEAN_STEP_RAD):
            low = float(start)
            high = float(start + _LEAN_STEP_RAD)
            first = self._lowest_edge(low)[0]
            if self._lowest_edge(high)[0] == first:
                continue
            while high - low > _LEAN_PRECISION_RAD:
                middle = 0.5 * (low + high)
                if self._lowest_edge(middle)[0] == first:
                    low = middle
                else:
                    high = middle
            found.append(_START_POSE + np.array([self._lowest_edge(low)[1], *(-low * self._down)]))
        return found

    def _lowest_edge(self, lean_rad: float) -> tuple[float, float]:
        """Place downhill, and lift of the chair, of the edge on which a leaning chair stands."""
        height = self._contacts(np.array([0.0, *(-lean_rad * self._down)]))[0][:, 2]
        lowest = int(np.argmin(height))
        return round(float(self._centre[lowest, :2] @ self._down), 3), -float(height[lowest])

    def solve_rest(self, pose: F64) -> F64 | None:
        """The stable rest that Newton's method finds from a pose, damped; None if there is none."""
        damping = 1e-6
        residual = self._residual(pose)
        slope = self._slope(pose, residual)
        for _ in range(_MAX_NEWTON_STEPS):
            size = float(np.linalg.norm(residual))
            if size < _TOLERANCE_SHARE * self._weight_N:
                # A rest is stable where every small move meets a push back.
                upright = bool(np.abs(pose[1:]).max() < _MAX_LEAN_RAD)
                return pose if upright and np.linalg.eigvalsh(slope + slope.T).max() < 0.0 else None
            try:
                move = np.linalg.solve(slope - damping * _TYRE_N_PER_M * np.eye(3), -residual)
            except np.linalg.LinAlgError:
                return None
            tried = self._residual(pose + move)
            if np.linalg.norm(tried) < size:
                pose = pose + move
                residual = tried
                damping = max(0.1 * damping, 1e-9)
                slope = self._slope(pose, residual)
            else:
                damping *= 10.0
                if damping > _MAX_DAMPING:
                    return None
        return None

    def _residual(self, pose: F64) -> F64:
        """What is missing to equilibrium: force along z, moments about y and x of T, (3,)."""
        place, load, compressed = self._contacts(pose)
        turn = _rotation_TB(pose[1], pose[2])
        com = (
            turn @ self._com
            + (self._share * self._unsprung * compressed).sum() / self._mass_kg * turn[:, 2]
        )
        lever = self._cos * com[:2] + self._sin * (com[2] + pose[0]) * self._down
        moment = (load[:, None] * place[:, :2]).sum(axis=0) - self._weight_N * lever
        return np.array([load.sum() - self._weight_N * self._cos, moment[0], moment[1]])

    def _slope(self, pose: F64, residual: F64) -> F64:
        """Derivatives of the residual by the pose, (3, 3)."""
        step = 1e-7
        return np.array(
            [(self._residual(pose + step * unit) - residual) / step for unit in np.eye(3)]
        ).T

    def loads(self, pose: F64) -> dict[str, float]:
        """Normal load of each foot."""
        sums = dict.fromkeys(self._names, 0.0)
        for name, load in zip(self._names, self._contacts(pose)[1], strict=True):
            sums[name] += float(load)
        return sums


def _contact_edges(foot: SupportFoot, downhill: Vec2) -> list[tuple[Vec3, float]]:
    """The edges on which a foot stands as the chair tips: the lower one, or both where level."""
    edges = _rim_edges(foot)
    along = [edge[0] * downhill[0] + edge[1] * downhill[1] for edge in edges]
    if abs(along[0] - along[1]) < _SAME_HEIGHT_M:
        return [(edge, 0.5) for edge in edges]
    return [(edges[along.index(max(along))], 1.0)]


def _rim_edges(foot: SupportFoot) -> tuple[Vec3, Vec3]:
    """The two ends of a foot's contact line on level ground, as places of B above the ground."""
    (x, y, z), (ax, ay, az), w = foot.centre_m, foot.axis, foot.half_width_m
    return (x + w * ax, y + w * ay, z + w * az), (x - w * ax, y - w * ay, z - w * az)


def _rotation_TB(pitch: float, roll: float) -> F64:
    """Rotation from B to T: nose up by `pitch`, then right side down by `roll`."""
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    nose = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    side = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(side @ nose)


def _root_of_falling(falling: Callable[[float], float], most: float, kinks: F64) -> float:
    """Where a function that falls in straight pieces between kinks is zero, within -most..most."""
    angles = sorted({-most, most, *(float(kink) for kink in kinks if abs(kink) < most)})
    values = [falling(angle) for angle in angles]
    if values[0] <= 0.0:
        return angles[0]
    for (a, high), (b, low) in pairwise(zip(angles, values, strict=True)):
        if low <= 0.0:
            return a + (b - a) * high / (high - low)
    return angles[-1]


def _rigid_tip_angle_rad(chair: StaticChair, downhill: Vec2) -> float:
    """Tilt at which the centre of mass stands above the tip line, every foot on the table.

    Nothing is sprung. The tip line is the edge of the feet's hull that lies downhill of the centre
    of mass.
    """
    dx, dy = downhill
    points = [
        (p[0] * dx + p[1] * dy, p[1] * dx - p[0] * dy)
        for foot in chair.feet
        for p in _rim_edges(foot)
    ]
    cx, cy, height_m = chair.com_m
    along, aside = cx * dx + cy * dy, cy * dx - cx * dy
    # Where the line downhill through the centre of mass crosses each line between two contacts: the
    # farthest crossing lies on the edge of the hull.
    reach = [
        a[0] + (b[0] - a[0]) * (aside - a[1]) / (b[1] - a[1])
        for a in points
        for b in points
        if a[1] <= aside < b[1] or b[1] < aside <= a[1]
    ]
    if not reach:
        raise PhysicsError(
            "the centre of mass is not above the feet; expected a plant that stands: "
            "check its numbers"
        )
    return math.atan2(max(reach) - along, height_m)


def _com_m(spec: PlantSpec, swivel_rad: float = 0.0) -> Vec3:
    """Centre of mass of chair and user in B; forks and casters move it a little when they turn."""
    x, y, z = spec.mass.com_x_m, 0.0, spec.mass.com_z_m
    turned_x, turned_y = 1.0 - math.cos(swivel_rad), -math.sin(swivel_rad)
    for pair in spec.casters:
        moment_kgm = 2.0 * pair.trail_m * (pair.mass_kg + 0.5 * pair.fork_mass_kg)
        x += moment_kgm * turned_x / spec.whole_kg
        y += moment_kgm * turned_y / spec.whole_kg
    return x, y, z


def _wheels(spec: PlantSpec) -> Iterator[SupportFoot]:
    wheel = spec.wheel
    for side, sign in _SIDES:
        yield SupportFoot(
            name=f"wheel_{side}",
            centre_m=(0.0, 0.5 * sign * wheel.track_m, wheel.radius_m),
            radius_m=wheel.radius_m,
            axis=(0.0, 1.0, 0.0),
            half_width_m=0.5 * wheel.width_m,
            friction=wheel.friction,
        )


def _casters(spec: PlantSpec, swivel_rad: float) -> Iterator[SupportFoot]:
    cos, sin = math.cos(swivel_rad), math.sin(swivel_rad)
    for number, pair in enumerate(spec.casters):
        for side, sign in _SIDES:
            hub = (
                pair.swivel_x_m - pair.trail_m * cos,
                0.5 * sign * pair.track_m - pair.trail_m * sin,
            )
            yield SupportFoot(
                name=f"caster_{number}_{side}",
                centre_m=(*hub, pair.radius_m),
                radius_m=pair.radius_m,
                axis=(-sin, cos, 0.0),
                half_width_m=0.5 * pair.width_m,
                friction=pair.friction,
                arm=pair.arm,
                unsprung_kg=pair.mass_kg
                + pair.fork_mass_kg
                + (pair.arm.mass_kg if pair.arm else 0.0),
                beam=_beam(pair),
            )


def _beam(pair: CasterPart) -> _Beam | None:
    if pair.beam is None:
        return None
    swivel_z_m = pair.radius_m + FORK_M
    parts = (
        (2.0 * pair.mass_kg, pair.radius_m),
        (2.0 * pair.fork_mass_kg, swivel_z_m - FORK_COM_M),
        (pair.beam.mass_kg, swivel_z_m),
    )
    mass_kg = sum(part for part, _ in parts)
    return _Beam(
        pivot_z_m=pair.beam.pivot_z_m,
        stop_rad=deg2rad(pair.beam.stop_deg),
        weight_N=mass_kg * GRAVITY_MPS2,
        com_z_m=sum(part * z_m for part, z_m in parts) / mass_kg,
    )


def _antitips(spec: PlantSpec) -> Iterator[SupportFoot]:
    for number, pair in enumerate(spec.antitips):
        for side, sign in _SIDES:
            x, y, z = pair.p_m
            name = f"antitip_{number}_{side}"
            yield SupportFoot(
                name=name, centre_m=(x, sign * y, z), radius_m=pair.radius_m, friction=pair.friction
            )

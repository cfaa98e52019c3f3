"""The wheelchair as it is built: the parameters of its file, and the geometry they lead to.

Body frame B: x forward, y left, z up, origin on the ground below the middle of the drive axle.
Whether a plant can be built and stand, and where a camera may sit on it, is checked before anything
moves; a refusal has the value, its unit and its bounds.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Final

from wcsim.config import CameraConfig, ChairConfig
from wcsim.config.plant import CasterPart, PlantFile, override_plant_values, read_plant
from wcsim.core.frames import Vec3
from wcsim.errors import ConfigError
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.types import Outline

_LEAST_FRAME_KG: Final = 30.0
_MOST_PUSH: Final = 0.8  # of the weight, by the springs of all casters
MARGIN_M: Final = 0.01  # by which the centre of mass must lie inside the wheels' support
DIP_M: Final = 0.05  # a chair that brakes, or rolls over an edge, dips its footplate by so much
HIGHEST_STEP_M: Final = 0.2  # of kerbs
# A low part is taken to be larger by so much: the edges of kerbs are known to a centimetre.
MORE_M: Final = 0.01
FORK_M: Final = 0.10  # a fork's swivel lies this far above the middle of its caster
FORK_COM_M: Final = 0.05  # and its centre of mass this far below the swivel
ARM_INERTIA_KGM2: Final = 0.01  # small beside everything else
_BEAM_INERTIA_KGM2: Final = 0.01  # about its length, small too
_LIMITS: Final = (
    ("v_max_mps", "speed_mps", "m/s"),
    ("accel_mps2", "accel_mps2", "m/s2"),
    ("decel_mps2", "decel_mps2", "m/s2"),
    ("jerk_mps3", "jerk_mps3", "m/s3"),
    ("yaw_rate_max_radps", "yaw_rate_radps", "rad/s"),
    ("yaw_accel_radps2", "yaw_accel_radps2", "rad/s2"),
)


class PlantSpec(PlantFile):
    """A chair with its user, and what follows from its file; `plant_spec` and `varied` check it."""

    @property
    def whole_kg(self) -> float:
        """Mass of chair and user, kg."""
        return self.mass.chair_kg + self.mass.user_kg

    @property
    def frame_mass_kg(self) -> float:
        """Mass of the base link: everything but wheels, forks, arms, beams and anti-tips."""
        return self.whole_kg - sum(mass for mass, _, _ in self.parts())

    @property
    def frame_com_m(self) -> Vec3:
        """Centre of mass of the base link in B; with it that of the whole is as in the file."""
        parts = self.parts()
        x = self.whole_kg * self.mass.com_x_m - sum(mass * p[0] for mass, p, _ in parts)
        z = self.whole_kg * self.mass.com_z_m - sum(mass * p[2] for mass, p, _ in parts)
        return x / self.frame_mass_kg, 0.0, z / self.frame_mass_kg

    @property
    def frame_inertia_kgm2(self) -> Vec3:
        """Principal moments of inertia of the base link about its centre of mass."""
        x, y, z = self.mass.inertia_box_m
        k = self.frame_mass_kg / 12.0
        return k * (y * y + z * z), k * (x * x + z * z), k * (x * x + y * y)

    @property
    def outline(self) -> Outline:
        """The box around everything on the chair and its user, casters trailing."""
        wheel = self.wheel
        front, back = [wheel.radius_m], [-wheel.radius_m]
        side = [0.5 * (wheel.track_m + wheel.width_m)]
        for box in self.frame.boxes:
            front.append(box.centre_m[0] + 0.5 * box.size_m[0])
            back.append(box.centre_m[0] - 0.5 * box.size_m[0])
            side.append(abs(box.centre_m[1]) + 0.5 * box.size_m[1])
        for pair in self.casters:
            front.append(pair.swivel_x_m - pair.trail_m + pair.radius_m)
            back.append(pair.swivel_x_m - pair.trail_m - pair.radius_m)
            side.append(0.5 * (pair.track_m + pair.width_m))
        for antitip in self.antitips:
            front.append(antitip.p_m[0] + antitip.radius_m)
            back.append(antitip.p_m[0] - antitip.radius_m)
            side.append(antitip.p_m[1] + antitip.radius_m)
        return Outline(
            length_m=max(front) - min(back),
            width_m=2.0 * max(side),
            height_m=self.frame.height_m,
            middle_x_m=0.5 * (max(front) + min(back)),
        )

    @property
    def footplate_from_x_m(self) -> float:
        """Contacts of the frame ahead of this x in B are the footplate's; infinite without one."""
        backs, fronts = [], []
        for box in self.frame.boxes:
            if box.part == "footplate":
                backs.append(box.centre_m[0] - 0.5 * box.size_m[0])
            else:
                fronts.append(box.centre_m[0] + 0.5 * box.size_m[0])
        back = min(backs, default=math.inf)
        return 0.5 * (back + max(fronts, default=back))

    def stand_m(self) -> tuple[tuple[float, float], ...]:
        """Where drive wheels and trailing casters touch the ground, in B; left first in a pair."""
        pairs = [(0.0, self.wheel.track_m)]
        pairs += [(pair.swivel_x_m - pair.trail_m, pair.track_m) for pair in self.casters]
        return tuple((x, side * 0.5 * track) for x, track in pairs for side in (1.0, -1.0))

    def trails_m(self) -> tuple[float, ...]:
        """How far behind its swivel each of the wheels of `stand_m` is; 0 of a drive wheel."""
        return (0.0, 0.0, *(pair.trail_m for pair in self.casters for _ in range(2)))

    def wheels_m(self) -> tuple[tuple[float, float, float], ...]:
        """Place in B (x, y) and radius of every drive wheel and trailing caster."""
        radii_m = (self.wheel.radius_m, *(pair.radius_m for pair in self.casters))
        return tuple((x, y, radii_m[number // 2]) for number, (x, y) in enumerate(self.stand_m()))

    def rims_m(self) -> tuple[tuple[float, float, float], ...]:
        """What can meet a step of the ground: places in B (x, y), each with the highest step.

        A low part of the frame takes a step that its underside clears while the chair pitches. Its
        places are its corners and the middles of its sides.
        """
        found = []
        for box in self.frame.boxes:
            (x, y, z), (length, width, height) = box.centre_m, box.size_m
            length += 2.0 * MORE_M
            width += 2.0 * MORE_M
            takes_m = z - 0.5 * height - DIP_M
            if takes_m < HIGHEST_STEP_M:
                sides = product((-0.5, 0.0, 0.5), repeat=2)
                found += [(x + i * length, y + k * width, takes_m) for i, k in sides if i or k]
        return tuple(found)

    def spring_balance(self) -> tuple[float, float, float] | None:
        """Moment of the weight on the springs, their stiffness and damping against a pitch, in Nm.

        None for a chair that a rigid caster holds level.
        """
        moment_Nm = self.whole_kg * GRAVITY_MPS2 * self.mass.com_x_m
        stiffness_Nm = damping_Nms = 0.0
        for pair in self.casters:
            if pair.arm is None:
                return None
            x_m = pair.swivel_x_m - pair.trail_m
            unsprung_N = (pair.mass_kg + pair.fork_mass_kg + pair.arm.mass_kg) * GRAVITY_MPS2
            moment_Nm -= 2.0 * x_m * (pair.arm.preload_N + unsprung_N)
            stiffness_Nm += 2.0 * pair.arm.stiffness_Npm * x_m * x_m
            damping_Nms += 2.0 * pair.arm.damping_Nspm * x_m * x_m
        return moment_Nm, stiffness_Nm, damping_Nms

    @property
    def drive_inertia_kgm2(self) -> Vec3:
        """Principal moments of inertia of a drive wheel with its motor's rotor; its axle is y."""
        across, along, _ = disc_inertia_kgm2(
            self.wheel.mass_kg, self.wheel.radius_m, self.wheel.width_m
        )
        return across, along + self.motor.rotor_inertia_kgm2, across

    def parts(self) -> list[tuple[float, Vec3, Vec3]]:
        """The pairs of parts on the frame, casters trailing: mass, middle of the left, its inertia.

        The mass is that of both, the inertia that of one, about its middle along B's axes. A beam
        is a pair of halves.
        """
        wheel = self.wheel
        hub_m = 0.0, 0.5 * wheel.track_m, wheel.radius_m
        parts = [(2.0 * wheel.mass_kg, hub_m, self.drive_inertia_kgm2)]
        for pair in self.casters:
            x_m, y_m, z_m = pair.swivel_x_m, 0.5 * pair.track_m, pair.radius_m + FORK_M
            disc = disc_inertia_kgm2(pair.mass_kg, pair.radius_m, pair.width_m)
            fork_m = (x_m - 0.5 * pair.trail_m, y_m, z_m - FORK_COM_M)
            parts += [
                (2.0 * pair.mass_kg, (x_m - pair.trail_m, y_m, pair.radius_m), disc),
                (2.0 * pair.fork_mass_kg, fork_m, (pair.fork_inertia_kgm2,) * 3),
            ]
            if pair.arm is not None:
                parts.append((2.0 * pair.arm.mass_kg, (x_m, y_m, z_m), (ARM_INERTIA_KGM2,) * 3))
            if pair.beam is not None:
                across, along, _ = beam_inertia_kgm2(pair.beam.mass_kg, pair.track_m)
                half = 0.5 * across, 0.5 * along, 0.5 * across
                parts.append((pair.beam.mass_kg, (x_m, 0.0, z_m), half))
        parts += [
            (2.0 * item.mass_kg, item.p_m, (item.inertia_kgm2,) * 3) for item in self.antitips
        ]
        return parts


def plant_spec(chair: ChairConfig) -> PlantSpec:
    """The plant that `chair` names, with its user's mass and height of the centre of mass.

    Raises:
        ConfigError: The plant is unknown, a parameter is out of bounds, it cannot stand, or `chair`
            sets the controller beyond the plant's limits.
    """
    file = read_plant(chair.plant)
    own = {"mass.user_kg": chair.user_mass_kg, "mass.com_z_m": chair.com_height_m}
    given = {name: value for name, value in own.items() if value is not None}
    file = override_plant_values(file, given)
    for key, limit, unit in _LIMITS:
        value, most = getattr(chair, key), getattr(file.limits, limit)
        if value > most:
            raise ConfigError(
                f"chair.{key} is {value} {unit}, limits.{limit} of plant {chair.plant!r} is "
                f"{most}; expected no more"
            )
    return _checked(file, chair.plant)


def varied(spec: PlantSpec, values: Mapping[str, float]) -> PlantSpec:
    """The plant with other values under the dotted names of its file; `*` is each pair of a list.

    Args:
        spec: The plant to start from.
        values: New values by name, such as `{"mass.user_kg": 95.0, "casters.*.friction": 0.4}`.

    Raises:
        ConfigError: A name is unknown, a value is out of bounds, or the plant cannot stand.
    """
    return _checked(override_plant_values(spec, values), "varied")


def refuse_cameras_inside(
    cameras: Sequence[CameraConfig], spec: PlantSpec, shift_m: tuple[float, float] = (0.0, 0.0)
) -> None:
    """Check that no camera sits inside the chair or its user.

    Args:
        cameras: In their places.
        spec: The chair.
        shift_m: From so much to so much each may be shifted along every axis. Boxes are taken to be
            larger by that: a place is in one if the shifted one can be.

    Raises:
        ConfigError: One does; names the camera, its place and the box.
    """
    least_m, most_m = shift_m
    middle_m, more_m = 0.5 * (least_m + most_m), most_m - least_m
    for camera in cameras:
        for box in spec.frame.boxes:
            sides = [
                (c - middle_m, s + more_m) for c, s in zip(box.centre_m, box.size_m, strict=True)
            ]
            if all(abs(p - c) < 0.5 * s for p, (c, s) in zip(camera.p_BC_m, sides, strict=True)):
                spans = ", ".join(
                    f"{axis} {c - 0.5 * s:.2f} to {c + 0.5 * s:.2f} m"
                    for axis, (c, s) in zip("xyz", sides, strict=True)
                )
                place = ", ".join(f"{p:g}" for p in camera.p_BC_m)
                raise ConfigError(
                    f"camera {camera.name!r} at p_BC_m ({place}) m is inside the chair's body, the "
                    f"box {spans}; expected a place outside: move it"
                )


def disc_inertia_kgm2(mass_kg: float, radius_m: float, width_m: float) -> Vec3:
    """Principal moments of inertia of a disc whose axle is y."""
    across = mass_kg * (3.0 * radius_m**2 + width_m**2) / 12.0
    return across, 0.5 * mass_kg * radius_m**2, across


def beam_inertia_kgm2(mass_kg: float, track_m: float) -> Vec3:
    """Those of a rod as long as its pair's track, across the chair."""
    long = mass_kg * track_m**2 / 12.0
    # Bullet takes an inertia that no body can have for none.
    return long, min(_BEAM_INERTIA_KGM2, long), long


def _checked(file: PlantFile, name: str) -> PlantSpec:
    spec = PlantSpec(**dict(file))
    _check_plant(spec, name)
    return spec


def _check_plant(spec: PlantSpec, name: str) -> None:
    """Raise ConfigError with everything about a plant, called `name`, that cannot be."""
    faults = []
    # 1. The mass that is left for the frame.
    if spec.frame_mass_kg < _LEAST_FRAME_KG:
        faults.append(
            f"wheels, casters, arms, beams and anti-tips leave {spec.frame_mass_kg:.1f} kg for "
            f"frame and user; expected at least {_LEAST_FRAME_KG:g} kg: raise mass.chair_kg "
            f"({spec.mass.chair_kg:g} kg)"
        )
    elif spec.frame_com_m[2] <= 0.0:
        faults.append(
            f"mass.com_z_m {spec.mass.com_z_m:g} m puts the frame's centre of mass below the "
            "ground; expected higher"
        )
    # 2. The support from front to back, casters turned the worst way. The drive wheels, left and
    # right, carry it sideways.
    front_m = max([0.0, *(pair.swivel_x_m - pair.trail_m for pair in spec.casters)])
    rear_m = min([0.0, *(pair.swivel_x_m + pair.trail_m for pair in spec.casters)])
    low, high = rear_m + MARGIN_M, front_m - MARGIN_M
    if not low <= spec.mass.com_x_m <= high:
        faults.append(
            f"mass.com_x_m is {spec.mass.com_x_m:g} m: it tips at rest; expected {low:.3f} to "
            f"{high:.3f} m, between the wheels with the casters turned the worst way"
        )
    # 3. The casters. A pair hangs on arms or on a beam, not on both.
    faults += _springs(spec)
    faults += [
        f"casters.{number} has an arm and a beam; expected one of them"
        for number, pair in enumerate(spec.casters)
        if pair.arm is not None and pair.beam is not None
    ]
    faults += _above_ground(spec)
    faults += _apart(spec)
    if faults:
        raise ConfigError(f"plant {name!r}: " + "; ".join(faults))


def _springs(spec: PlantSpec) -> Iterator[str]:
    """Sprung casters must neither lift the drive wheels off the ground nor lean on their stops."""
    push_N = sum(2.0 * pair.arm.preload_N for pair in spec.casters if pair.arm is not None)
    most_N = _MOST_PUSH * (spec.whole_kg * GRAVITY_MPS2)
    if push_N > most_N:
        yield (
            f"the arms' preload_N push with {push_N:.0f} N together; expected at most "
            f"{_MOST_PUSH:.0%} of the weight, {most_N:.0f} N, or the drive wheels hang in the air"
        )
    balance = spec.spring_balance()
    if balance is None:
        return
    moment_Nm, stiffness_Nm, _ = balance
    for number, pair in enumerate(spec.casters):
        arm, up_m = pair.arm, moment_Nm / stiffness_Nm * (pair.swivel_x_m - pair.trail_m)
        if arm is not None and not -arm.down_m < up_m < arm.up_m:
            yield (
                f"casters.{number}.arm stands {1000 * up_m:.0f} mm up at rest; expected between "
                f"{-1000 * arm.down_m:.0f} and {1000 * arm.up_m:.0f} mm: change preload_N or "
                "stiffness_Npm"
            )


def _above_ground(file: PlantFile) -> Iterator[str]:
    for number, item in enumerate(file.antitips):
        bottom_m = item.p_m[2] - item.radius_m
        if bottom_m < 0.0:
            yield (
                f"antitips.{number}.p_m: its bottom lies at {bottom_m:.3f} m; expected 0 m or more "
                "above the ground"
            )
    for number, box in enumerate(file.frame.boxes):
        bottom_m = box.centre_m[2] - 0.5 * box.size_m[2]
        if bottom_m <= 0.0:
            yield (
                f"frame.boxes.{number}: its bottom lies at {bottom_m:.3f} m; expected above the "
                "ground"
            )
    top_m = max(box.centre_m[2] + 0.5 * box.size_m[2] for box in file.frame.boxes)
    if top_m > file.frame.height_m:
        yield (
            f"frame.height_m is {file.frame.height_m:g} m; expected at least the highest box, "
            f"{top_m:.3f} m"
        )


def _apart(file: PlantFile) -> Iterator[str]:
    """Wheels must not meet, however the casters turn."""
    wheel = file.wheel
    if wheel.width_m >= wheel.track_m:
        yield (
            f"wheel.width_m is {wheel.width_m:g} m; expected less than wheel.track_m, "
            f"{wheel.track_m:g} m"
        )
    inner_m = 0.5 * (wheel.track_m - wheel.width_m)
    for number, pair in enumerate(file.casters):
        sweep_m = _sweep_m(pair)
        if pair.track_m < 2.0 * sweep_m:
            yield (
                f"casters.{number}.track_m is {pair.track_m:g} m; expected {2 * sweep_m:.3f} m or "
                "more, or both meet"
            )
        gap_m = abs(pair.swivel_x_m) - sweep_m - wheel.radius_m
        if gap_m < 0.0 and 0.5 * pair.track_m + sweep_m > inner_m:
            yield (
                f"casters.{number}.swivel_x_m is {pair.swivel_x_m:g} m: the turning caster meets "
                f"the drive wheel; expected {wheel.radius_m + sweep_m:.3f} m or more from the axle"
            )
    for (i, one), (k, other) in combinations(enumerate(file.casters), 2):
        least_m = _sweep_m(one) + _sweep_m(other)
        apart_m = math.hypot(one.swivel_x_m - other.swivel_x_m, 0.5 * (one.track_m - other.track_m))
        if apart_m < least_m:
            yield (
                f"casters.{i} and casters.{k} are {apart_m:.3f} m apart; expected {least_m:.3f} m, "
                "or they meet"
            )


def _sweep_m(pair: CasterPart) -> float:
    """Radius of the circle that a turning caster needs."""
    return math.hypot(pair.trail_m + pair.radius_m, 0.5 * pair.width_m)

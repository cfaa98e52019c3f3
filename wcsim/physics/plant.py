"""The wheelchair as rigid bodies: every number of a plant in one object, and its URDF text.

Body frame B: x forward, y left, z up, origin on the ground below the middle of the drive axle. The numbers of the
rear-wheel-drive chair are typical of a powered chair for in- and outdoors with a grown-up user.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from wcsim.config import ChairConfig
from wcsim.errors import ConfigError

Vec3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A collision box of the frame, in B."""

    centre_m: Vec3
    size_m: Vec3


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSpec:
    """A rear-wheel-drive chair with its user: two drive wheels, two swivelling casters, two anti-tips.

    The wheels' friction is multiplied by that of the ground, which is 1. Swivel friction is the bearing's torque.
    """

    # masses: chair and user together, wheels and forks included in the chair
    chair_mass_kg: float = 110.0
    user_mass_kg: float = 80.0
    com_x_m: float = 0.18  # of chair and user, ahead of the drive axle
    com_z_m: float = 0.50
    inertia_box_m: Vec3 = (0.7, 0.5, 0.9)  # the frame and user resist turning like a box of this size
    # drive wheels
    wheel_radius_m: float = 0.178
    wheel_width_m: float = 0.08
    wheel_mass_kg: float = 8.0
    track_m: float = 0.54
    # casters
    caster_radius_m: float = 0.10
    caster_width_m: float = 0.05
    caster_mass_kg: float = 1.5
    caster_track_m: float = 0.50
    trail_m: float = 0.06
    wheelbase_m: float = 0.50  # drive axle to swivel axis
    fork_mass_kg: float = 1.0
    fork_inertia_kgm2: float = 0.004
    swivel_friction_Nm: float = 0.5
    # anti-tips
    antitip_radius_m: float = 0.035
    antitip_p_m: Vec3 = (-0.30, 0.18, 0.07)  # the left one
    antitip_mass_kg: float = 0.3
    antitip_inertia_kgm2: float = 0.001
    # frame
    seat: Box = Box(centre_m=(0.18, 0.0, 0.42), size_m=(0.70, 0.44, 0.36))
    footplate: Box = Box(centre_m=(0.70, 0.0, 0.14), size_m=(0.20, 0.36, 0.04))
    torso: Box = Box(centre_m=(0.05, 0.0, 0.85), size_m=(0.35, 0.44, 0.60))
    # contact
    wheel_friction: float = 0.9
    caster_friction: float = 0.72
    antitip_friction: float = 0.05
    frame_friction: float = 0.5
    # motors: what a 24 V permanent-magnet motor with gearbox gives at a wheel
    stall_torque_Nm: float = 90.0
    no_load_radps: float = 24.0
    least_torque_share: float = 0.15
    brake_torque_Nm: float = 150.0  # spring-applied parking brake

    def stand_m(self) -> tuple[tuple[float, float], ...]:
        """Where the drive wheels and the trailing casters touch the ground, in B."""
        caster_x_m = self.wheelbase_m - self.trail_m
        return tuple(
            (x, side * 0.5 * track)
            for x, track in ((0.0, self.track_m), (caster_x_m, self.caster_track_m))
            for side in (1.0, -1.0)
        )

    @property
    def frame_mass_kg(self) -> float:
        """Mass of the base link: everything but wheels, forks and anti-tips."""
        return self.chair_mass_kg + self.user_mass_kg - sum(mass for mass, _ in self._moving_parts())

    @property
    def frame_com_m(self) -> Vec3:
        """Centre of mass of the base link in B, such that that of the whole is (com_x_m, 0, com_z_m)."""
        whole_kg = self.chair_mass_kg + self.user_mass_kg
        parts = self._moving_parts()
        x = whole_kg * self.com_x_m - sum(mass * p[0] for mass, p in parts)
        z = whole_kg * self.com_z_m - sum(mass * p[2] for mass, p in parts)
        return x / self.frame_mass_kg, 0.0, z / self.frame_mass_kg

    @property
    def footplate_from_x_m(self) -> float:
        """Contacts of the frame ahead of this x in B are the footplate's."""
        seat_front = self.seat.centre_m[0] + 0.5 * self.seat.size_m[0]
        return 0.5 * (seat_front + self.footplate.centre_m[0] - 0.5 * self.footplate.size_m[0])

    def _moving_parts(self) -> tuple[tuple[float, Vec3], ...]:
        caster_x = self.wheelbase_m - self.trail_m
        return (
            (2 * self.wheel_mass_kg, (0.0, 0.0, self.wheel_radius_m)),
            (2 * self.caster_mass_kg, (caster_x, 0.0, self.caster_radius_m)),
            (2 * self.fork_mass_kg, (self.wheelbase_m - 0.5 * self.trail_m, 0.0, self._fork_z_m - 0.05)),
            (2 * self.antitip_mass_kg, (self.antitip_p_m[0], 0.0, self.antitip_p_m[2])),
        )

    @property
    def _fork_z_m(self) -> float:
        return self.caster_radius_m + 0.10


def rear_wheel_drive(chair: ChairConfig) -> PlantSpec:
    """The rear-wheel-drive chair with the user of `chair`."""
    return PlantSpec(user_mass_kg=chair.user_mass_kg, com_z_m=chair.com_height_m)


PLANTS: Final[dict[str, Callable[[ChairConfig], PlantSpec]]] = {"rwd": rear_wheel_drive}


def plant_spec(chair: ChairConfig) -> PlantSpec:
    """The plant that `chair` names. Raises ConfigError for an unknown name."""
    make = PLANTS.get(chair.plant)
    if make is None:
        raise ConfigError(f"chair.plant is {chair.plant!r}; expected one of: {', '.join(sorted(PLANTS))}")
    return make(chair)


def urdf(spec: PlantSpec) -> str:
    """The plant as URDF text; joints are named wheel_l, swivel_l, caster_l, antitip_l and the same with _r."""
    links = (_frame(spec), *_wheels(spec), *_casters(spec), *_antitips(spec))
    return "\n".join(('<robot name="wheelchair">', *links, "</robot>"))


def _frame(spec: PlantSpec) -> str:
    x, y, z = spec.inertia_box_m
    k = spec.frame_mass_kg / 12.0
    inertia = (k * (y * y + z * z), k * (x * x + z * z), k * (x * x + y * y))
    boxes = "".join(
        f'<collision><origin xyz="{_text(box.centre_m)}"/>'
        f'<geometry><box size="{_text(box.size_m)}"/></geometry></collision>'
        for box in (spec.seat, spec.footplate, spec.torso)
    )
    return f'<link name="frame">{_inertial(spec.frame_mass_kg, inertia, spec.frame_com_m)}{boxes}</link>'


def _wheels(spec: PlantSpec) -> Iterator[str]:
    for side, sign in _SIDES:
        yield _rolling(f"wheel_{side}", spec.wheel_mass_kg, spec.wheel_radius_m, spec.wheel_width_m)
        at = (0.0, sign * 0.5 * spec.track_m, spec.wheel_radius_m)
        yield _joint(f"wheel_{side}", "frame", at, axis="0 1 0")


def _casters(spec: PlantSpec) -> Iterator[str]:
    inertia = (spec.fork_inertia_kgm2,) * 3
    for side, sign in _SIDES:
        com = (-0.5 * spec.trail_m, 0.0, -0.05)
        yield f'<link name="swivel_{side}">{_inertial(spec.fork_mass_kg, inertia, com)}</link>'
        at = (spec.wheelbase_m, sign * 0.5 * spec.caster_track_m, spec.caster_radius_m + 0.10)
        yield _joint(f"swivel_{side}", "frame", at, axis="0 0 1")
        yield _rolling(f"caster_{side}", spec.caster_mass_kg, spec.caster_radius_m, spec.caster_width_m)
        yield _joint(f"caster_{side}", f"swivel_{side}", (-spec.trail_m, 0.0, -0.10), axis="0 1 0")


def _antitips(spec: PlantSpec) -> Iterator[str]:
    shape = f'<collision><geometry><sphere radius="{spec.antitip_radius_m}"/></geometry></collision>'
    inertial = _inertial(spec.antitip_mass_kg, (spec.antitip_inertia_kgm2,) * 3, (0.0, 0.0, 0.0))
    x, y, z = spec.antitip_p_m
    for side, sign in _SIDES:
        yield f'<link name="antitip_{side}">{inertial}{shape}</link>'
        yield _joint(f"antitip_{side}", "frame", (x, sign * y, z), axis=None)


_SIDES: Final = (("l", 1.0), ("r", -1.0))


def _rolling(name: str, mass_kg: float, radius_m: float, width_m: float) -> str:
    across = mass_kg * (3.0 * radius_m**2 + width_m**2) / 12.0
    inertia = (across, 0.5 * mass_kg * radius_m**2, across)
    return (
        f'<link name="{name}">{_inertial(mass_kg, inertia, (0.0, 0.0, 0.0))}'
        '<collision><origin rpy="1.5707963267948966 0 0"/>'
        f'<geometry><cylinder radius="{radius_m}" length="{width_m}"/></geometry></collision></link>'
    )


def _joint(child: str, parent: str, at_m: Vec3, axis: str | None) -> str:
    kind = "continuous" if axis else "fixed"
    turns = f'<axis xyz="{axis}"/>' if axis else ""
    return (
        f'<joint name="{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(at_m)}"/>{turns}</joint>'
    )


def _inertial(mass_kg: float, inertia_kgm2: Vec3, com_m: Vec3) -> str:
    xx, yy, zz = inertia_kgm2
    return (
        f'<inertial><origin xyz="{_text(com_m)}"/><mass value="{mass_kg}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _text(vector: Vec3) -> str:
    return " ".join(repr(float(value)) for value in vector)

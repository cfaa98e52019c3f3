"""The wheelchair as it is built: every parameter of its file, and the geometry that follows from them.

Body frame B: x forward, y left, z up, origin on the ground below the middle of the drive axle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

from wcsim.config import ChairConfig
from wcsim.config.plant import (
    AntitipPart,
    CasterPart,
    ClimbPart,
    FramePart,
    LimitPart,
    MassPart,
    MotorPart,
    PlantFile,
    WheelPart,
    read_plant,
    with_values,
)
from wcsim.errors import ConfigError
from wcsim.physics.wheelchair.plant_check import check_plant
from wcsim.types import Outline

Vec3 = tuple[float, float, float]
FORK_M: Final = 0.10  # a fork's swivel lies this far above the middle of its caster
FORK_COM_M: Final = 0.05  # and its centre of mass this far below the swivel
_LIMITS: Final = (
    ("v_max_mps", "speed_mps", "m/s"),
    ("accel_mps2", "accel_mps2", "m/s2"),
    ("decel_mps2", "decel_mps2", "m/s2"),
    ("jerk_mps3", "jerk_mps3", "m/s3"),
    ("yaw_rate_max_radps", "yaw_rate_radps", "rad/s"),
    ("yaw_accel_radps2", "yaw_accel_radps2", "rad/s2"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSpec:
    """A chair with its user; made by `plant_spec` and `varied`, which check it."""

    shows: str
    mass: MassPart
    wheel: WheelPart
    casters: tuple[CasterPart, ...]
    antitips: tuple[AntitipPart, ...]
    frame: FramePart
    motor: MotorPart
    limits: LimitPart
    climbs: ClimbPart

    @property
    def whole_kg(self) -> float:
        """Mass of chair and user."""
        return self.mass.chair_kg + self.mass.user_kg

    @property
    def frame_mass_kg(self) -> float:
        """Mass of the base link: everything but wheels, forks, arms, beams and anti-tips."""
        return self.whole_kg - sum(mass for mass, _ in self._parts())

    @property
    def frame_com_m(self) -> Vec3:
        """Centre of mass of the base link in B, such that that of the whole is (com_x_m, 0, com_z_m)."""
        parts = self._parts()
        x = self.whole_kg * self.mass.com_x_m - sum(mass * p[0] for mass, p in parts)
        z = self.whole_kg * self.mass.com_z_m - sum(mass * p[2] for mass, p in parts)
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
        boxes = self.frame.boxes
        wheel = self.wheel
        front = [box.centre_m[0] + 0.5 * box.size_m[0] for box in boxes] + [wheel.radius_m]
        back = [box.centre_m[0] - 0.5 * box.size_m[0] for box in boxes] + [-wheel.radius_m]
        side = [abs(box.centre_m[1]) + 0.5 * box.size_m[1] for box in boxes]
        side += [0.5 * (wheel.track_m + wheel.width_m)]
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
        """Contacts of the frame ahead of this x in B are the footplate's; infinite for a chair without one."""
        ends = [
            (box.part == "footplate", box.centre_m[0] - 0.5 * box.size_m[0], box.centre_m[0] + 0.5 * box.size_m[0])
            for box in self.frame.boxes
        ]
        plates = [back for footplate, back, _ in ends if footplate]
        if not plates:
            return float("inf")
        bodies = [front for footplate, _, front in ends if not footplate]
        return 0.5 * (min(plates) + max(bodies, default=min(plates)))

    def stand_m(self) -> tuple[tuple[float, float], ...]:
        """Where the drive wheels and the trailing casters touch the ground, in B, left and right of each pair."""
        pairs = [(0.0, self.wheel.track_m)]
        pairs += [(pair.swivel_x_m - pair.trail_m, pair.track_m) for pair in self.casters]
        return tuple((x, side * 0.5 * track) for x, track in pairs for side in (1.0, -1.0))

    def wheels_m(self) -> tuple[tuple[float, float, float], ...]:
        """Place in B (x, y) and radius of every drive wheel and trailing caster."""
        radii_m = (self.wheel.radius_m, *(pair.radius_m for pair in self.casters))
        return tuple((x, y, radii_m[number // 2]) for number, (x, y) in enumerate(self.stand_m()))

    def _parts(self) -> list[tuple[float, Vec3]]:
        """Mass of each pair of parts that the frame carries, and its middle in B with the casters trailing."""
        parts = [(2.0 * self.wheel.mass_kg, (0.0, 0.0, self.wheel.radius_m))]
        for pair in self.casters:
            swivel_z_m = pair.radius_m + FORK_M
            parts += [
                (2.0 * pair.mass_kg, (pair.swivel_x_m - pair.trail_m, 0.0, pair.radius_m)),
                (2.0 * pair.fork_mass_kg, (pair.swivel_x_m - 0.5 * pair.trail_m, 0.0, swivel_z_m - FORK_COM_M)),
            ]
            if pair.arm is not None:
                parts.append((2.0 * pair.arm.mass_kg, (pair.swivel_x_m, 0.0, swivel_z_m)))
            if pair.beam is not None:
                parts.append((pair.beam.mass_kg, (pair.swivel_x_m, 0.0, swivel_z_m)))
        parts += [(2.0 * item.mass_kg, (item.p_m[0], 0.0, item.p_m[2])) for item in self.antitips]
        return parts


def plant_spec(chair: ChairConfig) -> PlantSpec:
    """The plant that `chair` names, with the user's mass and the height of the centre of mass that it sets.

    Raises:
        ConfigError: The plant is unknown, a parameter is out of bounds, it cannot stand, or `chair` sets the controller
            beyond the plant's limits.
    """
    file = read_plant(chair.plant)
    own = {"mass.user_kg": chair.user_mass_kg, "mass.com_z_m": chair.com_height_m}
    file = with_values(file, {name: value for name, value in own.items() if value is not None})
    for key, limit, unit in _LIMITS:
        got, most = getattr(chair, key), getattr(file.limits, limit)
        if got > most:
            raise ConfigError(
                f"chair.{key} is {got} {unit}, limits.{limit} of plant {chair.plant!r} is {most}; expected no more"
            )
    return _checked(file, chair.plant)


def varied(spec: PlantSpec, values: Mapping[str, float]) -> PlantSpec:
    """The plant with other values under the dotted names of its file; `*` stands for every pair of a list.

    Args:
        spec: The plant to start from.
        values: New values by name, such as `{"mass.user_kg": 95.0, "casters.*.friction": 0.4}`.

    Raises:
        ConfigError: A name is unknown, a value is out of bounds, or the plant cannot stand.
    """
    file = PlantFile(**{item.name: getattr(spec, item.name) for item in fields(spec)})
    return _checked(with_values(file, values), "varied")


def _checked(file: PlantFile, name: str) -> PlantSpec:
    spec = PlantSpec(**{item.name: getattr(file, item.name) for item in fields(PlantSpec)})
    check_plant(file, spec.frame_mass_kg, spec.frame_com_m[2], name)
    return spec


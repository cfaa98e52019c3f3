"""A wheelchair's parameter file, as frozen models; an unknown key is refused.

Lengths are in the body frame B: x forward, y left, z up, origin on the ground below the middle of
the drive axle. Wheels, casters and anti-tips come in pairs, left and right alike. The files of
wcsim lie in `wcsim/config/plants/`.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from wcsim.config import ChairConfig, Model, Text, parse, read_toml
from wcsim.config.base import Share, TopSpeed, UserMass, within
from wcsim.core import reading
from wcsim.core.reading import SETTINGS
from wcsim.errors import ConfigError

_PLANTS: Final = Path(__file__).parent / "plants"

# docs/chair.md says what each field means and how it is found.

Friction = Annotated[float, within(0.0, 2.0)]  # times that of the ground, which is 1
PartKg = Annotated[float, within(0.1, 30.0)]
Metre = Annotated[float, within(-1.5, 1.5)]
Vec3 = tuple[Metre, Metre, Metre]
Rises = Annotated[tuple[Annotated[float, Field(gt=0.0, le=0.3)], ...], Field(max_length=64)]


class _MassPart(Model):
    """Chair and user together; wheels, forks, arms, beams and anti-tips are part of the chair."""

    chair_kg: Annotated[float, within(50.0, 200.0)]
    user_kg: UserMass
    com_x_m: Annotated[float, within(-0.5, 0.6)]  # of chair and user, ahead of the drive axle
    com_z_m: Annotated[float, within(0.3, 0.9)]
    # Frame and user resist turning like a box of this size.
    inertia_box_m: tuple[
        Annotated[float, within(0.2, 1.5)],
        Annotated[float, within(0.2, 1.5)],
        Annotated[float, within(0.2, 2.0)],
    ]


class _WheelPart(Model):
    """The two drive wheels."""

    radius_m: Annotated[float, within(0.12, 0.32)]
    width_m: Annotated[float, within(0.02, 0.15)]
    mass_kg: PartKg
    track_m: Annotated[float, within(0.40, 0.75)]
    friction: Friction


class CasterArmPart(Model):
    """A sprung arm that carries a caster up and down.

    `preload_N` is its push at the height where all wheels stand.
    """

    stiffness_Npm: Annotated[float, within(1e3, 1e5)]
    damping_Nspm: Annotated[float, within(0.0, 5e3)]
    preload_N: Annotated[float, within(0.0, 2e3)]
    up_m: Annotated[float, within(0.0, 0.15)]  # travel towards the frame
    down_m: Annotated[float, within(0.0, 0.15)]
    mass_kg: PartKg


class CasterBeamPart(Model):
    """A beam across the frame that carries both casters of a pair.

    It rocks about a lengthwise pivot in its middle.
    """

    pivot_z_m: Annotated[float, within(0.0, 0.5)]
    # To either side. Less than half a degree is a value that was given in rad.
    stop_deg: Annotated[float, within(0.5, 15.0)]
    friction_Nm: Annotated[float, within(0.0, 200.0)]
    mass_kg: PartKg


class CasterPart(Model):
    """A pair of swivelling casters: rigid, each on a sprung arm, or both on a rocking beam."""

    swivel_x_m: Annotated[float, within(-0.8, 0.8)]  # from the drive axle to the swivel's axis
    track_m: Annotated[float, within(0.30, 0.75)]
    radius_m: Annotated[float, within(0.05, 0.18)]
    width_m: Annotated[float, within(0.02, 0.10)]
    mass_kg: PartKg
    trail_m: Annotated[float, within(0.02, 0.10)]
    fork_mass_kg: PartKg
    fork_inertia_kgm2: Annotated[float, within(1e-4, 0.1)]
    swivel_friction_Nm: Annotated[float, within(0.0, 5.0)]
    friction: Friction
    arm: CasterArmPart | None = None
    beam: CasterBeamPart | None = None


class _AntitipPart(Model):
    """A pair of anti-tip wheels on the frame."""

    p_m: Vec3  # the left one's middle
    radius_m: Annotated[float, within(0.01, 0.10)]
    mass_kg: PartKg
    inertia_kgm2: Annotated[float, within(1e-5, 0.1)]
    friction: Friction


class _BoxPart(Model):
    """A collision box of the frame with its user."""

    part: Literal["body", "footplate"]
    centre_m: Vec3
    size_m: tuple[
        Annotated[float, within(0.01, 1.5)],
        Annotated[float, within(0.01, 1.0)],
        Annotated[float, within(0.01, 1.5)],
    ]


class _FramePart(Model):
    """The frame with its user as others meet it."""

    height_m: Annotated[float, within(0.8, 2.0)]  # top of the user's head
    friction: Friction
    boxes: Annotated[tuple[_BoxPart, ...], Field(min_length=1, max_length=64)]


class _MotorPart(Model):
    """A geared permanent-magnet motor at each drive wheel, and its spring-applied parking brake."""

    stall_torque_Nm: Annotated[float, within(20.0, 300.0)]
    no_load_radps: Annotated[float, within(5.0, 60.0)]
    least_torque_share: Share  # of the stall torque, however fast it turns
    # As the wheel feels it, times the gear ratio squared.
    rotor_inertia_kgm2: Annotated[float, within(0.0, 2.0)]
    brake_torque_Nm: Annotated[float, within(20.0, 500.0)]


class _LimitPart(Model):
    """The most that the chair's controller may be set to."""

    speed_mps: TopSpeed
    accel_mps2: Annotated[float, within(0.2, 6.0)]
    decel_mps2: Annotated[float, within(0.2, 6.0)]
    jerk_mps3: Annotated[float, within(0.5, 100.0)]
    yaw_rate_radps: Annotated[float, within(0.1, 4.0)]
    yaw_accel_radps2: Annotated[float, within(0.1, 20.0)]


class _ClimbPart(Model):
    """Kerbs that the chair climbs square on, from standstill or a run-up, and kerbs that stop it.

    The run-up is 0.5 m long.
    """

    standstill_m: Rises
    run_up_m: Rises
    refused_m: Rises


class PlantFile(Model):
    """The whole file."""

    shows: Text
    mass: _MassPart
    wheel: _WheelPart
    casters: Annotated[tuple[CasterPart, ...], Field(min_length=1, max_length=4)]
    antitips: Annotated[tuple[_AntitipPart, ...], Field(max_length=4)] = ()
    frame: _FramePart
    motor: _MotorPart
    limits: _LimitPart
    climbs: _ClimbPart
    # What naming this plant sets in [chair], see `wcsim.config.resolve`.
    chair: ChairConfig = ChairConfig()


def list_plants() -> tuple[str, ...]:
    """Names of the plants that come with wcsim, sorted."""
    return tuple(sorted(path.stem for path in _PLANTS.glob("*.toml")))


def read_plant(plant: str) -> PlantFile:
    """A plant by name or by the path of a `.toml` file.

    Raises:
        ConfigError: No such plant, or a parameter is missing, unknown or out of bounds.
    """
    return read_toml(Path(plant), PlantFile) if plant.endswith(".toml") else _shipped_plant(plant)


# A world asks for its chairs' plant several times, and a file of the package stays as it is.
@cache
def _shipped_plant(plant: str) -> PlantFile:
    return read_toml(find_plant_path(plant), PlantFile)


def find_plant_path(plant: str) -> Path:
    """The file of a plant by its name or path. Raises ConfigError when no plant has that name."""
    if plant.endswith(".toml"):
        return Path(plant)
    if plant not in list_plants():
        raise ConfigError(
            f"chair.plant is {reading.escape(plant)!r}; expected one of: "
            f"{', '.join(list_plants())}, or the path of a .toml file"
        )
    return _PLANTS / f"{plant}.toml"


def read_own_plant_bytes(plant: str) -> bytes:
    """The bytes of a user's own plant file; none for a plant that comes with wcsim.

    Raises:
        ConfigError: The file cannot be read, or is no plant.
    """
    if not plant.endswith(".toml"):
        return b""
    where = reading.escape(plant)
    text = reading.read_text(Path(plant), SETTINGS)
    parse(PlantFile, reading.parse_toml(text, where, SETTINGS), where)
    return text.encode()


def override_plant_values(file: PlantFile, values: Mapping[str, float]) -> PlantFile:
    """A plant with other values under dotted names, such as `wheel.friction`, `casters.*.friction`.

    Raises:
        ConfigError: A name is unknown or a value out of bounds.
    """
    data = file.model_dump(mode="json")
    for name, value in values.items():
        *path, last = name.split(".")
        nodes: list[Any] = [data]
        for key in path:
            nodes = [node[k] for node in nodes for k in _keys(node, key)]
        places = [(node, key) for node in nodes for key in _keys(node, last)]
        if not places or any(isinstance(node[key], (dict, list)) for node, key in places):
            raise ConfigError(
                f"plant parameter {name!r} is unknown; expected a name like mass.user_kg or "
                "casters.*.trail_m"
            )
        for node, key in places:
            node[key] = value
    return parse(PlantFile, data, "plant")


def _keys(node: Any, key: str) -> list[Any]:
    """Where `key` leads in a table or a list; `*` stands for every item of a list."""
    if isinstance(node, list):
        return [i for i in range(len(node)) if key in ("*", str(i))]
    return [key] if isinstance(node, dict) and key in node else []

"""What differs from episode to episode, drawn from the ranges of `[vary]`.

Each name has a seed of its own. So a seat's draws do not change when another range is added, and
every seat has others.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from wcsim.config import CameraConfig, RunConfig, SensorConfig, SensorsConfig, parse
from wcsim.config.world import VaryConfig
from wcsim.core import frames, seeding
from wcsim.core.frames import Vec3
from wcsim.errors import ConfigError
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec, refuse_cameras_inside, varied
from wcsim.physics.wheelchair.plant_body import check_springs
from wcsim.types import Drawn

TRIES = 50  # a chair may be out of bounds, or fall over, for some of its drawn numbers together


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnChair:
    """A wheelchair as it is fitted out in one episode."""

    drawn: Drawn
    spec: PlantSpec
    cameras: tuple[CameraConfig, ...]
    sensors: Mapping[str, SensorConfig]  # sections by name


class Randomization:
    """Draws the episodes of one seat; with nothing in `[vary]` it gives None.

    Raises:
        ConfigError: A range leaves the bounds of what it names, with value, unit and bounds.
    """

    def __init__(self, config: RunConfig, seat: int) -> None:
        self._vary = vary = config.vary
        self._cameras, self._sensors, self._seat = config.cameras, config.sensors, seat
        if vary.nothing:
            return
        self._spec = plant_spec(config.chair)
        self._step_s = config.world.tick_s / config.world.usual_substeps
        # Numbers of a plant that change nothing in an episode, or that another range draws as well.
        for name in vary.plant:
            if name.startswith(("limits.", "climbs.", "chair.")):
                raise ConfigError(
                    f"vary.plant.{name}: changes nothing in an episode; "
                    "expected a number of its body"
                )
            if name == "mass.user_kg" and vary.user_mass_kg is not None:
                raise ConfigError(
                    f"vary.plant.{name}: vary.user_mass_kg draws it too; expected only one of them"
                )
        for key, check in _ends(config, self._spec, self._step_s):
            try:
                check()
            except ConfigError as error:
                raise ConfigError(f"{key}: {error}") from None

    def fitting(self, seed: int, episode: int) -> DrawnChair | None:
        """The chair of an episode, None when all are alike.

        Raises:
            ConfigError: TRIES draws have given no chair that can stand.
        """
        if self._vary.nothing:
            return None
        for attempt in range(TRIES):
            drawn = _draw(self._vary, len(self._cameras), seed, self._seat, episode, attempt)
            try:
                spec, cameras = _with_drawn(self._spec, drawn), moved(self._cameras, drawn)
                check_springs(spec, self._step_s)
                refuse_cameras_inside(cameras, spec)
                sensors = _retuned(self._sensors, drawn.sensors).on()
            except ConfigError as error:
                fault = error
                continue
            return DrawnChair(drawn=drawn, spec=spec, cameras=cameras, sensors=sensors)
        raise ConfigError(
            f"vary: {TRIES} draws gave no chair that can stand up; "
            f"expected narrower ranges: {fault}"
        )


def moved(cameras: tuple[CameraConfig, ...], drawn: Drawn) -> tuple[CameraConfig, ...]:
    """The cameras of an episode; raises ConfigError when one is out of its bounds."""
    shifts = drawn.camera_shift_m or ((0.0, 0.0, 0.0),) * len(cameras)
    turns = drawn.camera_turn_rad or ((0.0, 0.0),) * len(cameras)
    return tuple(
        _mounted(camera, shift, frames.rad2deg(yaw_rad), frames.rad2deg(pitch_rad))
        for camera, shift, (yaw_rad, pitch_rad) in zip(cameras, shifts, turns, strict=True)
    )


def _draw(
    vary: VaryConfig, cameras: int, seed: int, seat: int, episode: int, attempt: int = 0
) -> Drawn:
    """What the ranges give for an episode; `attempt` counts draws that could not be used."""

    def numbers(name: str, span: tuple[float, float] | None, count: int = 1) -> list[float]:
        if span is None:
            return []
        rng = seeding.make_rng(seed, "vary", seat, episode, name, attempt)
        return [float(value) for value in rng.uniform(*span, count)]

    def by_class(
        name: str, spans: Iterable[tuple[str, tuple[float, float]]]
    ) -> tuple[tuple[str, float], ...]:
        return tuple(
            (key, float(seeding.make_rng(seed, "vary", seat, episode, name, key).uniform(*span)))
            for key, span in sorted(spans)
        )

    shifts = numbers("camera_shift_m", vary.camera_shift_m, 3 * cameras)
    turns = numbers("camera_turn_deg", vary.camera_turn_deg, 2 * cameras)
    ticks = vary.action_delay_ticks
    # Without the attempt: no delay keeps a chair from standing, so it is never drawn again.
    rng = seeding.make_rng(seed, "vary", seat, episode, "action_delay_ticks")
    shift_m = zip(*(shifts[k::3] for k in range(3)), strict=True)
    turn_deg = zip(turns[::2], turns[1::2], strict=True)
    return Drawn(
        light=_first(numbers("light", vary.light)),
        friction=_first(numbers("friction", vary.friction)),
        user_mass_kg=_first(numbers("user_mass_kg", vary.user_mass_kg)),
        camera_shift_m=tuple((x, y, z) for x, y, z in shift_m),
        camera_turn_rad=tuple((frames.deg2rad(a), frames.deg2rad(b)) for a, b in turn_deg),
        action_delay_ticks=None if ticks is None else int(rng.integers(ticks[0], ticks[1] + 1)),
        plant=tuple((name, numbers(name, span)[0]) for name, span in sorted(vary.plant.items())),
        attention=by_class("attention", vary.attention.items()),
        reaction_s=by_class("reaction", vary.reaction.items()),
        sensors=tuple(
            (name, numbers(f"sensors.{name}", span)[0])
            for name, span in sorted(vary.sensors.items())
        ),
    )


def _with_drawn(spec: PlantSpec, drawn: Drawn) -> PlantSpec:
    """The plant of an episode; raises ConfigError for one out of bounds or that cannot stand."""
    values = dict(drawn.plant)
    if drawn.user_mass_kg is not None:
        values["mass.user_kg"] = drawn.user_mass_kg
    spec = varied(spec, values) if values else spec
    if drawn.friction is None:
        return spec
    rolling = {f"casters.{i}.friction": pair.friction for i, pair in enumerate(spec.casters)}
    rolling["wheel.friction"] = spec.wheel.friction
    return varied(spec, {name: value * drawn.friction for name, value in rolling.items()})


def _retuned(sensors: SensorsConfig, drawn: tuple[tuple[str, float], ...]) -> SensorsConfig:
    """The sensors as they measure in an episode.

    `drawn` are values by section.key, rounded for whole ones.

    Raises ConfigError when there is no such sensor or number, or a value is out of bounds.
    """
    data = sensors.model_dump()
    for name, value in drawn:
        section, _, key = name.partition(".")
        old = data.get(section, {}).get(key)
        if isinstance(old, bool) or not isinstance(old, int | float):
            values = [(f"{s}.{k}", v) for s, keys in data.items() for k, v in keys.items()]
            numbers = [key for key, v in values if type(v) in (int, float)]
            raise ConfigError(
                f"{name}: not a number of an existing sensor; expected one of {numbers}"
            )
        data[section][key] = round(value) if isinstance(old, int) else value
    return parse(SensorsConfig, data, "sensors")


def _mounted(camera: CameraConfig, shift_m: Vec3, yaw_deg: float, pitch_deg: float) -> CameraConfig:
    x, y, z = (p + s for p, s in zip(camera.p_BC_m, shift_m, strict=True))
    # One that looks back turns past 180 degrees.
    yaw_deg = math.remainder(camera.yaw_deg + yaw_deg, 360.0)
    turned = {"yaw_deg": yaw_deg, "pitch_deg": camera.pitch_deg + pitch_deg}
    data = {**camera.model_dump(), "p_BC_m": (x, y, z), **turned}
    return parse(CameraConfig, data, f"camera {camera.name}")


def _ends(
    config: RunConfig, spec: PlantSpec, step_s: float
) -> Iterator[tuple[str, Callable[[], object]]]:
    """Both ends of every range by itself, as a name and a check; together they are when drawn."""
    vary, cameras = config.vary, config.cameras
    for name, span in vary.plant.items():
        for value in span:
            yield f"vary.plant.{name}", partial(_check_plant, spec, name, value, step_s)
    for kg in vary.user_mass_kg or ():
        yield "vary.user_mass_kg", partial(_with_drawn, spec, Drawn(user_mass_kg=kg))
    for factor in vary.friction or ():
        yield "vary.friction", partial(_with_drawn, spec, Drawn(friction=factor))
    for camera in cameras:
        for shift_m in vary.camera_shift_m or ():
            shifted = partial(_mounted, camera, (shift_m, shift_m, shift_m), 0.0, 0.0)
            yield "vary.camera_shift_m", shifted
        for turn_deg in vary.camera_turn_deg or ():
            turned = partial(_mounted, camera, (0.0, 0.0, 0.0), turn_deg, turn_deg)
            yield "vary.camera_turn_deg", turned
    if vary.camera_shift_m is not None:
        check = partial(refuse_cameras_inside, cameras, spec, vary.camera_shift_m)
        yield "vary.camera_shift_m, boxes larger by it", check
    for name, span in vary.sensors.items():
        for value in span:
            yield f"vary.sensors.{name}", partial(_retuned, config.sensors, ((name, value),))


def _check_plant(spec: PlantSpec, name: str, value: float, step_s: float) -> None:
    check_springs(varied(spec, {name: value}), step_s)


def _first(values: list[float]) -> float | None:
    return values[0] if values else None

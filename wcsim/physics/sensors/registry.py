"""All kinds of sensors by name: that of the configuration's section, the noise and the reading.

The cameras of one seat are a sensor, too: their pictures come from the rig that all seats share.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from wcsim.errors import ConfigError
from wcsim.physics.sensors.base import BodyMotion, Mount, NoiseKeys, Sensor, Surroundings
from wcsim.physics.sensors.imu import Imu
from wcsim.physics.sensors.odometry import Odometry
from wcsim.types import F64, CameraFrame, Reading, SensorFrame

Maker = Callable[[Any, Mount], Sensor]  # from its section of the configuration


class _SeatCameras(Sensor):
    """All cameras of one seat."""

    def __init__(self, mount: Mount) -> None:
        """Those of the mount's seat, which look as the rig says. Raises ConfigError without one."""
        if mount.rig is None:
            raise ConfigError(
                f"seat {mount.seat} has cameras and no rig; expected the rig that draws their "
                "pictures"
            )
        self._rig = mount.rig
        self._seat = mount.seat

    def start(self, noise_key: int | None) -> None:
        """Take new pictures in the coming episode; the rig keys their noise itself."""
        self._rig.reset(self._seat)

    def look(self, scene: Surroundings) -> tuple[CameraFrame, ...]:
        """See `CameraRig.frames`; empty where nothing is drawn."""
        return self._rig.frames(self._seat, scene) if scene.drawn else ()


SENSORS: Mapping[str, Maker] = MappingProxyType(
    {
        "cameras": lambda _, on: _SeatCameras(on),
        "imu": lambda config, on: Imu(config, on.com_B_m, on.engine.step_s),
        "odometry": lambda config, on: Odometry(
            config, on.wheel_radius_m, on.track_m, on.engine.step_s
        ),
    }
)


class SensorSet:
    """The sensors of one wheelchair, by name; see `Sensor` for the methods."""

    def __init__(self, sections: Mapping[str, object], mount: Mount) -> None:
        """Those of these sections of the configuration.

        Raises:
            ConfigError: There are cameras, and no rig.
        """
        self._sections = sections
        self.fit(mount, {})

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all."""
        return tuple(self._sensors)

    def felt(self, name: str) -> Any:
        """The reading of a sensor in the last closed tick; None for one that has to look."""
        return self._felt[name]

    def fit(self, mount: Mount, sections: Mapping[str, object]) -> None:
        """Make all of them anew, those of `sections` by these from now on."""
        self._sections = {**self._sections, **sections}
        self._sensors = {name: SENSORS[name](row, mount) for name, row in self._sections.items()}
        # Of those that sample alone, as it is called every substep.
        self._samples = tuple(
            sensor.sample
            for sensor in self._sensors.values()
            if type(sensor).sample is not Sensor.sample
        )
        self._felt: dict[str, Any] = {}

    def start(self, noise: NoiseKeys | None) -> None:
        """Begin an episode with a reading at rest; these keys draw the errors that stay."""
        for name, sensor in self._sensors.items():
            sensor.start(None if noise is None else noise[name])
        self.end_tick(noise)

    def reset(self, motion: BodyMotion) -> None:
        """Stand still like this from now on."""
        for sensor in self._sensors.values():
            sensor.reset(motion)
        self.end_tick(None)

    def set_step(self, step_s: float) -> None:
        """Take the physics steps to be so long from the next tick on."""
        for sensor in self._sensors.values():
            sensor.set_step(step_s)

    def sample(self, motion: BodyMotion) -> None:
        """Take the motion after a physics step into the tick."""
        for sample in self._samples:
            sample(motion)

    def sample_rows(self, rows: F64, wheel_rad: tuple[float, float]) -> None:
        """Take a whole tick, see `Sensor`."""
        for sensor in self._sensors.values():
            sensor.sample_rows(rows, wheel_rad)

    def end_tick(self, noise: NoiseKeys | None) -> None:
        """Close the tick; noise only with keys.

        Raises:
            PhysicsError: The motion left the finite numbers.
        """
        keys = dict.fromkeys(self._sensors) if noise is None else noise
        self._felt = {name: sensor.end_tick(keys[name]) for name, sensor in self._sensors.items()}

    def observe(self, scene: Surroundings) -> SensorFrame:
        """The readings of all in the tick: what they felt in it, or see now.

        Cameras and IMU have fields of their own.
        """
        found = dict(self._felt)
        for name, sensor in self._sensors.items():
            sight = sensor.look(scene)
            if sight is not None:
                found[name] = sight
        cameras, imu = found.pop("cameras"), found.pop("imu")
        # By name: recordings must not depend on the order of the configuration's sections.
        readings = tuple([Reading(name=name, values=found[name]) for name in sorted(found)])
        return SensorFrame(tick=scene.tick, cameras=cameras, imu=imu, readings=readings)

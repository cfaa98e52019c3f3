"""All kinds of sensors by name: the name of the configuration's section, of the noise, and of what is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from wcsim.physics.sensors.base import Mount, Sensor
from wcsim.physics.sensors.imu import Imu
from wcsim.physics.sensors.seat_cameras import SeatCameras
from wcsim.types import Reading, SensorFrame

Maker = Callable[[Any, Mount], Sensor]  # from its section of the configuration

SENSORS: Mapping[str, Maker] = MappingProxyType(
    {
        "cameras": SeatCameras.fitted,
        "imu": Imu.fitted,
    }
)


def fitted(sections: Mapping[str, object], mount: Mount) -> dict[str, Sensor]:
    """The sensors of these sections on a wheelchair. Raises ConfigError for cameras without a rig."""
    return {name: SENSORS[name](section, mount) for name, section in sections.items()}


def sensor_frame(tick: int, said: Mapping[str, Any]) -> SensorFrame:
    """What all sensors of a chair said of a tick: cameras and IMU in fields of their own, the others by name."""
    others = sorted(said.keys() - {"cameras", "imu"})
    readings = tuple([Reading(name=name, values=said[name]) for name in others])
    return SensorFrame(tick=tick, cameras=said["cameras"], imu=said["imu"], readings=readings)

"""The cameras of one seat as a sensor: their pictures come from the rig that all seats share."""

from __future__ import annotations

from wcsim.errors import ConfigError
from wcsim.physics.sensors.base import Mount, Sensor, Surroundings
from wcsim.physics.sensors.camera import CameraRig
from wcsim.types import CameraFrame


class SeatCameras(Sensor):
    """All cameras of one seat."""

    def __init__(self, rig: CameraRig, seat: int) -> None:
        self._rig, self._seat = rig, seat

    @classmethod
    def fitted(cls, _: object, mount: Mount) -> SeatCameras:
        """Those of the mount's seat; where they look is in the rig. Raises ConfigError without one."""
        if mount.rig is None:
            raise ConfigError(f"seat {mount.seat} has cameras and no rig; expected the rig that draws their pictures")
        return cls(mount.rig, mount.seat)

    def start(self, noise_key: int | None) -> None:
        """Take new pictures in the coming episode; the rig keys their noise itself."""
        self._rig.reset(self._seat)

    def look(self, scene: Surroundings) -> tuple[CameraFrame, ...]:
        """See `CameraRig.frames`."""
        return self._rig.frames(self._seat, scene)

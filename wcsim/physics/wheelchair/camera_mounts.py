"""Where a camera may sit on a chair."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from wcsim.config import CameraConfig
from wcsim.core.rotations import Vec3
from wcsim.errors import ConfigError


class _BodyBox(Protocol):
    """A box of the chair or its user, in B."""

    @property
    def centre_m(self) -> Vec3:
        """Its middle."""

    @property
    def size_m(self) -> Vec3:
        """Its edges."""


def refuse_cameras_inside(cameras: Sequence[CameraConfig], boxes: Iterable[_BodyBox]) -> None:
    """Check that no camera sits inside the chair or its user.

    Raises:
        ConfigError: One does; names the camera, its place and the box.
    """
    solid = tuple(boxes)
    for camera in cameras:
        for box in solid:
            if all(abs(p - c) < 0.5 * s for p, c, s in zip(camera.p_BC_m, box.centre_m, box.size_m, strict=True)):
                spans = ", ".join(
                    f"{axis} {c - 0.5 * s:.2f} to {c + 0.5 * s:.2f} m"
                    for axis, c, s in zip("xyz", box.centre_m, box.size_m, strict=True)
                )
                place = ", ".join(f"{p:g}" for p in camera.p_BC_m)
                raise ConfigError(
                    f"camera {camera.name!r} at p_BC_m ({place}) m is inside the chair's body, the box {spans}; "
                    "expected a place outside: move it"
                )

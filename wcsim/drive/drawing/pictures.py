"""What the page shows: the street from behind the chair, the chair's own camera, and a map, as JPEG."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import cv2
import numpy as np

from wcsim.core.frames import rad
from wcsim.drive.drawing.guidance import ground_points, mark_chair, mark_goal, mark_way
from wcsim.drive.drawing.orbit import Orbit, eased, eye
from wcsim.drive.session import DriveSession
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.cast import Cast
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import ChairPose, Instances, chair_pose
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.sensors.camera_geometry import camera_matrix, focal_px, mount, pose_matrix
from wcsim.types import F64, U8, Bool
from wcsim.view.filming import SIGHT_M
from wcsim.view.map import MapView
from wcsim.view.pictures import class_colours, depth_colours

_FIELD_RAD: Final = rad(54.0)  # of the picture's shorter side, about
_QUALITY: Final = 80
_CAMERA_PX: Final = (320, 240)
_MAP_PX, _MAP_SPAN_M = 320, 60.0
_PART = struct.Struct("<cI")
_HEAD = struct.Struct("<I")
_NO_SEAT: Final = -1
SMALLEST_PX, LARGEST_PX = 160, 1280


class CameraKind(StrEnum):
    """What the chair's own camera shows."""

    COLOUR = "colour"
    CLASSES = "classes"
    DEPTH = "depth"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True, kw_only=True)
class PageLooks:
    """What a page wants to see, and how large."""

    orbit: Orbit = Orbit()  # noqa: RUF009 - frozen
    width_px: int = 800
    height_px: int = 450
    camera: CameraKind = CameraKind.COLOUR
    chart: bool = True


class DrivePictures:
    """Draws one session's street; a session of another street needs another object.

    Args:
        session: What is drawn.
    """

    def __init__(self, session: DriveSession) -> None:
        world = session.world
        store = GeometryStore(world.street.mesh)
        self._renderer, self._cast = RasterRenderer(store), Cast(world.street.signal_heads)
        self._map = MapView(store, _MAP_PX, _MAP_SPAN_M)
        self._front, (width, height) = world.config.cameras[0], _CAMERA_PX
        focal = focal_px(width, rad(self._front.hfov_deg))
        self._lens = Pinhole(
            width_px=width, height_px=height, focal_px=focal, near_m=self._front.near_m, range_m=SIGHT_M
        )
        self._yaw_rad = session.client.plant.yaw_rad
        self._number = 0
        self.spent_s = 0.0

    def draw(self, session: DriveSession, looks: PageLooks, dt_s: float) -> bytes:
        """All pictures of a moment in one message: its number, then for each part a letter, its length, its JPEG.

        Args:
            session: Of now.
            looks: What is wanted.
            dt_s: Since the last pictures, for the camera that comes after the chair.
        """
        began_s = time.perf_counter()
        plant = session.client.plant
        jumped = abs(math.remainder(plant.yaw_rad - self._yaw_rad, 2.0 * math.pi)) > 2.0 and session.client.tick == 0
        self._yaw_rad = plant.yaw_rad if jumped else eased(self._yaw_rad, plant.yaw_rad, dt_s)
        chair = chair_pose(0, plant, session.world.seats[0].chair.outline)
        parts = [(b"S", self._scene(session, looks, chair))]
        if looks.camera is not CameraKind.NOTHING:
            parts.append((b"C", self._own(session, looks.camera, chair)))
        if looks.chart:
            parts.append((b"M", self._chart(session, chair)))
        self._number += 1
        message = packed(self._number, parts)
        self.spent_s += time.perf_counter() - began_s
        return message

    def _scene(self, session: DriveSession, looks: PageLooks, chair: ChairPose) -> U8:
        camera, T_CW = _pinhole(looks), eye(chair.p_WB_m, self._yaw_rad, looks.orbit)
        rows, shown = self._rows(session, chair)
        images = self._look(camera, T_CW, rows, shown)
        points = ground_points(session.route, session.done_m, session.world.street.grid)
        return mark_way(_colours(images), images.depth_m, camera, T_CW, points)

    def _own(self, session: DriveSession, kind: CameraKind, chair: ChairPose) -> U8:
        """The front camera: colours as a person would see them, classes and depth as the policy gets them."""
        if kind is CameraKind.COLOUR:
            T_CW = camera_matrix(pose_matrix(chair.p_WB_m, chair.q_WB), mount(self._front))
            rows, shown = self._rows(session, chair)
            shown[len(session.world.snapshot.actors)] = False  # the chair itself, which its camera does not see
            return _colours(self._look(self._lens, T_CW, rows, shown))
        frame = session.client.sensors.cameras[0]
        is_class = kind is CameraKind.CLASSES
        picture = class_colours(frame.class_id) if is_class else depth_colours(frame.depth_m, self._front.range_m)
        scale = max(1, _CAMERA_PX[0] // picture.shape[1])
        return np.ascontiguousarray(picture.repeat(scale, axis=0).repeat(scale, axis=1))

    def _chart(self, session: DriveSession, chair: ChairPose) -> U8:
        picture = self._map.draw(chair.p_WB_m, session.world.snapshot.actors, (chair,), session.route)
        goal = session.route.points_W_m[-1] - chair.p_WB_m[:2]
        return mark_goal(mark_chair(picture, session.client.plant.yaw_rad), goal, _MAP_SPAN_M)

    def _rows(self, session: DriveSession, chair: ChairPose) -> tuple[Instances, Bool]:
        """What moves, and which of it a camera sees that sits on no chair."""
        snapshot = session.world.snapshot
        rows, shown = self._cast.seen(
            snapshot.actors, (chair,), snapshot.signals, (_NO_SEAT,), chair.p_WB_m[None], SIGHT_M
        )
        return rows, shown[0]

    def _look(self, camera: Pinhole, T_CW: F64, rows: Instances, shown: Bool) -> Images:
        images = new_images(camera.width_px, camera.height_px, rgb=True)
        self._renderer.render(camera, T_CW, rows, images, shown)
        return images


def packed(number: int, parts: Iterable[tuple[bytes, U8]]) -> bytes:
    r"""One message: a number, then for each picture (H, W, 3) a letter, the length of its JPEG, and that.

    >>> packed(7, [])
    b'\x07\x00\x00\x00'
    """
    message = bytearray(_HEAD.pack(number))
    for letter, picture in parts:
        data = jpeg(picture)
        message += _PART.pack(letter, len(data)) + data
    return bytes(message)


def jpeg(picture: U8) -> bytes:
    """A picture (H, W, 3), RGB, as JPEG. Raises ConfigError when it is none."""
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        raise ConfigError(f"a picture of shape {picture.shape} cannot be written as JPEG; expected (H, W, 3) uint8")
    return data.tobytes()


def _pinhole(looks: PageLooks) -> Pinhole:
    width, height = looks.width_px, looks.height_px
    return Pinhole(
        width_px=width,
        height_px=height,
        focal_px=focal_px(min(width, height), _FIELD_RAD),
        near_m=0.1,
        range_m=SIGHT_M,
    )


def _colours(images: Images) -> U8:
    if images.rgb is None:
        raise ConfigError("these images have no colours; they are made with rgb=True")
    return images.rgb

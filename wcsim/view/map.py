"""The street around a wheelchair from straight above, with what moves drawn as boxes."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from wcsim.bridge.world import World
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import ChairPose, actor_instances, chair_instances, chair_pose
from wcsim.physics.sensors.camera import FreeCamera
from wcsim.physics.sensors.camera_geometry import look_along
from wcsim.types import F64, U8, ActorKind, ActorState, ClassId, Route, StreetMesh
from wcsim.view.pictures import darken, open_video, side_by_side

# So high that roofs and trees hardly lean out of the picture, and the map is true to scale.
_HEIGHT_M = 400.0
RANGE_M = 10_000.0  # haze grows with the share of the range

_KIND_RGB: dict[ActorKind, tuple[int, int, int]] = {
    ActorKind.CAR: (36, 86, 190),
    ActorKind.TRUCK: (24, 48, 120),
    ActorKind.BUS: (14, 120, 150),
    ActorKind.TRAM: (20, 130, 110),
    ActorKind.MOTORCYCLE: (120, 70, 200),
    ActorKind.BICYCLE: (190, 90, 20),
    ActorKind.SCOOTER: (200, 130, 40),
    ActorKind.PEDESTRIAN: (214, 40, 70),
    ActorKind.WHEELCHAIR: (240, 200, 40),
    ActorKind.OTHER: (110, 80, 120),
}
_CHAIR_RGB = (250, 214, 40)
ROUTE_RGB = (0, 72, 40)  # and a light edge: one of them stands out from grass, road and pavement
_EDGE_RGB = (250, 250, 250)
_ROOF_SHARE = 0.5  # of a roof's brightness: in full it is that of a road
_BAR_M, _BAR_ALOFT = (
    10.0,
    0.04,
)  # the bar of the scale, and how far it is from the edges, as a share of the map
_BAR_RGB = (250, 250, 250)
_SMALL_PX = 7  # what is smaller (people, mostly) is drawn as a dot of this size


class MapView:
    """Draws maps of one street: north up, `span_m` from edge to edge."""

    def __init__(
        self, street: StreetMesh | GeometryStore, size_px: int = 480, span_m: float = 60.0
    ) -> None:
        """`street` may be the store of a camera rig, which saves building it again."""
        self.px_per_m = size_px / span_m
        camera = Pinhole(
            width_px=size_px,
            height_px=size_px,
            focal_px=size_px * _HEIGHT_M / span_m,
            near_m=1.0,
            range_m=RANGE_M,
        )
        self._camera = FreeCamera(street, camera)

    def draw(
        self,
        centre_W_m: F64,
        actors: Sequence[ActorState],
        chairs: Sequence[ChairPose] = (),
        route: Route | None = None,
    ) -> U8:
        """The map (size, size, 3) around a point (3,).

        Args:
            centre_W_m: the middle of the map.
            actors: Drawn as boxes in their kind's colour, with a line from middle to front.
            chairs: drawn in yellow.
            route: drawn as a green line with a light edge.
        """
        x, y, ground = (float(value) for value in centre_W_m)
        T_CW = look_along((x, y, ground + _HEIGHT_M), math.pi / 2, -math.pi / 2)
        images = self._camera.look(T_CW, actor_instances(()))
        image = (
            np.zeros_like(images.class_id[..., None].repeat(3, axis=2))
            if images.rgb is None
            else images.rgb
        )
        roofs = images.class_id == ClassId.BUILDING
        image[roofs] = _ROOF_SHARE * image[roofs]
        if route is not None:
            points = np.column_stack([route.points_W_m, np.full(len(route.points_W_m), ground)])
            for colour, thick in ((_EDGE_RGB, 5), (ROUTE_RGB, 3)):
                cv2.polylines(
                    image, [self._pixels(T_CW, points)], False, colour, thick, cv2.LINE_AA, 3
                )
        for actor in actors:
            corners = _oriented_box(actor.p_W_m, actor.yaw_rad, actor.size_lwh_m[:2])
            self._box(image, T_CW, corners, _KIND_RGB[actor.kind])
        boxes = chair_instances(chairs)
        for place, yaw_rad, chair in zip(boxes.p_W_m, boxes.yaw_rad.tolist(), chairs, strict=True):
            self._box(
                image, T_CW, _oriented_box(place, yaw_rad, chair.outline.size_lwh_m[:2]), _CHAIR_RGB
            )
        return image

    def _box(self, image: U8, T_CW: F64, corners_W_m: F64, colour: tuple[int, int, int]) -> None:
        """A filled box (corners from front left, clockwise) with a line ahead; a dot if small."""
        pixels = self._pixels(T_CW, corners_W_m)
        middle, nose = corners_W_m.mean(axis=0), corners_W_m[:2].mean(axis=0)
        start, end = self._pixels(T_CW, np.array([middle, nose])).tolist()
        if np.ptp(pixels, axis=0).max() < _SMALL_PX * 8:
            cv2.circle(image, start, _SMALL_PX * 4, colour, cv2.FILLED, cv2.LINE_AA, 3)
            return
        cv2.fillConvexPoly(image, pixels, colour, cv2.LINE_AA, 3)
        cv2.polylines(image, [pixels], True, _EDGE_RGB, 1, cv2.LINE_AA, 3)
        cv2.line(image, start, end, _EDGE_RGB, 1, cv2.LINE_AA, 3)

    def _pixels(
        self, T_CW: F64, points_W_m: F64
    ) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
        """Image points (n, 2) int32 in eighths of a pixel, for OpenCV's `shift` of 3."""
        camera = self._camera.camera
        seen = points_W_m @ T_CW[:, :3].T + T_CW[:, 3]
        flat = seen[:, :2] / seen[:, 2:] * camera.focal_px + 0.5 * camera.width_px - 0.5
        return np.asarray(np.rint(flat * 8), np.int32)


@contextmanager
def street_video(path: Path, world: World, span_m: float) -> Iterator[Callable[[U8], U8]]:
    """A video of the pictures (H, W, 3) of a world's last camera beside the map, `span_m` wide.

    It takes a picture, and returns the frame that was added. Raises ConfigError as `open_video`.
    """
    view = MapView(world.street.mesh, world.config.cameras[-1].height_px, span_m)
    with open_video(path, world.config.world.tick_s) as write:

        def add(picture: U8) -> U8:
            # Around the first wheelchair: its route, all actors and wheelchairs, the scale.
            snapshot, clients = world.snapshot, world.snapshot.clients
            chairs = [
                chair_pose(client.seat, client.plant, seat.chair.outline)
                for client, seat in zip(clients, world.seats, strict=True)
            ]
            image = view.draw(
                clients[0].plant.p_WB_m, snapshot.actors, chairs, world.seats[0].route
            )
            _draw_scale(image, view.px_per_m)
            frame = side_by_side(picture, image)
            write(frame)
            return frame

        yield add


def _draw_scale(image: U8, px_per_m: float) -> None:
    """Draw a bar of 10 m into the lower left corner of a map (H, W, 3)."""
    height = image.shape[0]
    away, size, word = (
        max(6, round(_BAR_ALOFT * height)),
        max(0.35, height / 1000.0),
        f"{_BAR_M:g} m",
    )
    left, right, low = away, away + round(_BAR_M * px_per_m), height - away
    (wide, high), below = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    darken(image[low - high - below - 10 : low + 6, left - 5 : max(right, left + wide) + 6], 0.35)
    cv2.line(image, (left, low), (right, low), _BAR_RGB, 1)
    for end in (left, right):
        cv2.line(image, (end, low - 3), (end, low + 3), _BAR_RGB, 1)
    above = (left, low - below - 4)
    cv2.putText(image, word, above, cv2.FONT_HERSHEY_SIMPLEX, size, _BAR_RGB, 1, cv2.LINE_AA)


def _oriented_box(p_W_m: F64, yaw_rad: float, size_lw_m: tuple[float, float]) -> F64:
    """Ground corners (4, 3) of a box about p: front left, front right, rear right, rear left.

    >>> _oriented_box(np.zeros(3), 0.0, (4.0, 2.0))[:, :2].tolist()
    [[2.0, 1.0], [2.0, -1.0], [-2.0, -1.0], [-2.0, 1.0]]
    """
    half_length, half_width = 0.5 * size_lw_m[0], 0.5 * size_lw_m[1]
    ahead = half_length * np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
    left = half_width * np.array([-math.sin(yaw_rad), math.cos(yaw_rad), 0.0])
    return np.asarray(
        p_W_m + np.array([ahead + left, ahead - left, -ahead - left, -ahead + left]), np.float64
    )

"""The street from behind the chair: pictures for films and reports.

If a wall stands before the chair, the camera comes higher or nearer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from wcsim.bridge.ego.start_place import bearing_rad
from wcsim.bridge.world import World
from wcsim.core.frames import deg2rad
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.base import Pinhole, Renderer
from wcsim.physics.renderer.cast import Cast
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import (
    ChairPose,
    actor_instances,
    chair_pose,
    rotation_of,
)
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.sensors.camera_geometry import focal_px, look_at
from wcsim.types import (
    F64,
    I32,
    U8,
    ActorState,
    CameraFrame,
    ClientSnapshot,
    Route,
    SignalState,
    Street,
)
from wcsim.types.street import Ground
from wcsim.view.filming import SIGHT_M

if TYPE_CHECKING:  # a page for drivers does not load it
    from wcsim.agents.evaluation.suite.playback import PlayedStep

DISTANCE_M: Final = 6.0  # of the camera from the chair
AIM_M = 0.9  # above the ground: the middle of who sits in the chair
_AHEAD_SHARE = (
    0.35  # of the distance: the camera aims so far ahead of the chair while it looks from behind
)
_AHEAD_M: Final = 30.0
_EVERY_M: Final = 0.9
_OVER_M: Final = 0.06  # so high above the ground, or it would lie in it
_DOT_M: Final = 0.13  # radius
_POLE_M: Final = 2.4
_BEHIND_M: Final = 0.35  # so much nearer a thing hides a dot
WAY_RGB, GOAL_RGB, _RIM_RGB, _CHAIR_RGB = (
    (0, 122, 94),
    (196, 30, 58),
    (255, 255, 255),
    (16, 92, 184),
)
_INK_RGB: Final = (20, 29, 48)
_TRACK_STEPS, _TRACK_STEP_S, _STANDS = 20, 0.1, 0.1  # two seconds; slower ones have no track
_ON_WAY_RAD: Final = math.radians(30.0)  # a way that goes on within this to either side lies ahead
_TAGGED_M, _MOST_TAGS, _TAG_SCALE, _TAG_PX = 25.0, 3, 0.45, (125, 20)
_PX: Final = 9
_LOOK = Pinhole(
    width_px=_PX, height_px=_PX, focal_px=6.0 * _PX, near_m=0.05, range_m=60.0
)  # a cone as wide as a chair
_MARGIN_M: Final = 0.3  # before a wall
_ROOM_M: Final = 3.5  # from so far away a chair is seen whole, with some street around it
_LEAST_M: Final = 1.2
_TILTS_RAD: Final = tuple(
    math.radians(22.0 + step) for step in range(0, 67, 12)
)  # above the horizon
_FIELD_RAD: Final = deg2rad(54.0)  # of the picture's shorter side, about
_NO_SEAT: Final = -1


def _eye(p_WB_m: F64, yaw_rad: float, tilt_rad: float, distance_m: float) -> F64:
    """World to camera frame (3, 4) of the camera that looks at a chair at p (3,) from behind.

    >>> import numpy as np
    >>> T_CW = _eye(np.zeros(3), 0.0, 0.4, 6.0)
    >>> bool((T_CW[:, :3] @ np.array([0.0, 0.0, AIM_M]) + T_CW[:, 3])[2] > 0.0)
    True
    """
    ahead_m = _AHEAD_SHARE * distance_m * math.cos(tilt_rad)
    aim_W_m = p_WB_m + np.array([ahead_m * math.cos(yaw_rad), ahead_m * math.sin(yaw_rad), AIM_M])
    return look_at(_stand(p_WB_m, yaw_rad, tilt_rad, distance_m), aim_W_m)


def _stand(p_WB_m: F64, yaw_rad: float, tilt_rad: float, distance_m: float) -> F64:
    """Where that camera stands in W, (3,).

    >>> import numpy as np
    >>> _stand(np.zeros(3), 0.0, 0.0, 6.0).round(3).tolist()
    [-6.0, 0.0, 0.9]
    """
    flat_m, up_m = distance_m * math.cos(tilt_rad), AIM_M + distance_m * math.sin(tilt_rad)
    stand_W_m: F64 = p_WB_m + np.array(
        [-flat_m * math.cos(yaw_rad), -flat_m * math.sin(yaw_rad), up_m]
    )
    return stand_W_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """One moment of a street with chairs in it."""

    actors: tuple[ActorState, ...]
    signals: tuple[SignalState, ...]
    chairs: tuple[ChairPose, ...]
    seat: int  # whose pictures these are; one of `chairs`
    # The chair is somewhere else than a moment ago; the picture's camera jumps with it.
    jumped: bool = False
    route: Route | None = None  # None where it is not known
    done_m: float = 0.0  # along the route
    motion: tuple[float, float] | None = (
        None  # the chair's speed ahead, m/s, and turn rate, rad/s, where they are known
    )
    frame: CameraFrame | None = (
        None  # what its front camera saw; drawn, without errors, where that is not known
    )

    @property
    def column(self) -> int:
        """Where the chair is among `chairs`."""
        return [chair.seat for chair in self.chairs].index(self.seat)

    @property
    def chair(self) -> ChairPose:
        """The chair itself."""
        return self.chairs[self.column]

    @property
    def yaw_rad(self) -> float:
        """Its heading."""
        R_WB = rotation_of(self.chair.q_WB)
        return math.atan2(R_WB[1, 0], R_WB[0, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenStreet:
    """A picture of a street, and where in it a point of W is seen."""

    images: Images
    camera: Pinhole
    T_CW: F64  # (3, 4)

    @property
    def picture(self) -> U8:
        """The colours (H, W, 3), to be drawn upon. Raises ConfigError: there are none."""
        if self.images.rgb is None:
            raise ConfigError("these images have no colours; they are made with rgb=True")
        return self.images.rgb

    def pixel(self, point_W_m: F64) -> tuple[int, int, float] | None:
        """Column, row and depth of a point (3,); None behind the camera, or far beside it."""
        x, y, z = (self.T_CW[:, :3] @ point_W_m + self.T_CW[:, 3]).tolist()
        if z < 0.3:
            return None
        u = 0.5 * self.camera.width_px + self.camera.focal_px * x / z
        v = 0.5 * self.camera.height_px + self.camera.focal_px * y / z
        return (round(u), round(v), z) if abs(u) < 1e4 and abs(v) < 1e4 else None

    def seen(self, point_W_m: F64) -> tuple[int, int, float] | None:
        """The same, for a point that is in the picture with nothing before it."""
        found = self.pixel(point_W_m)
        if found is None or not (
            0 <= found[0] < self.camera.width_px and 0 <= found[1] < self.camera.height_px
        ):
            return None
        behind_m = _BEHIND_M * (1.0 + 0.05 * found[2])
        return found if self.images.depth_m[found[1], found[0]] > found[2] - behind_m else None


def _ground_points(route: Route, done_m: float, grid: Ground) -> F64:
    """Points (n, 3) of the way on the ground ahead; the last is the destination, however far.

    Args:
        route: The way.
        done_m: How far along it the chair is.
        grid: The ground's heights.
    """
    length_m = float(route.arc_m[-1])
    first_m = (
        math.ceil((done_m + 1.2) / _EVERY_M) * _EVERY_M
    )  # on a raster: dots lie still while the chair drives
    arcs_m = np.append(np.arange(first_m, min(done_m + _AHEAD_M, length_m), _EVERY_M), length_m)
    xy = np.column_stack(
        [np.interp(arcs_m, route.arc_m, route.points_W_m[:, axis]) for axis in (0, 1)]
    )
    return np.column_stack([xy, np.asarray(grid.height_at(xy), np.float64) + _OVER_M])


def _mark_way(scene: SeenStreet, points_W_m: F64) -> None:
    """Draw the way, (n, 3) see `_ground_points`, into a picture, behind what stands before it."""
    image = scene.picture
    for point in points_W_m[:-1][::-1]:
        seen = scene.seen(point)
        if seen is not None:
            u, v, far_m = seen
            radius = max(2, round(scene.camera.focal_px * _DOT_M / far_m))
            axes = (radius, max(1, round(radius * 0.45)))
            cv2.ellipse(image, (u, v), axes, 0.0, 0.0, 360.0, WAY_RGB, cv2.FILLED, cv2.LINE_AA)
            cv2.ellipse(image, (u, v), axes, 0.0, 0.0, 360.0, _RIM_RGB, 1, cv2.LINE_AA)
    foot, top = points_W_m[-1], points_W_m[-1] + (0.0, 0.0, _POLE_M)
    seen, above = scene.seen(foot), scene.pixel(top)
    if seen is not None and above is not None:
        u, v, _ = above
        size = max(6, abs(seen[1] - v) // 3)
        cv2.line(image, seen[:2], (u, v), _RIM_RGB, max(2, size // 6), cv2.LINE_AA)
        flag = np.array([(u, v), (u + round(1.4 * size), v + size // 2), (u, v + size)], np.int32)
        cv2.fillPoly(image, [flag], GOAL_RGB, cv2.LINE_AA)
        cv2.polylines(image, [flag], True, _RIM_RGB, 1, cv2.LINE_AA)


def _mark_track(scene: SeenStreet, moment: Moment, ground: Ground) -> None:
    """Draw the ground that the chair takes in the next two seconds, its place then, its speed."""
    if moment.motion is None:
        return
    speed_mps, turn_radps = moment.motion
    (x, y, _), yaw_rad, places = moment.chair.p_WB_m.tolist(), moment.yaw_rad, []
    for _ in range(_TRACK_STEPS):
        yaw_rad += 0.5 * turn_radps * _TRACK_STEP_S
        x += speed_mps * _TRACK_STEP_S * math.cos(yaw_rad)
        y += speed_mps * _TRACK_STEP_S * math.sin(yaw_rad)
        yaw_rad += 0.5 * turn_radps * _TRACK_STEP_S
        places.append((x, y, math.cos(yaw_rad), math.sin(yaw_rad)))
    outline = moment.chair.outline
    half_m, middle_m = 0.5 * outline.width_m, outline.middle_x_m
    front_m, rear_m = middle_m + 0.5 * outline.length_m, middle_m - 0.5 * outline.length_m
    corners = [(front_m, -half_m), (front_m, half_m), (rear_m, half_m), (rear_m, -half_m)]
    sides = [[_beside(place, 0.0, aside) for place in places] for aside in (half_m, -half_m)]
    box = [_beside(places[-1], *corner) for corner in corners]
    lines = [*sides, [*box, box[0]]] if math.hypot(speed_mps, turn_radps) > _STANDS else []
    pixels = [_on_ground(scene, np.array(line), ground) for line in lines]
    for wide, rgb in ((5, _RIM_RGB), (2, _CHAIR_RGB)):
        cv2.polylines(scene.picture, pixels, False, rgb, wide, cv2.LINE_AA)
    aside = _on_ground(scene, np.array([_beside(places[-1], 0.0, -2.5 * half_m)]), ground)
    if len(aside):
        _tag(scene.picture, tuple(aside[0].tolist()), f"{abs(speed_mps):.1f} m/s")


def _beside(
    place: tuple[float, float, float, float], along_m: float, left_m: float
) -> tuple[float, float]:
    x, y, cos, sin = place
    return x + along_m * cos - left_m * sin, y + along_m * sin + left_m * cos


def _on_ground(scene: SeenStreet, points_W_m: F64, ground: Ground) -> I32:
    """Columns and rows (m, 2) of ground points (n, 2), without those behind the camera."""
    lifted = np.c_[points_W_m, ground.height_at(points_W_m) + _OVER_M]
    return np.array(
        [found[:2] for point in lifted if (found := scene.pixel(point)) is not None], np.int32
    ).reshape(-1, 2)


def _mark_near(scene: SeenStreet, moment: Moment) -> None:
    """Label who is nearest ahead, and how far; no label lies upon another."""
    here_W_m, ahead = (
        moment.chair.p_WB_m,
        np.array([math.cos(moment.yaw_rad), math.sin(moment.yaw_rad)]),
    )
    gaps = [
        (math.dist(actor.p_W_m[:2], here_W_m[:2]), number)
        for number, actor in enumerate(moment.actors)
    ]
    tagged: list[tuple[int, int]] = []
    for gap_m, number in sorted(gaps):
        actor, tall_m = moment.actors[number], moment.actors[number].size_lwh_m[2]
        if gap_m > _TAGGED_M or len(tagged) == _MOST_TAGS:
            return
        top = scene.pixel(actor.p_W_m + np.array([0.0, 0.0, tall_m + 0.1]))
        seen = scene.seen(actor.p_W_m + np.array([0.0, 0.0, 0.6 * tall_m]))
        if (actor.p_W_m[:2] - here_W_m[:2]) @ ahead <= 0.0 or top is None or seen is None:
            continue
        if all(abs(top[0] - u) > _TAG_PX[0] or abs(top[1] - v) > _TAG_PX[1] for u, v in tagged):
            tagged.append(top[:2])
            _tag(scene.picture, (top[0], top[1] - 10), f"{actor.kind.value} {gap_m:.0f} m")


def _tag(image: U8, middle: tuple[int, int], text: str) -> None:
    """Write dark words on a light ground, around a place or as near to it as the picture allows."""
    (wide, high), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, _TAG_SCALE, 1)
    u = min(max(middle[0] - wide // 2, 4), image.shape[1] - wide - 4)
    v = min(max(middle[1], high + 6), image.shape[0] - below - 4)
    cv2.rectangle(image, (u - 3, v - high - 4), (u + wide + 3, v + below), _RIM_RGB, cv2.FILLED)
    cv2.putText(image, text, (u, v), cv2.FONT_HERSHEY_DUPLEX, _TAG_SCALE, _INK_RGB, 1, cv2.LINE_AA)


def _held(renderer: Renderer, p_WB_m: F64, yaw_rad: float) -> tuple[float, float]:
    """Tilt and distance from which the chair is seen, as near as can be to the usual ones."""
    images, nobody = new_images(_PX, _PX, rgb=False), actor_instances(())
    best_rad, most_m = _TILTS_RAD[0], -1.0
    for tilt_rad in _TILTS_RAD:
        # From above the chair towards the camera: how far it is to what hides half of the chair.
        T_CW = look_at(
            p_WB_m + np.array([0.0, 0.0, AIM_M]), _stand(p_WB_m, yaw_rad, tilt_rad, DISTANCE_M)
        )
        renderer.render(_LOOK, T_CW, nobody, images)
        met_m = np.sort(np.where(images.depth_m > 0.0, images.depth_m, _LOOK.range_m), axis=None)
        room_m = float(met_m[len(met_m) // 2]) - _MARGIN_M
        if room_m > most_m + _MARGIN_M:
            best_rad, most_m = tilt_rad, room_m
        if most_m >= _ROOM_M:
            break
    return best_rad, min(DISTANCE_M, max(most_m, _LEAST_M))


class StreetPictures:
    """Draws moments of one street; another street needs another object."""

    def __init__(self, street: Street) -> None:
        self._renderer = RasterRenderer(GeometryStore(street.mesh))
        self._cast = Cast(street.signal_heads)
        self._grid = street.grid

    def behind(self, moment: Moment, width_px: int, height_px: int) -> SeenStreet:
        """The street from behind the chair."""
        here_W_m = moment.chair.p_WB_m
        lens = Pinhole(
            width_px=width_px,
            height_px=height_px,
            focal_px=focal_px(min(width_px, height_px), _FIELD_RAD),
            near_m=0.1,
            range_m=SIGHT_M,
        )
        eye = _eye(here_W_m, moment.yaw_rad, *_held(self._renderer, here_W_m, moment.yaw_rad))
        rows, shown = self._cast.seen(
            moment.actors, moment.chairs, moment.signals, (_NO_SEAT,), here_W_m[None], SIGHT_M
        )
        images = new_images(width_px, height_px, rgb=True)
        self._renderer.render(lens, eye, rows, images, shown[0])
        scene = SeenStreet(images=images, camera=lens, T_CW=eye)
        if moment.route is not None:
            _mark_way(scene, _ground_points(moment.route, moment.done_m, self._grid))
        _mark_track(scene, moment, self._grid)
        _mark_near(scene, moment)
        return scene


def moment_of(
    world: World, client: ClientSnapshot, route: Route, done_m: float, *, jumped: bool = False
) -> Moment:
    """The street of now around the chair in the first seat, on its way; `jumped` as in `Moment`."""
    snapshot = world.snapshot
    return Moment(
        actors=snapshot.actors,
        signals=snapshot.signals,
        chairs=(chair_pose(0, client.plant, world.seats[0].chair.outline),),
        seat=0,
        jumped=jumped,
        route=route,
        done_m=done_m,
        motion=(float(client.plant.v_B_mps[0]), float(client.plant.w_B_radps[2])),
        frame=next(iter(client.sensors.cameras), None),  # a policy of numbers alone has no pictures
    )


def played_moment(step: PlayedStep) -> Moment:
    """The street of a step that was driven once more."""
    return Moment(
        actors=step.actors,
        signals=step.signals,
        chairs=step.chairs,
        seat=step.seat,
        motion=step.motion,
    )


class StillPictures:
    """Draws the first seat's chair in a world, with its way; another world needs another object."""

    def __init__(self, world: World) -> None:
        self._world, self._pictures = world, StreetPictures(world.street)

    @property
    def on_way(self) -> bool:
        """Whether the chair faces its way: while it first turns, its picture shows another way."""
        user, plant = self._world.seats[0], self._world.snapshot.clients[0].plant
        return abs(bearing_rad(user.route, user.user.route_progress_m, plant)) < _ON_WAY_RAD

    def draw(self) -> U8:
        """The picture of now, (540, 960, 3) RGB."""
        world, seat = self._world, self._world.seats[0]
        moment = moment_of(world, world.snapshot.clients[0], seat.route, seat.user.route_progress_m)
        return self._pictures.behind(moment, 960, 540).picture

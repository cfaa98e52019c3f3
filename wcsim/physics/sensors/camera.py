"""The cameras of the wheelchairs: where each one looks, when it takes an image, and the buffers it writes into."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import TracebackType

import numpy as np

from wcsim.config import CameraConfig
from wcsim.core import frames, seeding
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, SeatBuffers, new_images
from wcsim.physics.renderer.base import Pinhole, Renderer
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import (
    ChairPose,
    Instances,
    actor_instances,
    chair_instances,
    chosen,
    joined,
    rotation_of,
)
from wcsim.physics.renderer.raster import RasterRenderer, warm_up
from wcsim.physics.renderer.signal_lamps import SignalLamps
from wcsim.physics.renderer.visible_pixels import shown_px
from wcsim.physics.sensors.camera_noise import camera_noise
from wcsim.physics.sensors.pixel_noise import child
from wcsim.types import (
    F64,
    U8,
    ActorState,
    CameraFrame,
    PlantState,
    SignalHead,
    SignalState,
    StreetMesh,
    chair_actor_id,
)

BUFFERS = 3  # a camera's images in turn, see CameraRig

# Axes of a camera that looks along x of its mount: x right, y down, z forward, each in the mount's frame.
_R_CM = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(slots=True)
class _Shutter:
    """What one camera of one seat took last, and its buffers in turn."""

    buffers: tuple[Images, ...]
    turn: int = 0
    last: CameraFrame | None = None
    key: int = 0  # of its noise
    shown_px: Mapping[str, float] = field(default_factory=dict)  # by actor, in the last picture


@dataclass(slots=True)
class _Cast:
    """The actors and the wheelchairs of a tick as instances; all seats of the tick share them."""

    actors: Sequence[ActorState] = ()
    instances: Instances = field(default_factory=lambda: actor_instances(()))
    chairs: Sequence[ChairPose] = ()
    chair_instances: Instances = field(default_factory=lambda: chair_instances(()))


class CameraRig:
    """The cameras of all seats: one geometry, one renderer of each kind, three buffers a camera.

    The arrays of a frame stay valid until the third new image of that camera after it: a tick that ends an episode
    takes two, and what was seen before it must still stand when the tick is judged.
    """

    def __init__(
        self,
        mesh: StreetMesh,
        cameras: tuple[CameraConfig, ...],
        seats: int,
        heads: Sequence[SignalHead] = (),
    ) -> None:
        """Build the geometry and compile the rasteriser.

        Args:
            mesh: the street.
            cameras: the cameras of every chair.
            seats: number of wheelchairs, at least 1.
            heads: the heads of the traffic lights, whose lamps are drawn.

        Raises:
            ConfigError: when there is no camera or no seat.
        """
        if not cameras or seats < 1:
            raise ConfigError(f"a rig got {len(cameras)} cameras and {seats} seats; expected at least one of each")
        self.cameras = cameras
        self._renderers: dict[str, Renderer] = {}
        self.show(mesh)
        raster = self._renderers.get("numba")
        if isinstance(raster, RasterRenderer):
            warm_up(raster)
        self._lamps = SignalLamps(heads)
        self._pinholes = tuple(pinhole(camera) for camera in cameras)
        self._mounts = [tuple(mount(camera) for camera in cameras)] * seats
        self._light = [1.0] * seats
        self._noises = tuple(camera_noise(*pair) for pair in zip(cameras, self._pinholes, strict=True))
        for noise in filter(None, self._noises):
            noise.lay_over(new_images(16, 12, rgb=True), 0)  # compiled now, not at the first picture
        self._shutters = [tuple(_Shutter(_new_buffers(camera)) for camera in cameras) for _ in range(seats)]
        self._cast = _Cast()
        self.begin(0)

    def __enter__(self) -> CameraRig:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the renderers and their geometry; a second call does nothing."""
        for renderer in self._renderers.values():
            if hasattr(renderer, "close"):
                renderer.close()
        self._renderers.clear()

    def show(self, street: StreetMesh | GeometryStore) -> None:
        """Draw this part of the street from now on."""
        self.close()
        self.store = street if isinstance(street, GeometryStore) else GeometryStore(street)
        self._renderers = {name: _renderer(name, self.store) for name in sorted({c.renderer for c in self.cameras})}

    def begin(self, seed: int) -> None:
        """Take the noise of the pictures from this seed on; each seat and camera has its own."""
        for seat, shutters in enumerate(self._shutters):
            for shutter, camera in zip(shutters, self.cameras, strict=True):
                shutter.key = seeding.key(seed, "camera", seat, camera.name)
                shutter.last = None

    def mount(self, seat: int, cameras: Sequence[CameraConfig], light: float) -> None:
        """Put the cameras of a seat where these are from now on, into a street `light` times as bright as usual."""
        self._mounts[seat] = tuple(mount(camera) for camera in cameras)
        self._light[seat] = light

    def reset(self, seat: int) -> None:
        """Forget what the cameras of a seat saw, so that each takes a new image at its next shot."""
        for shutter in self._shutters[seat]:
            shutter.last = None

    def shoot(
        self,
        seat: int,
        tick: int,
        plant: PlantState,
        actors: Sequence[ActorState],
        chairs: Sequence[ChairPose],
        buffers: SeatBuffers | None = None,
        signals: Sequence[SignalState] = (),
        counted: bool = False,
    ) -> tuple[CameraFrame, ...]:
        """Take (or repeat) the image of every camera of a seat.

        Args:
            seat: whose cameras.
            tick: the tick that the images show.
            plant: where the seat's wheelchair is.
            actors: what moves in the street; a tuple that is given again (the same object) is not read again.
            chairs: the wheelchairs, the seat's own among them or not; it is never drawn. A tuple, as with the actors.
            buffers: where to write; the rig's own buffers when None.
            signals: the traffic lights of now; a head whose light is not among them is dark.
            counted: whether the pixels of every actor are counted, for `shown_px`.

        Returns:
            One frame a camera; a camera with `every_ticks` > 1 repeats its last image with its old `taken_tick`.

        Raises:
            ConfigError: when given buffers do not fit the cameras.
        """
        others = self._other_chairs(seat, chairs)
        lamps = self._lamps.near(plant.p_WB_m, max(camera.range_m for camera in self.cameras), signals)
        instances = joined(joined(self._actors(actors), others), lamps)
        names = _names(seat, actors, chairs) if counted else None
        T_WB = pose_matrix(plant.p_WB_m, plant.q_WB)
        shots = []
        for index, shutter in enumerate(self._shutters[seat]):
            own = buffers.images[index] if buffers is not None else None
            shots.append(self._shot(seat, index, shutter, tick, T_WB, instances, own, names))
        return tuple(shots)

    def shown_px(self, seat: int) -> dict[str, float]:
        """Pixels of each actor in the pictures of the seat's last shot, all cameras together, without their noise.

        By the id of the whole, as many as there would be in pictures of 320x240; empty when they were not counted.
        """
        total: dict[str, float] = {}
        for shutter in self._shutters[seat]:
            for name, pixels in shutter.shown_px.items():
                total[name] = total.get(name, 0.0) + pixels
        return total

    def _shot(
        self,
        seat: int,
        index: int,
        shutter: _Shutter,
        tick: int,
        T_WB: F64,
        instances: Instances,
        own: Images | None,
        names: Sequence[str] | None,
    ) -> CameraFrame:
        camera = self.cameras[index]
        if shutter.last is not None and 0 <= tick - shutter.last.taken_tick < camera.every_ticks:
            if own is not None and not np.may_share_memory(own.depth_m, shutter.last.depth_m):
                shutter.last = copied(shutter.last, own)
            return shutter.last
        out = own if own is not None else shutter.buffers[shutter.turn]
        shutter.turn = (shutter.turn + 1) % BUFFERS
        T_CW = camera_matrix(T_WB, self._mounts[seat][index])
        shutter.shown_px = self._drawn(index, T_CW, instances, out, names)
        if out.rgb is not None and self._light[seat] != 1.0:
            np.take(brightened(self._light[seat]), out.rgb, out=out.rgb)
        noise = self._noises[index]
        if noise is not None:  # a tick that ends an episode takes two pictures
            noise.lay_over(out, child(shutter.key, 2 * tick + (shutter.last is None)))
        shutter.last = _frame(camera.name, tick, out)
        return shutter.last

    def _drawn(
        self, index: int, T_CW: F64, instances: Instances, out: Images, names: Sequence[str] | None
    ) -> Mapping[str, float]:
        """Draw a picture; the pixels of those in it when they have names."""
        renderer, camera = self._renderers[self.cameras[index].renderer], self._pinholes[index]
        if names is None:
            renderer.render(camera, T_CW, instances, out)
            return {}
        instance = np.empty(out.class_id.shape, np.int32)
        renderer.render(camera, T_CW, instances, replace(out, instance=instance))
        return shown_px(instance, names)

    def _other_chairs(self, seat: int, chairs: Sequence[ChairPose]) -> Instances:
        if not isinstance(chairs, tuple):  # a list may have changed since
            return chair_instances([chair for chair in chairs if chair.seat != seat])
        if chairs is not self._cast.chairs:
            self._cast.chairs, self._cast.chair_instances = chairs, chair_instances(chairs)
        return chosen(self._cast.chair_instances, np.array([chair.seat != seat for chair in chairs], np.bool_))

    def _actors(self, actors: Sequence[ActorState]) -> Instances:
        if not isinstance(actors, tuple):  # a list may have changed since
            return actor_instances(actors)
        if actors is not self._cast.actors:
            self._cast.actors, self._cast.instances = actors, actor_instances(actors)
        return self._cast.instances


class FreeCamera:
    """A camera that can be put anywhere: for pictures, maps and tests."""

    def __init__(self, street: StreetMesh | GeometryStore, camera: Pinhole) -> None:
        """`street` may be the store of a rig, which saves building it again."""
        store = street if isinstance(street, GeometryStore) else GeometryStore(street)
        self.camera = camera
        self._renderer = RasterRenderer(store)

    def look(self, T_CW: F64, instances: Instances) -> Images:
        """Fresh images with colours, seen with the camera at T_CW (3, 4), see `look_along` and `look_at`."""
        images = new_images(self.camera.width_px, self.camera.height_px, rgb=True)
        self._renderer.render(self.camera, T_CW, instances, images)
        return images


@lru_cache(maxsize=64)
def brightened(light: float) -> U8:
    """What each of 256 colour values becomes in a street `light` times as bright."""
    table: U8 = np.minimum(np.arange(256) * light, 255.0).astype(np.uint8)
    return table


def pinhole(camera: CameraConfig) -> Pinhole:
    """The ideal camera of a configuration."""
    return Pinhole(
        width_px=camera.width_px,
        height_px=camera.height_px,
        focal_px=focal_px(camera.width_px, frames.rad(camera.hfov_deg)),
        near_m=camera.near_m,
        range_m=camera.range_m,
    )


def focal_px(width_px: int, hfov_rad: float) -> float:
    """Focal length of a camera that sees hfov_rad over its width.

    >>> round(focal_px(320, math.pi / 2), 6)
    160.0
    """
    return 0.5 * width_px / math.tan(0.5 * hfov_rad)


def mount(camera: CameraConfig) -> F64:
    """Pose (3, 4) of the camera's mount in the chair's frame B: x the way it looks, y left, z up."""
    return pose_of(camera.p_BC_m, frames.rad(camera.yaw_deg), frames.rad(camera.pitch_deg))


def pose_of(p_m: Sequence[float] | F64, yaw_rad: float, pitch_rad: float) -> F64:
    """Pose (3, 4) of a frame at p that looks along yaw, nose up by pitch."""
    cy, sy, cp, sp = math.cos(yaw_rad), math.sin(yaw_rad), math.cos(pitch_rad), math.sin(pitch_rad)
    turn = np.array([[cy * cp, -sy, -cy * sp], [sy * cp, cy, -sy * sp], [sp, 0.0, cp]])
    return np.column_stack([turn, np.asarray(p_m, np.float64)])


def pose_matrix(p_WB_m: F64, q_WB: F64) -> F64:
    """Pose (3, 4) of a body from its place (3,) and quaternion (4,) x, y, z, w."""
    return np.column_stack([rotation_of(q_WB), np.asarray(p_WB_m, np.float64)])


def camera_matrix(T_WB: F64, T_BM: F64) -> F64:
    """World to camera frame, (3, 4): the camera looks along x of its mount M, which sits on body B; x right, y down."""
    R_WM = T_WB[:, :3] @ T_BM[:, :3]
    p_WM = T_WB[:, :3] @ T_BM[:, 3] + T_WB[:, 3]
    R_CW = _R_CM @ R_WM.T
    return np.column_stack([R_CW, -R_CW @ p_WM])


def look_along(p_W_m: Sequence[float] | F64, yaw_rad: float, pitch_rad: float) -> F64:
    """World to camera frame (3, 4) of a camera at p that looks along yaw, nose up by pitch (-pi/2: down)."""
    return camera_matrix(np.eye(3, 4), pose_of(p_W_m, yaw_rad, pitch_rad))


def look_at(p_W_m: Sequence[float] | F64, target_W_m: Sequence[float] | F64) -> F64:
    """World to camera frame (3, 4) of a level camera at p with the target in the middle of its image."""
    x, y, z = np.asarray(target_W_m, np.float64) - np.asarray(p_W_m, np.float64)
    return look_along(p_W_m, math.atan2(y, x), math.atan2(z, math.hypot(x, y)))


def _renderer(name: str, store: GeometryStore) -> Renderer:
    if name == "pybullet":
        from wcsim.physics.renderer.tiny_renderer import (
            TinyRenderer,  # the reference back end; PyBullet is loaded for it alone
        )

        return TinyRenderer(store)
    return RasterRenderer(store)


def _names(seat: int, actors: Sequence[ActorState], chairs: Sequence[ChairPose]) -> list[str]:
    """Who is who in the instances of a shot: the actors, then the chairs but the seat's own."""
    others = [chair_actor_id(chair.seat) for chair in chairs if chair.seat != seat]
    return [actor.whole_id for actor in actors] + others


def _new_buffers(camera: CameraConfig) -> tuple[Images, ...]:
    return tuple(new_images(camera.width_px, camera.height_px, camera.rgb) for _ in range(BUFFERS))


def _frame(name: str, taken_tick: int, images: Images) -> CameraFrame:
    """A frame over the buffers that cannot be written to: what a camera took is for looking at."""
    depth_m, class_id = images.depth_m.view(), images.class_id.view()
    rgb = None if images.rgb is None else images.rgb.view()
    depth_m.setflags(write=False)
    class_id.setflags(write=False)
    if rgb is not None:
        rgb.setflags(write=False)
    return CameraFrame(name=name, taken_tick=taken_tick, depth_m=depth_m, class_id=class_id, rgb=rgb)


def copied(frame: CameraFrame, own: Images) -> CameraFrame:
    """The same frame in other buffers."""
    np.copyto(own.depth_m, frame.depth_m)
    np.copyto(own.class_id, frame.class_id)
    if own.rgb is not None and frame.rgb is not None:
        np.copyto(own.rgb, frame.rgb)
    return _frame(frame.name, frame.taken_tick, own)

"""The cameras of the wheelchairs: where each one looks, when it takes an image, and the buffers it writes into.

The errors of a camera are made of its configuration and laid over the true pictures. Before that it is counted how much
of each actor a picture shows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from wcsim.config import CameraConfig, CameraNoiseConfig, DepthNoiseConfig
from wcsim.core import frames, seeding
from wcsim.core.closing import ClosingContextBase
from wcsim.core.jit import compile_fast_kernel
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, SeatBuffers, new_images
from wcsim.physics.renderer.base import Pinhole, Renderer
from wcsim.physics.renderer.cast import Cast, names
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances, actor_instances
from wcsim.physics.renderer.raster import RasterRenderer, brighten, warm_up
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.sensors.camera_geometry import camera_matrix, focal_px, mount, pinhole, pose_matrix
from wcsim.physics.sensors.drawing_threads import DrawingThreads, Work, cores
from wcsim.physics.sensors.object_noise import ObjectNoise
from wcsim.physics.sensors.pixel_noise import ClassNoise, ColourNoise, DepthNoise, child
from wcsim.types import F64, I32, I64, U8, Bool, CameraFrame, SignalHead, StreetMesh

_STATED_PX = 320 * 240
"""The picture for which numbers of pixels are stated; in one of another size they are scaled by its share of this."""


@compile_fast_kernel
def _count(instance: I32, counts: I64) -> None:
    for row in range(instance.shape[0]):
        for i in instance[row]:
            if 0 <= i < len(counts):
                counts[i] += 1


def _shown_px(instance: I32, names: Sequence[str]) -> dict[str, float]:
    """Pixels of each actor that is in the picture, by its name, as they would be in one of 320x240.

    Args:
        instance: (H, W) int32, the row of the instance that each pixel shows, -1 where it shows none.
        names: of the actors in the first rows, not necessarily different ones: those of one name are added up. The
            rows behind them are nobody's.
    """
    counts = np.zeros(len(names), np.int64)
    _count(instance, counts)
    scale = _STATED_PX / instance.size
    shown: dict[str, float] = {}
    for i in np.flatnonzero(counts).tolist():
        shown[names[i]] = shown.get(names[i], 0.0) + scale * float(counts[i])
    return shown


DEPTH, CLASSES, RGB = 0, 1, 2  # each picture has a key of its own
FULL_SCALE = 255.0


class _CameraNoise:
    """Disturbs the pictures of one camera; keeps nothing between pictures."""

    def __init__(self, camera: CameraConfig, pinhole: Pinhole, tick_s: float = 0.1) -> None:
        noise = camera.noise or CameraNoiseConfig()
        self.objects = None if noise.objects is None else ObjectNoise(noise.objects, pinhole, tick_s)
        self._depth = None if noise.depth is None else _depth_noise(camera, noise.depth, pinhole)
        self._classes = None if noise.classes is None else ClassNoise(**noise.classes.model_dump())
        self._colours = None if noise.rgb is None else ColourNoise(_sigma_of(noise.rgb.snr_db))

    def lay_over(self, images: Images, key: int) -> None:
        """Turn the true pictures into measured ones, in place; `key` (64 bits) says which."""
        if self._depth is not None:
            self._depth.lay_over(images.depth_m, child(key, DEPTH))
        if self._classes is not None:
            self._classes.lay_over(images.class_id, child(key, CLASSES))
        if self._colours is not None and images.rgb is not None:
            self._colours.lay_over(images.rgb, child(key, RGB))


def _depth_noise(camera: CameraConfig, depth: DepthNoiseConfig, pinhole: Pinhole) -> DepthNoise:
    """What the kernel needs of a stereo camera."""
    known = depth.model_dump(include=set(DepthNoise._fields))
    return DepthNoise(
        focal_px=pinhole.focal_px,
        shift_px_m=pinhole.focal_px * depth.baseline_m,
        match_px_m=focal_px(depth.matcher_width_px, frames.deg2rad(camera.hfov_deg)) * depth.baseline_m,
        range_m=camera.range_m,
        grazing_sin=math.sin(frames.deg2rad(depth.grazing_deg)),
        **known,
    )


def _sigma_of(snr_db: float) -> float:
    """Standard deviation of a colour, in steps of 255, at a signal-to-noise ratio of full scale.

    >>> round(_sigma_of(40.0), 3)
    2.55
    """
    return float(FULL_SCALE * 10.0 ** (-snr_db / 20.0))


BUFFERS = 3  # a camera's images in turn, see CameraRig
_LOST = 1 << 40  # beside the keys of ticks: whether a tick's picture is lost
_OBJECTS = _LOST + 1  # errors about whole things, whose key is that of all ticks


@dataclass(slots=True)
class _Shutter:
    """What one camera of one seat took last, and its buffers in turn."""

    buffers: tuple[Images, ...]
    turn: int = 0
    last: CameraFrame | None = None
    key: int = 0  # of its noise
    shown_px: Mapping[str, float] = field(default_factory=dict)  # by actor, in the last picture


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shot:
    """A picture to be taken: all that a thread needs for it."""

    shutter: _Shutter
    renderer: Renderer
    camera: Pinhole
    T_CW: F64
    instances: Instances
    shown: Bool
    out: Images
    light: float
    noise: _CameraNoise
    noise_key: int
    tick: int
    ground_m: float  # height in W below the chair
    names: Sequence[str] | None  # of the rows whose pixels are counted

    def take(self) -> None:
        """Draw it, count who is in it, and lay its errors over it."""
        counts, objects, instance = {}, self.noise.objects, None
        if self.names is not None or objects is not None:
            instance = np.empty(self.out.class_id.shape, np.int32)
        out = replace(self.out, instance=instance)
        self.renderer.render(self.camera, self.T_CW, self.instances, out, self.shown)
        if self.names is not None and instance is not None:
            counts = _shown_px(instance, self.names)
        self.shutter.shown_px = counts
        if self.out.rgb is not None and self.light != 1.0:
            brighten(self.out.rgb, _brightened(self.light))
        if objects is not None and instance is not None:
            # Before the noise of pixels, which is that of the surfaces that are invented too.
            key = child(self.shutter.key, _OBJECTS)
            objects.lay_over(self.out, instance, self.T_CW, self.instances, self.tick, self.ground_m, key)
        self.noise.lay_over(self.out, self.noise_key)


class CameraRig(ClosingContextBase):
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
        threads: int = 1,
        tick_s: float = 0.1,
    ) -> None:
        """Build the geometry and compile the rasteriser.

        Args:
            mesh: the street.
            cameras: the cameras of every chair.
            seats: number of wheelchairs, at least 1.
            heads: the heads of the traffic lights, whose lamps are drawn.
            threads: how many threads draw, 0 for one a core; the pictures are the same with any number.
            tick_s: how long a tick is.

        Raises:
            ConfigError: when there is no camera or no seat, or fewer than no threads.
        """
        if not cameras or seats < 1 or threads < 0:
            got = f"{len(cameras)} cameras, {seats} seats and {threads} threads"
            raise ConfigError(f"a rig got {got}; expected at least one camera and one seat, and 0 threads or more")
        self.cameras = cameras
        self._renderers: dict[str, Renderer] = {}
        self.show(mesh)
        raster = self._renderers.get("numba")
        if isinstance(raster, RasterRenderer):
            warm_up(raster)
        self._cast = Cast(heads)
        self._range_m = max(camera.range_m for camera in cameras)
        self._threads = DrawingThreads(threads or cores())
        self._taken: dict[int, tuple[Surroundings, tuple[CameraFrame, ...]]] = {}
        self._shut = False
        self._pinholes = tuple(pinhole(camera) for camera in cameras)
        self._mounts = [tuple(mount(camera) for camera in cameras)] * seats
        self._light = [1.0] * seats
        self._noises = tuple(_CameraNoise(*pair, tick_s) for pair in zip(cameras, self._pinholes, strict=True))
        for noise in self._noises:
            images = new_images(16, 12, rgb=True)  # compiled now, not at the first picture
            noise.lay_over(images, 0)
            if noise.objects is not None:
                nobody = np.full((12, 16), -1, np.int32)
                noise.objects.lay_over(images, nobody, np.eye(3, 4), actor_instances(()), 0, 0.0, 0)
        self._shutters = [tuple(_Shutter(_new_buffers(camera)) for camera in cameras) for _ in range(seats)]
        self.begin(0)

    def close(self) -> None:
        """End the threads, let go of the renderers and their geometry; a second call does nothing."""
        self._threads.close()
        self._let_go()

    def _let_go(self) -> None:
        for renderer in self._renderers.values():
            if isinstance(renderer, ClosingContextBase):
                renderer.close()
        self._renderers.clear()

    def show(self, street: StreetMesh | GeometryStore) -> None:
        """Draw this part of the street from now on."""
        self._let_go()
        self.store = street if isinstance(street, GeometryStore) else GeometryStore(street)
        # Sorted: the order of a set of strings differs from process to process.
        self._renderers = {name: _renderer(name, self.store) for name in sorted({c.renderer for c in self.cameras})}

    def begin(self, seed: int) -> None:
        """Take the noise of the pictures from this seed on; each seat and camera has its own."""
        for seat, shutters in enumerate(self._shutters):
            for shutter, camera in zip(shutters, self.cameras, strict=True):
                shutter.key = seeding.derive_rng_key(seed, "camera", seat, camera.name)
                shutter.last = None

    def mount(self, seat: int, cameras: Sequence[CameraConfig], light: float) -> None:
        """Put the cameras of a seat where these are from now on, into a street `light` times as bright as usual."""
        self._mounts[seat] = tuple(mount(camera) for camera in cameras)
        self._light[seat] = light

    def reset(self, seat: int) -> None:
        """Forget what the cameras of a seat saw, so that each takes a new image at its next shot."""
        for shutter in self._shutters[seat]:
            shutter.last = None

    def frames(self, seat: int, scene: Surroundings) -> tuple[CameraFrame, ...]:
        """What the cameras of a seat see; those taken in this very scene by `shoot_all`, or else taken now."""
        # By identity: a scene is made anew for every tick, and comparing arrays would cost more.
        if seat not in self._taken or self._taken[seat][0] is not scene:
            self.shoot_all({seat: scene})
        return self._taken[seat][1]

    def shoot_all(self, scenes: Mapping[int, Surroundings], meanwhile: Work | None = None) -> None:
        """Take (or repeat) the image of every camera of these seats, in all threads; `frames` hands them out.

        A camera with `every_ticks` > 1, or whose picture is lost, repeats its last image with its old `taken_tick`.
        A seat's own wheelchair, among the scene's or not, is never drawn.

        Args:
            scenes: what there is to see, by seat, all of one moment: the same actors, chairs and signals.
            meanwhile: what the calling thread does while others draw already.

        Raises:
            ConfigError: when given buffers do not fit the cameras.
        """
        due = {
            (seat, index): shutter
            for seat, scene in scenes.items()
            for index, shutter in enumerate(self._shutters[seat])
            if not self._repeats(index, shutter, scene.tick)
        }
        shots = self._shots(scenes, due)
        # Only the rasteriser draws from threads, as it lets go of the GIL.
        self._threads.run([shot.take for shot in shots if isinstance(shot.renderer, RasterRenderer)], meanwhile)
        for shot in shots:
            if not isinstance(shot.renderer, RasterRenderer):  # PyBullet's draws one picture at a time
                shot.take()
        for (seat, index), shot in zip(due, shots, strict=True):
            shot.shutter.last = _frame(self.cameras[index].name, scenes[seat].tick, shot.out)
        for seat, scene in scenes.items():
            pairs = enumerate(self._shutters[seat])
            self._taken[seat] = (scene, tuple([_last(shutter, scene.buffers, index) for index, shutter in pairs]))

    def freeze_pictures(self) -> None:
        """Repeat the last picture of every camera from now on."""
        self._shut = True

    def shown_px(self, seat: int) -> dict[str, float]:
        """Pixels of each actor in the pictures of the seat's last shot, all cameras together, without their noise.

        By the id of the whole, as many as there would be in pictures of 320x240; empty when they were not counted.
        """
        total: dict[str, float] = {}
        for shutter in self._shutters[seat]:
            for name, pixels in shutter.shown_px.items():
                total[name] = total.get(name, 0.0) + pixels
        return total

    def _repeats(self, index: int, shutter: _Shutter, tick: int) -> bool:
        if shutter.last is None or tick < shutter.last.taken_tick:
            return False
        if self._shut:
            return True
        # A key of its own beside those of the noise: losing a picture does not change any other one.
        camera, lost = self.cameras[index], child(child(shutter.key, _LOST), tick) / 2.0**64
        return tick - shutter.last.taken_tick < camera.every_ticks or lost < camera.lost_share

    def _shots(self, scenes: Mapping[int, Surroundings], due: Mapping[tuple[int, int], _Shutter]) -> list[_Shot]:
        """The pictures of these cameras (seat, number); what all share of the street is made once."""
        if not due:
            return []
        seats, now = list(scenes), next(iter(scenes.values()))
        eyes_W_m = np.array([scene.plant.p_WB_m for scene in scenes.values()])
        rows, shown = self._cast.seen(now.actors, now.chairs, now.signals, seats, eyes_W_m, self._range_m)
        who = names(now.actors, now.chairs) if any(scene.counted for scene in scenes.values()) else None
        poses = {seat: pose_matrix(scene.plant.p_WB_m, scene.plant.q_WB) for seat, scene in scenes.items()}
        shots = []
        for (seat, index), shutter in due.items():
            scene = scenes[seat]
            out = shutter.buffers[shutter.turn] if scene.buffers is None else scene.buffers[index]
            shutter.turn = (shutter.turn + 1) % BUFFERS
            shots.append(
                _Shot(
                    shutter=shutter,
                    renderer=self._renderers[self.cameras[index].renderer],
                    camera=self._pinholes[index],
                    T_CW=camera_matrix(poses[seat], self._mounts[seat][index]),
                    instances=rows,
                    shown=shown[seats.index(seat)],
                    out=out,
                    light=self._light[seat],
                    noise=self._noises[index],
                    # a tick that ends an episode takes two pictures
                    noise_key=child(shutter.key, 2 * scene.tick + (shutter.last is None)),
                    tick=scene.tick,
                    ground_m=float(scene.plant.p_WB_m[2]),
                    names=who if scene.counted else None,
                )
            )
        return shots


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
def _brightened(light: float) -> U8:
    """What each of 256 colour values becomes in a street `light` times as bright."""
    table: U8 = np.minimum(np.arange(256) * light, 255.0).astype(np.uint8)
    return table


def _renderer(name: str, store: GeometryStore) -> Renderer:
    if name == "pybullet":
        from wcsim.physics.renderer.tiny_renderer import (
            TinyRenderer,  # the reference back end; PyBullet is loaded for it alone
        )

        return TinyRenderer(store)
    return RasterRenderer(store)


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


def _last(shutter: _Shutter, buffers: SeatBuffers | None, index: int) -> CameraFrame:
    """The last frame of a camera; in these buffers, if there are any."""
    frame = shutter.last
    if frame is None:
        raise ValueError("a camera that took nothing has no last frame")
    # A repeated picture lies in other buffers: whoever reads these needs a copy in them.
    if buffers is not None and not np.may_share_memory(buffers[index].depth_m, frame.depth_m):
        frame = shutter.last = copied(frame, buffers[index])
    return frame


def copied(frame: CameraFrame, own: Images) -> CameraFrame:
    """The same frame in other buffers."""
    np.copyto(own.depth_m, frame.depth_m)
    np.copyto(own.class_id, frame.class_id)
    if own.rgb is not None and frame.rgb is not None:
        np.copyto(own.rgb, frame.rgb)
    return _frame(frame.name, frame.taken_tick, own)

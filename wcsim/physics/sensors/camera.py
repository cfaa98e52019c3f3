"""The cameras of the wheelchairs: where each looks, when it takes an image, and into which buffers.

The errors of a camera follow from its configuration, and are laid over the true pictures. Before
that the pixels of each actor are counted.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import repeat

import numpy as np

from wcsim.config import CameraConfig, CameraNoiseConfig
from wcsim.core import frames, seeding
from wcsim.core.closing import ClosingContextBase
from wcsim.core.jit import compile_fast_kernel
from wcsim.errors import ConfigError
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.base import Pinhole, Renderer
from wcsim.physics.renderer.cast import Cast, names
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances, actor_instances
from wcsim.physics.renderer.raster import RasterRenderer, brighten, warm_up
from wcsim.physics.sensors.base import Surroundings
from wcsim.physics.sensors.camera_geometry import (
    camera_matrix,
    focal_px,
    mount,
    pinhole,
    pose_matrix,
)
from wcsim.physics.sensors.drawing_threads import DrawingThreads, Work, cores
from wcsim.physics.sensors.object_noise import ObjectNoise
from wcsim.physics.sensors.pixel_noise import ClassNoise, ColourNoise, DepthNoise, child
from wcsim.types import F64, I32, I64, U8, Bool, CameraFrame, SignalHead, StreetMesh

# Numbers of pixels are stated for a picture of this size; others are scaled by their share of it.
_STATED_PX = 320 * 240
DEPTH, CLASSES, RGB = 0, 1, 2  # each picture has a key of its own
BUFFERS = 3  # a camera's images in turn, see CameraRig
_LOST = 1 << 40  # beside the keys of ticks: whether a tick's picture is lost
_OBJECTS = _LOST + 1  # errors about whole things, whose key is that of all ticks


@compile_fast_kernel
def _count(instance: I32, counts: I64) -> None:
    for row in range(instance.shape[0]):
        for i in instance[row]:
            if 0 <= i < len(counts):
                counts[i] += 1


def _shown_px(instance: I32, names: Sequence[str]) -> dict[str, float]:
    """Pixels of each actor that is in the picture, by its name, as they would be in one of 320x240.

    Args:
        instance: (H, W) int32, the row of the instance that each pixel shows, -1 where it shows
            none.
        names: of the actors in the first rows; those of one name are added up. The rows behind them
            belong to no actor.
    """
    counts = np.zeros(len(names), np.int64)
    _count(instance, counts)
    scale = _STATED_PX / instance.size
    shown: dict[str, float] = {}
    for i in np.flatnonzero(counts).tolist():
        shown[names[i]] = shown.get(names[i], 0.0) + scale * float(counts[i])
    return shown


class _CameraNoise:
    """Disturbs the pictures of one camera; holds nothing between pictures."""

    def __init__(self, camera: CameraConfig, pinhole: Pinhole, tick_s: float = 0.1) -> None:
        noise = camera.noise or CameraNoiseConfig()
        objects, classes = noise.objects, noise.classes
        self.objects = None if objects is None else ObjectNoise(objects, pinhole, tick_s)
        self._classes = None if classes is None else ClassNoise(**classes.model_dump())
        self._depth = None
        self._colours = None
        if noise.depth is not None:
            depth, hfov_rad = noise.depth, frames.deg2rad(camera.hfov_deg)
            self._depth = DepthNoise(
                focal_px=pinhole.focal_px,
                shift_px_m=pinhole.focal_px * depth.baseline_m,
                match_px_m=focal_px(depth.matcher_width_px, hfov_rad) * depth.baseline_m,
                range_m=camera.range_m,
                grazing_sin=math.sin(frames.deg2rad(depth.grazing_deg)),
                **depth.model_dump(include=set(DepthNoise._fields)),
            )
        if noise.rgb is not None:
            # From the signal-to-noise ratio of full scale: 40 dB are 2.55 steps of 255.
            self._colours = ColourNoise(255.0 * 10.0 ** (-noise.rgb.snr_db / 20.0))

    def lay_over(self, images: Images, key: int) -> None:
        """Turn the true pictures into measured ones, in place; `key` (64 bits) says which."""
        if self._depth is not None:
            self._depth.lay_over(images.depth_m, child(key, DEPTH))
        if self._classes is not None:
            self._classes.lay_over(images.class_id, child(key, CLASSES))
        if self._colours is not None and images.rgb is not None:
            self._colours.lay_over(images.rgb, child(key, RGB))


@dataclass(slots=True)
class _Shutter:
    """The last image of one camera of one seat, and its buffers in turn."""

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
        """Draw it, count the pixels of actors, and lay its errors over it."""
        objects = self.noise.objects
        instance = None
        if self.names is not None or objects is not None:
            instance = np.empty(self.out.class_id.shape, np.int32)
        out = replace(self.out, instance=instance)
        self.renderer.render(self.camera, self.T_CW, self.instances, out, self.shown)
        self.shutter.shown_px = {}
        if self.names is not None and instance is not None:
            self.shutter.shown_px = _shown_px(instance, self.names)
        if self.out.rgb is not None and self.light != 1.0:
            brighten(self.out.rgb, _brightened(self.light))
        if objects is not None and instance is not None:
            # Before the noise of pixels, which surfaces that are invented have, too.
            objects.lay_over(
                self.out,
                instance,
                self.T_CW,
                self.instances,
                self.tick,
                self.ground_m,
                child(self.shutter.key, _OBJECTS),
            )
        self.noise.lay_over(self.out, self.noise_key)


class CameraRig(ClosingContextBase):
    """The cameras of all seats: one geometry, one renderer of each kind, three buffers a camera.

    The arrays of a frame stay valid until the third new image of that camera after it. A tick that
    ends an episode takes two, and the image before it must still be there when the tick is judged.
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
            threads: how many draw, 0 for one a core; the pictures are the same with any number.
            tick_s: how long a tick is.

        Raises:
            ConfigError: when there is no camera or no seat, or `threads` is negative.
        """
        if not cameras or seats < 1 or threads < 0:
            raise ConfigError(
                f"a rig got {len(cameras)} cameras, {seats} seats and {threads} threads; expected "
                "at least one camera and one seat, and 0 threads or more"
            )
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
        self._noises = tuple(map(_CameraNoise, cameras, self._pinholes, repeat(tick_s)))
        # Compile the kernels of noise now, not at the first picture.
        for noise in self._noises:
            images = new_images(16, 12, rgb=True)
            noise.lay_over(images, 0)
            if noise.objects is not None:
                empty = np.full((12, 16), -1, np.int32)
                noise.objects.lay_over(images, empty, np.eye(3, 4), actor_instances(()), 0, 0.0, 0)
        self._shutters = [
            tuple(_Shutter(_new_buffers(camera)) for camera in cameras) for _ in range(seats)
        ]
        self.begin(0)

    def close(self) -> None:
        """End the threads, free the renderers and their geometry; a second call does nothing."""
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
        for name in sorted({camera.renderer for camera in self.cameras}):
            if name == "pybullet":
                # The reference back end; PyBullet is loaded for it alone.
                from wcsim.physics.renderer.tiny_renderer import TinyRenderer

                self._renderers[name] = TinyRenderer(self.store)
            else:
                self._renderers[name] = RasterRenderer(self.store)

    def begin(self, seed: int) -> None:
        """Take the noise of the pictures from this seed on; each seat and camera has its own."""
        for seat, shutters in enumerate(self._shutters):
            for shutter, camera in zip(shutters, self.cameras, strict=True):
                shutter.key = seeding.derive_rng_key(seed, "camera", seat, camera.name)
                shutter.last = None

    def mount(self, seat: int, cameras: Sequence[CameraConfig], light: float) -> None:
        """Put the cameras of a seat in these places from now on; `light` brightens the street."""
        self._mounts[seat] = tuple(mount(camera) for camera in cameras)
        self._light[seat] = light

    def reset(self, seat: int) -> None:
        """Forget the images of a seat's cameras: each takes a new one at its next shot."""
        for shutter in self._shutters[seat]:
            shutter.last = None

    def frames(self, seat: int, scene: Surroundings) -> tuple[CameraFrame, ...]:
        """The frames of a seat, taken in this very scene by `shoot_all` or else now."""
        # By identity: a scene is made anew for every tick, and comparing arrays would cost more.
        if seat not in self._taken or self._taken[seat][0] is not scene:
            self.shoot_all({seat: scene})
        return self._taken[seat][1]

    def shoot_all(self, scenes: Mapping[int, Surroundings], meanwhile: Work | None = None) -> None:
        """Take (or repeat) the image of every camera of these seats, for `frames`, in all threads.

        A camera with `every_ticks` > 1, or whose picture is lost, repeats its last image with its
        old `taken_tick`. A seat's own wheelchair, among the scene's or not, is never drawn.

        Args:
            scenes: by seat, all of one moment, with the same actors, chairs and signals.
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
        # 1. Take the pictures. Only the rasteriser draws from threads, as it releases the GIL;
        # PyBullet's draws one picture at a time.
        shots = self._shots(scenes, due)
        threaded = [shot for shot in shots if isinstance(shot.renderer, RasterRenderer)]
        self._threads.run([shot.take for shot in threaded], meanwhile)
        for shot in shots:
            if not isinstance(shot.renderer, RasterRenderer):
                shot.take()

        # 2. Frames over their buffers, and those that are repeated.
        for (seat, index), shot in zip(due, shots, strict=True):
            shot.shutter.last = _frame(self.cameras[index].name, scenes[seat].tick, shot.out)
        for seat, scene in scenes.items():
            own = scene.buffers or (None,) * len(self.cameras)
            self._taken[seat] = (scene, tuple(map(_last, self._shutters[seat], own)))

    def freeze_pictures(self) -> None:
        """Repeat the last picture of every camera from now on."""
        self._shut = True

    def shown_px(self, seat: int) -> dict[str, float]:
        """Pixels of each actor in the seat's last pictures, all together, without their noise.

        By the id of the whole actor, as many as there would be in pictures of 320x240. It is empty
        when they were not counted.
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
        # Its key is none of the noise: a lost picture does not change any other one.
        camera, lost = self.cameras[index], child(child(shutter.key, _LOST), tick) / 2.0**64
        return tick - shutter.last.taken_tick < camera.every_ticks or lost < camera.lost_share

    def _shots(
        self, scenes: Mapping[int, Surroundings], due: Mapping[tuple[int, int], _Shutter]
    ) -> list[_Shot]:
        """The pictures of these cameras (seat, number)."""
        if not due:
            return []
        # 1. What all of them share of the street, made once.
        seats, now = list(scenes), next(iter(scenes.values()))
        eyes_W_m = np.array([scene.plant.p_WB_m for scene in scenes.values()])
        rows, shown = self._cast.seen(
            now.actors, now.chairs, now.signals, seats, eyes_W_m, self._range_m
        )
        counted = any(scene.counted for scene in scenes.values())
        actors = names(now.actors, now.chairs) if counted else None
        poses = {
            seat: pose_matrix(scene.plant.p_WB_m, scene.plant.q_WB)
            for seat, scene in scenes.items()
        }

        # 2. One camera after another.
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
                    # A tick that ends an episode takes two pictures.
                    noise_key=child(shutter.key, 2 * scene.tick + (shutter.last is None)),
                    tick=scene.tick,
                    ground_m=float(scene.plant.p_WB_m[2]),
                    names=actors if scene.counted else None,
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
        """Fresh images with colours, seen at T_CW (3, 4); see `look_along` and `look_at`."""
        images = new_images(self.camera.width_px, self.camera.height_px, rgb=True)
        self._renderer.render(self.camera, T_CW, instances, images)
        return images


@lru_cache(maxsize=64)
def _brightened(light: float) -> U8:
    """What each of 256 colour values becomes in a street `light` times as bright."""
    table: U8 = np.minimum(np.arange(256) * light, 255.0).astype(np.uint8)
    return table


def _new_buffers(camera: CameraConfig) -> tuple[Images, ...]:
    return tuple(new_images(camera.width_px, camera.height_px, camera.rgb) for _ in range(BUFFERS))


def _frame(name: str, taken_tick: int, images: Images) -> CameraFrame:
    """A frame over the buffers that cannot be written to: it is for looking at."""
    depth_m, class_id = images.depth_m.view(), images.class_id.view()
    rgb = None if images.rgb is None else images.rgb.view()
    depth_m.setflags(write=False)
    class_id.setflags(write=False)
    if rgb is not None:
        rgb.setflags(write=False)
    return CameraFrame(
        name=name, taken_tick=taken_tick, depth_m=depth_m, class_id=class_id, rgb=rgb
    )


def _last(shutter: _Shutter, own: Images | None) -> CameraFrame:
    """The last frame of a camera; in these buffers, if there are any."""
    frame = shutter.last
    if frame is None:
        raise ValueError("a camera that took nothing has no last frame")
    if own is None or np.may_share_memory(own.depth_m, frame.depth_m):
        return frame
    # A repeated picture lies in other buffers.
    np.copyto(own.depth_m, frame.depth_m)
    np.copyto(own.class_id, frame.class_id)
    if own.rgb is not None and frame.rgb is not None:
        np.copyto(own.rgb, frame.rgb)
    shutter.last = _frame(frame.name, frame.taken_tick, own)
    return shutter.last

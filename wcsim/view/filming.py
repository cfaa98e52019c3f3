"""A chair in a town for pictures and videos: it does what its user asks for, its camera draws colours."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CameraConfig, RunConfig, WorldConfig, resolve
from wcsim.core.frames import rad
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import Town
from wcsim.types import F32, U8, CameraFrame, ClassId, SeatSpec, Snapshot
from wcsim.view.map import MapView, map_view
from wcsim.view.pictures import VideoWriter, captioned, side_by_side

_ACTOR_CLASSES = np.array([c.value for c in ClassId if ClassId.PERSON <= c <= ClassId.BICYCLE], np.uint8)
_IN_VIEW_PX = 12  # an actor counts as in view from about this many pixels of its class on
_FIELD_OF_VIEW_M = 30.0
MAP_SPAN_M = 60.0
FILMED_USER = "competent"  # who drives where no user is named
SIGHT_M = 200.0  # of pictures for people: a street ends in the distance, not where a sensor's range does


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One moment through the camera; arrays are copies."""

    rgb: U8  # (H, W, 3)
    class_id: U8  # (H, W)
    depth_m: F32  # (H, W)
    after_s: float
    in_view: int  # actors in the camera's field of view, near enough to be seen


class _FilmedDrive:
    """A world with one chair, made to be looked at."""

    def __init__(
        self, town: Town, seed: int, width: int, settings: tuple[str, ...] = (), profile: str = FILMED_USER
    ) -> None:
        camera = CameraConfig(width_px=width, height_px=width * 3 // 4, rgb=True, range_m=SIGHT_M)
        config = RunConfig(cameras=(camera,), world=WorldConfig(mirror_radius_m=SIGHT_M))
        config = resolve(config, settings)
        self.world = World(town, config, (SeatSpec(profile=profile),), seed)
        self._camera = config.cameras[0]
        self.tick_s = self.world.config.world.tick_s

    def go_on(self) -> Snapshot:
        """One tick."""
        return next(rollout(self.world)).after

    def busiest_moment(self, seconds: float) -> Shot:
        """Drive for a while and keep the moment when most actors, and most of them, are in the picture."""
        busiest = BusiestMoment(self)
        for tick in range(max(1, round(seconds / self.tick_s))):
            self.go_on()
            busiest.look((tick + 1) * self.tick_s)
        return busiest.shot

    def film(self, path: Path) -> _Film:
        """Begin a video of what comes."""
        return _Film(self, path)

    def picture(self, chart: MapView) -> tuple[CameraFrame, U8]:
        """The camera's frame of now, and the map around the chair."""
        return self.world.snapshot.clients[0].sensors.cameras[0], map_view(chart, self.world)

    def open_map(self, size_px: int) -> MapView:
        """A map of the town for `picture`; only videos need one."""
        return MapView(self.world.street.mesh, size_px, MAP_SPAN_M)

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self.world.close()

    @property
    def camera(self) -> CameraConfig:
        """The chair's camera."""
        return self._camera

    def shot(self, after_s: float) -> Shot:
        """What the camera sees now, so long after the beginning."""
        snapshot = self.world.snapshot
        frame = snapshot.clients[0].sensors.cameras[0]
        if frame.rgb is None:
            raise ConfigError("the stage's camera draws no colours; it is made with rgb=True")
        return Shot(
            rgb=frame.rgb.copy(),
            class_id=frame.class_id.copy(),
            depth_m=frame.depth_m.copy(),
            after_s=after_s,
            in_view=self._in_view(snapshot),
        )

    def business(self) -> float:
        """How much of interest is in the picture now: actors, and how large they are; below 0 for hardly any."""
        frame = self.world.snapshot.clients[0].sensors.cameras[0]
        pixels = int(np.isin(frame.class_id, _ACTOR_CLASSES).sum())
        if pixels <= _IN_VIEW_PX:
            return -1.0
        return self._in_view(self.world.snapshot) + min(1.0, pixels / (0.05 * frame.class_id.size))

    def _in_view(self, snapshot: Snapshot) -> int:
        """Actors within reach, inside the camera's horizontal field of view, and not behind something nearer."""
        plant = snapshot.clients[0].plant
        frame = snapshot.clients[0].sensors.cameras[0]
        half = np.tan(rad(self._camera.hfov_deg) / 2)
        ahead = np.array([np.cos(plant.yaw_rad), np.sin(plant.yaw_rad)])
        right = np.array([ahead[1], -ahead[0]])
        count = 0
        for actor in snapshot.actors:
            gap = actor.p_W_m[:2] - plant.p_WB_m[:2]
            along, aside = float(gap @ ahead), float(gap @ right)
            if not 1.0 < along < _FIELD_OF_VIEW_M or abs(aside) > half * along:
                continue
            column = int((0.5 + 0.5 * aside / (half * along)) * (frame.class_id.shape[1] - 1))
            stripe = slice(max(0, column - 2), column + 3)
            seen = np.isin(frame.class_id[:, stripe], _ACTOR_CLASSES) & (frame.depth_m[:, stripe] > along - 4.0)
            count += bool(seen.any())
        return count


class BusiestMoment:
    """Keeps, while a stage goes on, the moment when most actors, and most of them, were in the picture."""

    def __init__(self, stage: _FilmedDrive, fits: bool = True) -> None:
        """Begins with now, which stays if nothing better comes; see `look`."""
        self._stage, self._best = stage, (fits, -1.0)
        self.shot = stage.shot(0.0)

    def look(self, after_s: float, fits: bool = True) -> bool:
        """Take this moment instead, if there is more in it, or if it is the first that fits; whether it was taken.

        Args:
            after_s: Since the beginning.
            fits: Whether it is what the caller wants; one that is not is never taken after one that is.
        """
        now = (fits, self._stage.business())
        if now <= self._best:
            return False
        self.shot, self._best = self._stage.shot(after_s), now
        return True


class _Film:
    """A video of a stage: the camera beside a map; a context manager."""

    def __init__(self, stage: _FilmedDrive, path: Path) -> None:
        self._stage, self.tick_s, self._ticks = stage, stage.tick_s, 0
        height = stage.camera.height_px
        self._map = stage.open_map(height)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{path.parent}: cannot be made ({error.strerror}); choose another place") from None
        self._writer = VideoWriter(path, 1.0 / stage.tick_s, (stage.camera.width_px + height, height))

    def drive(self) -> Snapshot:
        """Drive one tick without a picture."""
        self._ticks += 1
        return self._stage.go_on()

    def add(self) -> None:
        """Drive one tick and add its picture."""
        snapshot = self.drive()
        frame, chart = self._stage.picture(self._map)
        if frame.rgb is None:
            raise ConfigError("the stage's camera draws no colours; it is made with rgb=True")
        speed = float(np.hypot(*snapshot.clients[0].plant.v_B_mps[:2]))
        caption = f"{self._ticks * self.tick_s:.1f} s   {speed:.2f} m/s   {len(snapshot.actors)} actors near"
        self._writer.write(side_by_side(captioned(frame.rgb, caption), chart))

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._writer.__exit__(kind, error, at)


@contextmanager
def open_stage(
    town: Town, seed: int, width: int, settings: tuple[str, ...] = (), profile: str = FILMED_USER
) -> Iterator[_FilmedDrive]:
    """A stage that is closed at the end.

    Args:
        town: Where.
        seed: Of the world.
        width: Of the camera's picture in pixels.
        settings: section.key=value, laid over the usual ones.
        profile: Of the user who drives.

    Raises:
        TownError: The town cannot be opened.
        ConfigError: The width is out of bounds, there is no such user, or the settings cannot be.
    """
    if not 64 <= width <= 1920:
        raise ConfigError(f"a picture cannot be {width} pixels wide; expected 64 to 1920")
    stage = _FilmedDrive(town, seed, width, settings, profile)
    try:
        yield stage
    finally:
        stage.close()

"""A run: all sections together, and what they must agree on."""

import hashlib
from typing import Annotated, Final, Self

from pydantic import Field, model_validator

from wcsim.config.base import Model, exclude_if
from wcsim.config.chair import ChairConfig
from wcsim.config.env import EnvConfig, RewardConfig
from wcsim.config.learn import CollectConfig, DangerConfig, LearnConfig
from wcsim.config.sensors import CameraConfig, ImuConfig, SensorsConfig
from wcsim.config.world import EPOCH_TICKS, VaryConfig, WorldConfig

# Longest episodes in the life of a shared world.
_EPOCH_EPISODES: Final = 10

# Pixels of all images in an observation.
MAX_SEEN_PX: Final = 1 << 22

# Pixels of all images in a batch.
_MAX_BATCH_PX: Final = 1 << 29

# As many as a frame of a served world has room for.
MAX_CAMERAS: Final = 64

# Pixels of all cameras of a chair.
_MAX_CAMERAS_PX: Final = 1 << 25


class RunConfig(Model):
    """Everything a run needs besides its town and seed."""

    world: WorldConfig = WorldConfig()
    chair: ChairConfig = ChairConfig()
    cameras: Annotated[tuple[CameraConfig, ...], Field(min_length=1, max_length=MAX_CAMERAS)] = (
        CameraConfig(),
    )
    imu: ImuConfig = ImuConfig()
    sensors: Annotated[SensorsConfig, Field(exclude_if=lambda sensors: not sensors.on())] = (
        SensorsConfig()
    )
    reward: RewardConfig = RewardConfig()
    env: EnvConfig = EnvConfig()
    learn: LearnConfig = LearnConfig()
    vary: VaryConfig = VaryConfig()
    collect: Annotated[CollectConfig, exclude_if(CollectConfig())] = CollectConfig()
    danger: Annotated[DangerConfig, exclude_if(DangerConfig())] = DangerConfig()

    @property
    def eyes(self) -> dict[str, CameraConfig]:
        """The cameras that are seen, by what stands before their keys in an observation.

        That is nothing for the first one, and the name with an underscore for others.
        """
        given, first = self.env.camera, self.cameras[0]
        names = (given,) if isinstance(given, str) else given
        named = {camera.name: camera for camera in self.cameras}
        seen = [named.get(name, first) for name in names]
        return {"": seen[0], **{f"{camera.name}_": camera for camera in seen[1:]}}

    @property
    def eye(self) -> CameraConfig:
        """The first camera that is seen, and the only one of networks that see one picture."""
        return self.eyes[""]

    @property
    def epoch_ticks(self) -> int:
        """Ticks after which a new world replaces a shared one, and cuts few episodes. 0: never."""
        given = self.world.epoch_ticks
        return (
            max(EPOCH_TICKS, _EPOCH_EPISODES * self.learn.episode_steps) if given is None else given
        )

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        if self.imu.saturation_mps2 <= self.reward.accel_window_mps2[1]:
            raise ValueError(
                f"imu.saturation_mps2 {self.imu.saturation_mps2} hides reward.accel_window_mps2 "
                f"{self.reward.accel_window_mps2}; expected a higher saturation"
            )
        # Cameras of films may see empty streets far away.
        eye = max(self.eyes.values(), key=lambda camera: camera.range_m)
        if eye.range_m > self.world.mirror_radius_m:
            raise ValueError(
                f"camera {eye.name!r} has range_m {eye.range_m:g}, but road users are "
                f"drawn only within world.mirror_radius_m {self.world.mirror_radius_m:g}; expected "
                f"no more: set world.mirror_radius_m={eye.range_m:g}, or a smaller range_m"
            )
        return self

    @model_validator(mode="after")
    def _cameras_have_names_of_their_own(self) -> Self:
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"cameras are named {names}; expected a different name for each")
        given = self.env.camera
        listed = (given,) if isinstance(given, str) else given
        seen = {name or names[0] for name in listed}
        if not seen <= {*names} or len(seen) < len(listed):
            raise ValueError(
                f"env.camera is {given!r}; expected the name of a camera: {', '.join(names)}; in a "
                "list each once"
            )
        for camera in self.eyes.values():
            if self.env.observation == "compact_rgb" and not camera.rgb:
                raise ValueError(
                    f"env.observation=compact_rgb with camera {camera.name!r}, which draws no "
                    f"colours; expected cameras.{names.index(camera.name)}.rgb=true"
                )
        return self

    @model_validator(mode="after")
    def _pictures_can_be_held(self) -> Self:
        sizes_px = [camera.width_px * camera.height_px for camera in self.cameras]
        eyes = self.eyes.values()
        seen_px = self.env.frames * sum(camera.width_px * camera.height_px for camera in eyes)
        if sum(sizes_px) > _MAX_CAMERAS_PX or seen_px > MAX_SEEN_PX:
            raise ValueError(
                f"{len(sizes_px)} cameras have {sum(sizes_px)} pixels, the {self.env.frames} "
                f"images of an observation {seen_px}; expected at most {_MAX_CAMERAS_PX} and "
                f"{MAX_SEEN_PX}: make width_px and height_px smaller, or env.window"
            )
        # A danger network gets no pictures.
        batch = self.learn.batch_size
        if self.learn.memory == "groups":
            # A group is drawn with its burn-in, and with the steps of its last return.
            groups = max(1, round(self.learn.batch_size / self.learn.group_steps))
            batch = max(
                batch, groups * (self.learn.group_steps + self.learn.burn_in + self.learn.n_step)
            )
        if seen_px * batch > _MAX_BATCH_PX:
            raise ValueError(
                f"a batch of {batch} observations has {seen_px * batch} pixels; expected at most "
                f"{_MAX_BATCH_PX}: make learn.batch_size smaller, or the pictures"
            )
        return self

    def digest(self) -> str:
        """SHA-256 over the resolved configuration."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    def world_digest(self) -> str:
        """SHA-256 over the settings that all clients of one world share."""
        # Of `env` the actions alone: observations and users are a client's own.
        shared = {"world", "chair", "cameras", "imu", "sensors", "reward", "vary"}
        text = self.model_dump_json(include={**dict.fromkeys(shared, True), "env": {"actions"}})
        return hashlib.sha256(text.encode()).hexdigest()

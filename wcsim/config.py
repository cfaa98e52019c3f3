"""Every file that wcsim reads from disk, as frozen models: an unknown key or a number out of bounds is an error.

Angles are in degrees in keys that end in `_deg`, and nowhere else. Presets are TOML files in `wcsim/presets/`.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator

from wcsim import reading
from wcsim.errors import ConfigError
from wcsim.model import Finite as Finite
from wcsim.model import Model as Model
from wcsim.model import NotNegative as NotNegative
from wcsim.model import Positive as Positive
from wcsim.model import Share as Share
from wcsim.model import Text as Text
from wcsim.model import Word as Word
from wcsim.model import fault
from wcsim.reading import FileKind, shown
from wcsim.sensors_file import CameraConfig as CameraConfig
from wcsim.sensors_file import CameraNoiseConfig as CameraNoiseConfig
from wcsim.sensors_file import ClassNoiseConfig as ClassNoiseConfig
from wcsim.sensors_file import ColourNoiseConfig as ColourNoiseConfig
from wcsim.sensors_file import DepthNoiseConfig as DepthNoiseConfig
from wcsim.sensors_file import ImuConfig as ImuConfig
from wcsim.vary_file import Driver, Reaction, Watcher
from wcsim.vary_file import VaryConfig as VaryConfig

CONFIG_FILE = FileKind(what="a TOML file of at most a megabyte", limit_bytes=1 << 20)
_JSON = FileKind(what="a configuration", limit_bytes=1 << 20)
_VALUE = FileKind(what="a value in TOML's syntax", limit_bytes=1 << 20)
MAX_SEEN_PX = 1 << 22  # of all images in an observation
MAX_BATCH_PX = 1 << 29  # of all images that are learned from at a time
MAX_CAMERAS = 64  # as many as a frame of a served world has room for
MAX_CAMERAS_PX = 1 << 25  # of all cameras of a chair
_FAULTS = 12  # that are told of one file
_PARTS = 16  # of a key of `--set`


PROFILE_SPEED_MPS: dict[str, float] = {"indoor": 0.6, "pavement": 1.67, "road": 2.78}


class ChairConfig(Model):
    """The wheelchair as it is driven: its plant, and what its controller is programmed to."""

    plant: Text = "rwd"  # or "mwd", or the path of a .toml file
    profile: Literal["custom", "indoor", "pavement", "road"] = "custom"  # a named v_max_mps
    v_max_mps: Annotated[float, Field(gt=0.1, le=5.0)] = 1.67
    reverse_share: Share = 0.4
    accel_mps2: Positive = 1.0
    decel_mps2: Positive = 1.5
    yaw_accel_radps2: Positive = 2.5
    jerk_mps3: Positive = 4.0
    yaw_rate_max_radps: Positive = 1.5
    deadband: Annotated[float, Field(ge=0.0, le=0.5)] = 0.08
    shape_exponent: Annotated[float, Field(ge=1.0, le=3.0)] = 1.0
    tremor_damping_s: Annotated[float, Field(ge=0.0, le=0.4)] = 0.0  # time constant of a low-pass on the joystick
    brake_after_s: NotNegative = 0.5
    user_mass_kg: Annotated[float, Field(ge=25.0, le=150.0)] | None = None  # None keeps the plant's own
    com_height_m: Annotated[float, Field(ge=0.3, le=0.9)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _profile_names_the_speed(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        speed_mps = PROFILE_SPEED_MPS.get(str(data.get("profile")))
        if speed_mps is None:
            return data
        got = data.get("v_max_mps", speed_mps)
        if got != speed_mps:
            raise ValueError(
                f"profile {data['profile']!r} drives at {speed_mps} m/s, v_max_mps is {got}; expected the same speed: "
                f"set v_max_mps to {speed_mps}, or profile to custom"
            )
        return {**data, "v_max_mps": speed_mps}


STREETS: dict[str, tuple[float, float] | None] = {"usual": None, "careless": (0.7, 1.5)}
"""Streets by name: the share of those who look and their reaction time in seconds; None: as the settings say."""


class WorldConfig(Model):
    """Clocks, mirror and street reaction."""

    tick_s: Annotated[float, Field(ge=0.02, le=1.0)] = 0.1
    substeps: Annotated[int, Field(ge=1, le=480)] = 24
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 240.0
    demand_scale: Annotated[float, Field(ge=0.0, le=10.0)] = 1.0
    mirror_radius_m: Annotated[float, Field(ge=5.0, le=300.0)] = 50.0
    jam_teleport_s: Annotated[float, Field(ge=-1.0, le=36000.0)] | None = None  # None keeps the scenario's own
    action_step_s: Annotated[float, Field(ge=0.02, le=10.0)] | None = None  # how often SUMO's drivers decide
    street: Literal["usual", "careless"] = "usual"  # a careless one sets the next two
    attention_share: Share = 0.95
    reaction_s: Reaction = 0.7
    attention: Annotated[dict[Watcher, Share], Field(max_length=16)] = Field(default_factory=dict)  # by class
    reaction: Annotated[dict[Driver, Reaction], Field(max_length=16)] = Field(default_factory=dict)  # seconds, by class
    brake_mps2: Annotated[float, Field(gt=0.0, le=100.0)] = 4.5
    clear_spawn_m: Annotated[float, Field(gt=0.0, le=1000.0)] = 2.0
    crossing_share: Share = 0.5  # of destinations that are drawn beyond a crossing nearby
    action_delay_ticks: Annotated[int, Field(ge=0, le=10)] = 0  # from an action to the chair that obeys it
    visible_px: Annotated[float, Field(ge=1.0, le=76800.0)] = 16.0  # of 320x240, from which on an actor is visible
    visible_s: Annotated[float, Field(ge=0.0, le=60.0)] = 1.0  # for which it stays known when it is not any more

    @model_validator(mode="after")
    def _substep_is_sane(self) -> WorldConfig:
        substep_s = self.tick_s / self.substeps
        if not 1 / 1000 <= substep_s <= 1 / 100:
            raise ValueError(
                f"tick_s {self.tick_s} / substeps {self.substeps} gives a physics step of {substep_s:.5f} s; "
                "expected 0.001 to 0.01 s: change world.substeps"
            )
        return self


JoystickDistance = Annotated[float, Field(gt=0.0, le=100.0)]
LEAST_WINDOW = 1e-6  # from low to high; a share of nothing would be no number


class RewardConfig(Model):
    """Windows of Tables 1 and 2 of the paper, and the share of contacts that counts as a crash."""

    base: Finite = 1.0
    max_follow_distance: JoystickDistance = 0.1768  # sqrt(0.125^2 + 0.125^2)
    max_distance: JoystickDistance = 2.0
    penalty: NotNegative = 2.0
    accel_window_mps2: tuple[Positive, Positive] = (20.0, 40.0)
    roll_window_deg: tuple[Positive, Positive] = (5.0, 20.0)
    pitch_window_deg: tuple[Positive, Positive] = (20.0, 30.0)
    crash: NotNegative = 100.0
    body_on_ground_Ns: NotNegative = 20.0
    drop: bool = True  # beyond the paper: a wheel that falls off a kerb is a crash

    @model_validator(mode="after")
    def _windows_are_open(self) -> RewardConfig:
        windows = (self.accel_window_mps2, self.roll_window_deg, self.pitch_window_deg)
        if any(high - low < LEAST_WINDOW for low, high in (*windows, (self.max_follow_distance, self.max_distance))):
            raise ValueError("a window or the pair max_follow_distance, max_distance is empty; expected low < high")
        return self


Window = Annotated[int, Field(ge=1, le=16)]
Steps = Annotated[int, Field(ge=1, le=10**9)]
StepsOrNone = Annotated[int, Field(ge=0, le=10**9)]


class EnvConfig(Model):
    """What the agent sees and does."""

    observation: Literal["compact", "table3"] = "compact"
    classes: Literal["cityscapes", "wcsim"] = "cityscapes"
    observe_gyro: bool = False  # beyond the paper: the turn rates among what the agent sees
    observe_yaw: bool = False  # and the heading
    window: Window | None = None  # images of the last ticks in an observation; None: as the network prefers
    actions: Literal["square81", "disc69"] = "square81"
    max_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000
    profile: Text = "inattentive"  # of the simulated user, or recorded:FILE.csv (docs/user.md)
    truth: bool = False
    truth_visible: bool = False  # the truth, and what the oracle says that knows only whom the cameras showed lately

    @model_validator(mode="after")
    def _window_is_compact(self) -> EnvConfig:
        if self.observation != "compact" and self.frames > 1:
            raise ValueError(
                f"window {self.window} with observation {self.observation!r}; expected one image in this form: "
                "set env.window=1, or env.observation=compact"
            )
        return self

    @property
    def frames(self) -> int:
        """Images in an observation: `window`, or one as long as no network was asked."""
        return 1 if self.window is None else self.window


class LearnConfig(Model):
    """Both learning phases."""

    total_steps: Steps = 20_000
    phase1_steps: StepsOrNone = 5_000
    network: Word = "small"
    head: Literal["residual", "plain"] = "residual"
    gamma: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.97
    learning_rate: Positive = 3e-4
    learning_rate_fade: Share = 0.0  # last share of the run, over which the learning rate falls to zero
    batch_size: Annotated[int, Field(ge=1, le=4096)] = 32
    replay_frames: Annotated[int, Field(ge=100, le=10**7)] = 50_000
    learning_starts: StepsOrNone = 500
    train_every: Annotated[int, Field(ge=1, le=10**4)] = 4
    gradient_steps: Annotated[int, Field(ge=1, le=10**4)] = 1
    n_step: Annotated[int, Field(ge=1, le=50)] = 5
    tau: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    reward_scale: Positive = 0.05
    clip_norm: Positive = 10.0
    double_q: bool = True
    margin: NotNegative = 1.0
    margin_fade: Share = 0.25
    precrash_share: Share = 0.25
    precrash_window: Annotated[int, Field(ge=1, le=10**6)] = 20
    exploration: Literal["local", "uniform"] = "local"
    epsilon_start: Share = 0.2
    epsilon_end: Share = 0.05
    epsilon_sigma: Positive = 0.5
    epsilon_hold: Annotated[int, Field(ge=1, le=100)] = 1  # steps that an explored offset from the stick is held
    aid: Literal["none", "oracle"] = "none"  # beyond the paper: safe actions from the privileged truth, in training
    aid_weight: NotNegative = 1.0
    aid_batch: Annotated[int, Field(ge=1, le=4096)] = 32
    aid_margin: NotNegative = 1.0  # joystick distance by which an unsafe action must lose more than a safe one
    aid_share: Share = 0.5  # of the aid's batch, from steps in which some action ends badly
    aid_ahead: Annotated[int, Field(ge=0, le=50)] = 0  # steps before it ends badly in which an action is unsafe already
    aid_relabel: Share = 0.5  # of the aid's batch, with another joystick than the user's
    mirror: bool = False  # batches are mirrored left to right half of the time
    checkpoint_every: Steps = 5_000
    threads: Annotated[int, Field(ge=1, le=64)] = 1
    device: Word = "cpu"
    episode_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 1_000


class RunConfig(Model):
    """Everything a run needs besides its town and seed."""

    world: WorldConfig = WorldConfig()
    chair: ChairConfig = ChairConfig()
    cameras: Annotated[tuple[CameraConfig, ...], Field(min_length=1, max_length=MAX_CAMERAS)] = (CameraConfig(),)
    imu: ImuConfig = ImuConfig()
    reward: RewardConfig = RewardConfig()
    env: EnvConfig = EnvConfig()
    learn: LearnConfig = LearnConfig()
    vary: VaryConfig = VaryConfig()

    @model_validator(mode="after")
    def _parts_fit(self) -> RunConfig:
        if self.imu.saturation_mps2 <= self.reward.accel_window_mps2[1]:
            raise ValueError(
                f"imu.saturation_mps2 {self.imu.saturation_mps2} hides reward.accel_window_mps2 "
                f"{self.reward.accel_window_mps2}; expected a higher saturation"
            )
        return self

    @model_validator(mode="after")
    def _cameras_have_names_of_their_own(self) -> RunConfig:
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"cameras are named {names}; expected each to have a name of its own")
        return self

    @model_validator(mode="after")
    def _pictures_can_be_held(self) -> RunConfig:
        sizes_px = [camera.width_px * camera.height_px for camera in self.cameras]
        if sum(sizes_px) > MAX_CAMERAS_PX or sizes_px[0] * self.env.frames > MAX_SEEN_PX:
            raise ValueError(
                f"{len(sizes_px)} cameras have {sum(sizes_px)} pixels, the {self.env.frames} images of an observation "
                f"{sizes_px[0] * self.env.frames}; expected at most {MAX_CAMERAS_PX} and {MAX_SEEN_PX}: make "
                "width_px and height_px smaller, or env.window"
            )
        batch = max(self.learn.batch_size, self.learn.aid_batch)
        if sizes_px[0] * self.env.frames * batch > MAX_BATCH_PX:
            raise ValueError(
                f"a batch of {batch} observations has {sizes_px[0] * self.env.frames * batch} pixels; expected at most "
                f"{MAX_BATCH_PX}: make learn.batch_size or learn.aid_batch smaller, or the pictures"
            )
        return self

    def digest(self) -> str:
        """SHA-256 over the resolved configuration."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    def world_digest(self) -> str:
        """SHA-256 over what all clients of one world share: all but what each learns with and sees of its pictures."""
        shared = {"world", "chair", "cameras", "imu", "reward", "vary"}
        text = self.model_dump_json(include={**dict.fromkeys(shared, True), "env": {"actions"}})
        return hashlib.sha256(text.encode()).hexdigest()


ChairWay = Literal["sidewalk", "crossing", "cycleway", "shared"]
NetMetre = Annotated[int, Field(ge=-(10**9), le=10**9)]


class TownFile(Model):
    """`town.toml`: what SUMO does not know about a town."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    split: Literal["train", "test", "scene"]
    origin_m: tuple[NetMetre, NetMetre] = (0, 0)  # net coordinates of W's origin
    kerb_height_m: Annotated[float, Field(ge=0.0, le=0.4)] = 0.12
    lowered_kerb_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    chair_ways: Annotated[tuple[ChairWay, ...], Field(max_length=16)] = ("sidewalk", "crossing", "shared")
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] | None = None
    sumocfg: Text = ""  # where the scenario lies, when it is not the only .sumocfg beside this file
    source: Text = ""
    attribution: Text = ""
    rebuild: Text = ""  # the command that makes the town again from what its folder holds
    hashes: Annotated[dict[Text, Word], Field(max_length=4096)] = Field(default_factory=dict)


M = TypeVar("M", bound=Model)


def read_toml(path: Path, model: type[M]) -> M:
    """Read a TOML file as `model`. Raises ConfigError with its faults and their places."""
    return parse(model, reading.read_toml(path, CONFIG_FILE), shown(path))


def parse(model: type[M], data: dict[str, Any], where: str) -> M:
    """Check `data` against `model`. Raises ConfigError that names `where`, the key, what was got and expected."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        found = error.errors()
        told = [fault(model, item) for item in found[:_FAULTS]]
        more = [f"and {len(found) - _FAULTS} more"] if len(found) > _FAULTS else []
        raise ConfigError(f"{where}: " + "; ".join([*told, *more])) from None


def parse_json(model: type[M], text: str, where: str) -> M:
    """Check JSON text as `parse` does its data."""
    return parse(model, reading.parse_json(text, where, _JSON), where)


def load_run_config(preset: str, overrides: tuple[str, ...] = (), file: Path | None = None) -> RunConfig:
    """A preset by name, a TOML file over it, then `section.key=value` overrides (value in TOML syntax or a word)."""
    folder = Path(__file__).parent / "presets"
    path = folder / f"{preset}.toml"
    if not path.is_file():
        known = ", ".join(sorted(item.stem for item in folder.glob("*.toml")))
        raise ConfigError(f"unknown preset {shown(preset)!r}; expected one of: {known}")
    data = reading.read_toml(path, CONFIG_FILE)
    where = f"preset {preset}"
    if file is not None:
        data, where = _merged(data, reading.read_toml(file, CONFIG_FILE)), shown(file)
    return _overridden(data, overrides, where)


def with_overrides(config: RunConfig, overrides: tuple[str, ...]) -> RunConfig:
    """A resolved configuration with `section.key=value` laid over it. Raises ConfigError as `load_run_config` does."""
    return _overridden(config.model_dump(mode="json"), overrides, "configuration")


def with_file(config: RunConfig, file: Path) -> RunConfig:
    """A resolved configuration with a TOML file laid over it. Raises ConfigError as `load_run_config` does."""
    return parse(RunConfig, _merged(config.model_dump(mode="json"), reading.read_toml(file, CONFIG_FILE)), shown(file))


def _overridden(data: dict[str, Any], overrides: tuple[str, ...], where: str) -> RunConfig:
    for text in overrides:
        data, where = _merged(data, _override(text)), f"--set {shown(text)}"
    return parse(RunConfig, data, where)


def _override(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    where = f"--set {shown(text)}"
    if not equals or not all(parts) or len(parts) > _PARTS:
        raise ConfigError(f"--set {shown(text)!r} is not section.key=value, for example learn.total_steps=2000")
    try:
        table = reading.parse_toml(f"value = {value}", where, _VALUE)
    except ConfigError:
        if value.strip()[:1] in ("[", "{", '"', "'"):
            raise
        table = {"value": value}  # a word, as in env.profile=competent
    parsed: Any = table["value"] if len(table) == 1 else value
    for part in reversed(parts):
        parsed = {part: parsed}
    return dict(parsed)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` laid on `base`; tables are merged, everything else replaced. A list takes its items by number."""
    return {**base, **{key: _laid(base.get(key), value, key) for key, value in over.items()}}


def _laid(old: Any, value: Any, key: str) -> Any:
    if isinstance(old, dict) and isinstance(value, dict):
        return _merged(old, value)
    if isinstance(old, list) and isinstance(value, dict):
        strange = [shown(item, 40) for item in value if item not in map(str, range(len(old)))]
        if strange:
            raise ConfigError(_no_such_item(key, strange[0], len(old)))
        return [_laid(item, value[str(i)], str(i)) if str(i) in value else item for i, item in enumerate(old)]
    return value


def _no_such_item(key: str, item: str, count: int) -> str:
    """What is wrong with `key.item` of a list."""
    known = f"{key}.0" if count == 1 else f"{key}.0 to {key}.{count - 1}"
    more = f"; a FILE for --config that holds [[{key}]] once for each makes more" if key == "cameras" else ""
    return f"{key}.{item}: there is no such item, the list {key} has {count}; expected {known}{more}"

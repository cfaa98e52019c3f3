"""Every file that wcsim reads from disk, as frozen models: an unknown key or a number out of bounds is an error.

Angles are in degrees in keys that end in `_deg`, and nowhere else. Presets are TOML files in `wcsim/presets/`.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator

from wcsim.errors import ConfigError
from wcsim.model import Finite as Finite
from wcsim.model import Model as Model
from wcsim.model import NotNegative as NotNegative
from wcsim.model import Positive as Positive
from wcsim.model import Share as Share
from wcsim.model import fault
from wcsim.sensors_file import CameraConfig as CameraConfig
from wcsim.sensors_file import CameraNoiseConfig as CameraNoiseConfig
from wcsim.sensors_file import ClassNoiseConfig as ClassNoiseConfig
from wcsim.sensors_file import ColourNoiseConfig as ColourNoiseConfig
from wcsim.sensors_file import DepthNoiseConfig as DepthNoiseConfig
from wcsim.sensors_file import ImuConfig as ImuConfig
from wcsim.vary_file import VaryConfig as VaryConfig

YAW_SLOWDOWN_S_PER_M = 0.6  # of every chair: its fastest turn falls as 1 / (1 + 0.6 v)
MAX_CONFIG_BYTES = 1 << 20


PROFILE_SPEED_MPS: dict[str, float] = {"indoor": 0.6, "pavement": 1.67, "road": 2.78}


class ChairConfig(Model):
    """The wheelchair as it is driven: its plant, and what its controller is programmed to."""

    plant: str = "rwd"  # or "mwd", or the path of a .toml file
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


class WorldConfig(Model):
    """Clocks, mirror and street reaction."""

    tick_s: Annotated[float, Field(ge=0.02, le=1.0)] = 0.1
    substeps: Annotated[int, Field(ge=1, le=480)] = 24
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 240.0
    demand_scale: Annotated[float, Field(ge=0.0, le=10.0)] = 1.0
    mirror_radius_m: Annotated[float, Field(ge=5.0, le=300.0)] = 50.0
    jam_teleport_s: Annotated[float, Field(ge=-1.0, le=36000.0)] | None = None  # None keeps the scenario's own
    attention_share: Share = 0.95
    reaction_s: NotNegative = 0.7
    brake_mps2: Positive = 4.5
    clear_spawn_m: Positive = 2.0
    action_delay_ticks: Annotated[int, Field(ge=0, le=10)] = 0  # from an action to the chair that obeys it

    @model_validator(mode="after")
    def _substep_is_sane(self) -> WorldConfig:
        substep_s = self.tick_s / self.substeps
        if not 1 / 1000 <= substep_s <= 1 / 100:
            raise ValueError(
                f"tick_s {self.tick_s} / substeps {self.substeps} gives a physics step of {substep_s:.5f} s; "
                "expected 0.001 to 0.01 s: change world.substeps"
            )
        return self


class RewardConfig(Model):
    """Windows of Tables 1 and 2 of the paper, and the share of contacts that counts as a crash."""

    base: Finite = 1.0
    max_follow_distance: Positive = 0.1768  # sqrt(0.125^2 + 0.125^2)
    max_distance: Positive = 2.0
    penalty: NotNegative = 2.0
    accel_window_mps2: tuple[Positive, Positive] = (20.0, 40.0)
    roll_window_deg: tuple[Positive, Positive] = (5.0, 20.0)
    pitch_window_deg: tuple[Positive, Positive] = (20.0, 30.0)
    crash: NotNegative = 100.0
    body_on_ground_Ns: NotNegative = 20.0

    @model_validator(mode="after")
    def _windows_are_open(self) -> RewardConfig:
        windows = (self.accel_window_mps2, self.roll_window_deg, self.pitch_window_deg)
        if any(low >= high for low, high in (*windows, (self.max_follow_distance, self.max_distance))):
            raise ValueError("a window or the pair max_follow_distance, max_distance is empty; expected low < high")
        return self


Window = Annotated[int, Field(ge=1, le=16)]


class EnvConfig(Model):
    """What the agent sees and does."""

    observation: Literal["compact", "table3"] = "compact"
    classes: Literal["cityscapes", "wcsim"] = "cityscapes"
    observe_gyro: bool = False  # beyond the paper: the turn rates among what the agent sees
    observe_yaw: bool = False  # and the heading
    window: Window | None = None  # images of the last ticks in an observation; None: as the network prefers
    actions: Literal["square81", "disc69"] = "square81"
    max_steps: Annotated[int, Field(ge=1, le=1_000_000)] = 10_000
    profile: str = "inattentive"  # of the simulated user, or recorded:FILE.csv (docs/user.md)
    truth: bool = False

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

    total_steps: Annotated[int, Field(ge=1)] = 20_000
    phase1_steps: Annotated[int, Field(ge=0)] = 5_000
    network: str = "small"
    head: Literal["residual", "plain"] = "residual"
    gamma: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.97
    learning_rate: Positive = 3e-4
    learning_rate_fade: Share = 0.0  # last share of the run, over which the learning rate falls to zero
    batch_size: Annotated[int, Field(ge=1, le=4096)] = 32
    replay_frames: Annotated[int, Field(ge=100)] = 50_000
    learning_starts: Annotated[int, Field(ge=0)] = 500
    train_every: Annotated[int, Field(ge=1)] = 4
    gradient_steps: Annotated[int, Field(ge=1)] = 1
    n_step: Annotated[int, Field(ge=1, le=50)] = 5
    tau: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    reward_scale: Positive = 0.05
    clip_norm: Positive = 10.0
    double_q: bool = True
    margin: NotNegative = 1.0
    margin_fade: Share = 0.25
    precrash_share: Share = 0.25
    precrash_window: Annotated[int, Field(ge=1)] = 20
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
    checkpoint_every: Annotated[int, Field(ge=1)] = 5_000
    threads: Annotated[int, Field(ge=1, le=64)] = 1
    device: str = "cpu"
    episode_steps: Annotated[int, Field(ge=1)] = 1_000


class RunConfig(Model):
    """Everything a run needs besides its town and seed."""

    world: WorldConfig = WorldConfig()
    chair: ChairConfig = ChairConfig()
    cameras: tuple[CameraConfig, ...] = (CameraConfig(),)
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
        if not names or len(set(names)) != len(names):
            raise ValueError(f"cameras are named {names}; expected at least one, each with a name of its own")
        return self

    def digest(self) -> str:
        """SHA-256 over the resolved configuration."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    def world_digest(self) -> str:
        """SHA-256 over what all clients of one world share: all but what each learns with and sees of its pictures."""
        shared = {"world", "chair", "cameras", "imu", "reward", "vary"}
        text = self.model_dump_json(include={**dict.fromkeys(shared, True), "env": {"actions"}})
        return hashlib.sha256(text.encode()).hexdigest()


Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.:-]{1,120}$")]


class PriorFile(Model):
    """The known follow reward inside a residual network."""

    base: Finite
    max_follow_distance: Positive
    max_distance: Positive
    penalty: NotNegative
    reward_scale: Positive


class NetFile(Model):
    """The shape of an action-value network."""

    network: Name
    head: Literal["residual", "plain"]
    dueling: bool
    hidden: Annotated[int, Field(ge=1, le=65_536)]
    actions: Literal["square81", "disc69"]
    classes: Literal["cityscapes", "wcsim"]
    prior: PriorFile


class PolicyFile(Model):
    """`policy.json`: everything about a trained policy but its weights."""

    schema_version: Literal[1]
    algorithm: Literal["SeqDQN"]
    net: NetFile
    image_hw_px: tuple[Annotated[int, Field(ge=8, le=2048)], Annotated[int, Field(ge=8, le=2048)]]
    vector_size: Annotated[int, Field(ge=3, le=1024)]
    window: Window = 1
    camera: CameraConfig
    reward_scale: Positive
    manifest_sha256: Sha256 | Literal[""]
    weights_sha256: Sha256
    versions: dict[str, str] = Field(default_factory=dict)


class TownFile(Model):
    """`town.toml`: what SUMO does not know about a town."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    split: Literal["train", "test", "scene"]
    origin_m: tuple[int, int] = (0, 0)  # net coordinates of W's origin
    kerb_height_m: Annotated[float, Field(ge=0.0, le=0.4)] = 0.12
    lowered_kerb_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    chair_ways: tuple[Literal["sidewalk", "crossing", "cycleway", "shared"], ...] = ("sidewalk", "crossing", "shared")
    warmup_s: Annotated[float, Field(ge=0.0, le=3600.0)] | None = None
    sumocfg: str = ""  # where the scenario lies, when it is not the only .sumocfg beside this file
    source: str = ""
    attribution: str = ""
    rebuild: str = ""  # the command that makes the town again from what its folder holds
    hashes: dict[str, str] = Field(default_factory=dict)


M = TypeVar("M", bound=Model)


def read_toml(path: Path, model: type[M]) -> M:
    """Read a TOML file as `model`. Raises ConfigError with every fault and its place."""
    return parse(model, _toml(path), str(path))


def parse(model: type[M], data: dict[str, Any], where: str) -> M:
    """Check `data` against `model`. Raises ConfigError that names `where`, the key, what was got and expected."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{where}: " + "; ".join(fault(model, item) for item in error.errors())) from None


def parse_json(model: type[M], text: str, where: str) -> M:
    """Check JSON text as `parse` does its data."""
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where}: is not JSON: {error}") from None
    return parse(model, data, where)


def load_run_config(preset: str, overrides: tuple[str, ...] = (), file: Path | None = None) -> RunConfig:
    """A preset by name, a TOML file over it, then `section.key=value` overrides (value in TOML syntax or a word)."""
    folder = Path(__file__).parent / "presets"
    path = folder / f"{preset}.toml"
    if not path.is_file():
        known = ", ".join(sorted(item.stem for item in folder.glob("*.toml")))
        raise ConfigError(f"unknown preset {preset!r}; expected one of: {known}")
    data = _toml(path)
    where = f"preset {preset}"
    if file is not None:
        data, where = _merged(data, _toml(file)), str(file)
    for text in overrides:
        data, where = _merged(data, _override(text)), f"--set {text}"
    return parse(RunConfig, data, where)


def with_overrides(config: RunConfig, overrides: tuple[str, ...]) -> RunConfig:
    """A resolved configuration with `section.key=value` laid over it. Raises ConfigError as `load_run_config` does."""
    data, where = config.model_dump(mode="json"), "configuration"
    for text in overrides:
        data, where = _merged(data, _override(text)), f"--set {text}"
    return parse(RunConfig, data, where)


def with_file(config: RunConfig, file: Path) -> RunConfig:
    """A resolved configuration with a TOML file laid over it. Raises ConfigError as `load_run_config` does."""
    return parse(RunConfig, _merged(config.model_dump(mode="json"), _toml(file)), str(file))


def _toml(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_CONFIG_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_CONFIG_BYTES} bytes; expected a small TOML file")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); expected a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from None


def _override(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ConfigError(f"--set {text!r} is not section.key=value, for example learn.total_steps=2000")
    try:
        parsed: Any = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value
    for part in reversed(parts):
        parsed = {part: parsed}
    return dict(parsed)


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """`over` laid on `base`; tables are merged, everything else replaced. A list takes its items by number."""
    out = dict(base)
    for key, value in over.items():
        old = out.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            out[key] = _merged(old, value)
        elif isinstance(old, list) and isinstance(value, dict) and set(value) <= {str(i) for i in range(len(old))}:
            out[key] = [_merged(item, value.get(str(i), {})) for i, item in enumerate(old)]
        else:
            out[key] = value
    return out

"""Files of runs and policies as frozen models: manifests, policies, checkpoints, recorded data."""

from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import AfterValidator, Field, StrictBool, model_validator

from wcsim.config import MAX_SEEN_PX, CameraConfig, ChairConfig
from wcsim.config.base import (
    Model,
    NotNegative,
    Positive,
    PositiveShare,
    Share,
    Text,
    Texts,
    Word,
    exclude_if,
    within,
)
from wcsim.config.env import Actions, Classes, FollowRewardConfig, Form, Window
from wcsim.config.sensors import Pixels
from wcsim.core.reading import MAX_INTEGER
from wcsim.types import CLIENT_NAME

M = TypeVar("M", bound=Model)
Versions = Annotated[dict[Word, Word], Field(max_length=256)]
ClientName = Annotated[str, Field(pattern=rf"^{CLIENT_NAME}$")]  # a folder of this name is opened
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
MaybeSha256 = Sha256 | Literal[""]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.:-]{1,120}$")]
# Segments of recorded driving, by file.
Segments = Annotated[dict[Name, Sha256], Field(max_length=1_000_000)]

ConfigName = Annotated[str, Field(pattern=r"^(configs/[A-Za-z0-9_-]{1,64}|config)\.json$")]
Count = Annotated[int, Field(strict=True, ge=0, le=10**12)]  # of steps and the like
_Bits64 = Annotated[int, Field(strict=True, ge=0, lt=1 << 64)]
_Whole = Annotated[int, within(0, 10**15)]
_Measured = Annotated[float, Field(ge=0.0, le=1e15, allow_inf_nan=False)]
_Seconds = Annotated[float, Field(gt=0.0, le=10.0)]


def _all_named(model: M) -> M:
    """Return a model that its file names in full: what is left out there is no default."""
    # Files are older than `stateful` and `value`: without them a network has none.
    left_out = type(model).model_fields.keys() - model.model_fields_set - {"stateful", "value"}
    if left_out:
        raise ValueError(f"{', '.join(sorted(left_out))} is missing")
    for name in type(model).model_fields:
        if isinstance(part := getattr(model, name), Model):
            _all_named(part)
    return model


class FollowPrior(FollowRewardConfig):
    """The reward for following the user, known for every action without learning.

    Its numbers are those of Tables 1 and 2 of the paper.
    """

    reward_scale: Positive = 0.05


class NetSpec(Model):
    """Everything that an action-value network depends on besides the spaces."""

    network: Name = "patch"
    head: Literal["residual", "plain"] = "residual"
    dueling: bool = True
    hidden: Annotated[int, within(1, 65_536)] = 128
    actions: Actions = "square81"
    classes: Classes = "cityscapes"
    prior: FollowPrior = FollowPrior()
    stateful: bool = False  # carries a state from tick to tick, and sees one image at a time


class QPolicyFile(Model):
    """`policy.json`: everything about a trained policy but its weights."""

    schema_version: Literal[1]
    algorithm: Literal["SeqDQN"]
    net: Annotated[NetSpec, AfterValidator(_all_named)]
    image_hw_px: tuple[Pixels, Pixels]
    vector_size: Annotated[int, within(3, 1024)]
    # How many of these numbers each sensor of [sensors] gives.
    sensors: Annotated[dict[Name, Annotated[int, within(1, 1021)]], Field(max_length=64)] = Field(
        default_factory=dict
    )
    window: Window = 1
    observation: Form = "compact"
    camera: CameraConfig
    reward_scale: Positive
    manifest_sha256: MaybeSha256
    weights_sha256: Sha256
    versions: Versions = Field(default_factory=dict)

    @model_validator(mode="after")
    def _has_an_imu(self) -> Self:
        if self.vector_size - sum(self.sensors.values()) < 3:
            raise ValueError(
                f"vector_size {self.vector_size} with sensors {self.sensors}; expected 3 more than "
                "theirs"
            )
        return self

    @model_validator(mode="after")
    def _pictures_can_be_held(self) -> Self:
        seen_px = self.image_hw_px[0] * self.image_hw_px[1] * self.window
        if seen_px > MAX_SEEN_PX:
            raise ValueError(
                f"image_hw_px {list(self.image_hw_px)} in a window of {self.window} are {seen_px} "
                f"pixels; expected at most {MAX_SEEN_PX}"
            )
        return self


class DangerNetworkShape(Model):
    """The shape of a danger network."""

    width: Annotated[int, within(4, 256)]
    actions: Actions


class StickValue(FollowRewardConfig):
    """What a stick is worth: what Table 2 pays for its distance, less the share of a crash."""

    crash: Positive = 100.0  # what a danger of 1 costs
    steps: Positive = 4.1  # for which the distance is paid: half a second, discounted


class DangerRuleSettings(Model):
    """How dangers are answered."""

    threshold: PositiveShare = 0.2  # of danger: below it an action is allowed
    # Joystick distance by which the last action counts as nearer, where the user's is not safe.
    hysteresis: NotNegative = 0.2
    hysteresis_factor: Positive = 1.3  # times the threshold for the last action
    # Joystick distance that a danger of the whole threshold is worth, there too.
    danger_cost: NotNegative = 0.1
    # Danger from which one tick is enough to take the user's own away; below it, two in a row.
    at_once: Share = 0.0
    # Warns above this smoothed danger of the user's own stick, see `next_alarm_state`.
    warn: Share = 0.3
    # Where there is one, the stick of the highest value is taken.
    value: Annotated[StickValue | None, exclude_if(None)] = None


class DangerNetworkSpec(Model):
    """What a danger network is made of, and what it is shown."""

    net: DangerNetworkShape
    camera: CameraConfig
    # Further cameras that its street map is written from, in the order of `env.camera`.
    more_cameras: Annotated[tuple[CameraConfig, ...], exclude_if(())] = ()
    classes: Classes


class DangerPolicyFile(DangerNetworkSpec):
    """`policy.json` of a danger network."""

    schema_version: Literal[2]  # networks of version 1 swept over a shorter way
    algorithm: Literal["danger"]
    rule: Annotated[DangerRuleSettings, AfterValidator(_all_named)]
    chair: ChairConfig  # whose drive its roll-outs obey
    manifest_sha256: MaybeSha256
    weights_sha256: Sha256
    versions: Versions = Field(default_factory=dict)


class _OverrideFile(Model):
    """One option of a town's own scenario that a run had with another value."""

    option: Text
    author: Text
    wcsim: Text
    why: Text


class RunManifestFile(Model):
    """`manifest.json`: what a run was made with; a run of several clients has `clients`."""

    seed: Annotated[int, within(0, MAX_INTEGER)]
    town: Text
    town_sha256: Word
    config_sha256: Word
    # While a longer run is written, the file may still be the one before.
    config_was_sha256: Word = ""
    rewards: Annotated[tuple[Word, ...], Field(max_length=1024)]
    command: Annotated[tuple[Text, ...], Field(max_length=4096)]
    versions: Versions
    git_revision: Word
    status: Literal["running", "done", "interrupted"] = "running"
    steps: Annotated[int, within(0, 10**12)] = 0
    hook: Word = ""
    own_code: MaybeSha256 = ""  # see agents/runs/transfer.py
    more_towns: Annotated[dict[Text, Sha256], Field(max_length=4096)] = Field(default_factory=dict)
    overrides: Annotated[tuple[_OverrideFile, ...], Field(max_length=4096)] = ()
    clients: Annotated[tuple[ClientName, ...], Field(max_length=64)] = ()
    files_sha256: Annotated[dict[ConfigName, Sha256], Field(max_length=65)] = Field(
        default_factory=dict
    )
    # While a longer run is written, each file is still the one before, or already this one.
    files_to_come_sha256: Annotated[dict[ConfigName, Sha256], Field(max_length=65)] = Field(
        default_factory=dict
    )
    seal: MaybeSha256 = ""  # a hash over all of it, where `clients` is there

    @model_validator(mode="after")
    def _clients_have_names_of_their_own(self) -> Self:
        if len(set(self.clients)) != len(self.clients):
            raise ValueError(
                f"clients are named {list(self.clients)}; expected a different name for each"
            )
        return self


class DrivingDataFile(Model):
    """`data.json` of a folder of recorded driving."""

    # Data of version 1 may have scenes that are held out, that of version 2 has other labels.
    schema_version: Literal[3]
    settings_sha256: Sha256  # what it has in common with whoever learns from it
    config: dict[str, Any]  # all settings of the driving; of another version, perhaps
    plant_sha256: MaybeSha256  # of the file that chair.plant names, where it is the user's own
    towns: Annotated[dict[Text, Sha256], Field(max_length=4096)]
    segments: Segments
    data_sha256: Sha256


class LearnedDataFile(Model):
    """`learned_data.json` of a run: what it learns from beside its own driving."""

    schema_version: Literal[1]
    folders: Annotated[dict[Text, Segments], Field(max_length=64)]


class _GeneratorFile(Model):
    """The state of a Philox generator."""

    counter: tuple[_Bits64, _Bits64, _Bits64, _Bits64]
    key: tuple[_Bits64, _Bits64]
    buffer: tuple[_Bits64, _Bits64, _Bits64, _Bits64]
    buffer_pos: Annotated[int, Field(strict=True, ge=0, le=4)]
    has_uint32: Annotated[int, Field(strict=True, ge=0, le=1)]
    uinteger: Annotated[int, Field(strict=True, ge=0, lt=1 << 32)]


class QTrainingProgress(Model):
    """What a run of Q-learning has met so far, beside its learner."""

    crashes: Count = 0
    phase1_done: StrictBool = False
    q_alarm: StrictBool = False
    owes_updates: StrictBool = False


class QTrainingCheckpoint(Model):
    """`state.json` in a checkpoint of Q-learning."""

    n_updates: Count
    episodes: Count
    explore_rng: _GeneratorFile
    replay_rng: _GeneratorFile
    extra: QTrainingProgress


class DangerTrainingCheckpoint(Model):
    """`state.json` in a checkpoint of a danger network."""

    updates: Count
    loss: Annotated[float, Field(strict=True, allow_inf_nan=False)]  # smoothed
    segments: Segments  # that it has learned from


class RoundMetricsRow(Model):
    """A row of `metrics.csv` of a danger network's run, in the order of its columns."""

    round: _Whole
    steps: _Whole  # that can be learned from, of this round and those before, and of data folders
    new_steps: _Whole  # of these that were driven in this round
    tight_share: _Measured  # of these, in which something is unsafe
    crashes: _Whole  # of whoever drove in this round
    network_steps: _Whole  # driven by the network of the round before the last, as it wanted
    network_crashes: _Whole  # that ended these
    user_steps: _Whole  # the same of users alone
    user_crashes: _Whole
    updates: _Whole  # in all
    loss: float  # at its end, smoothed over some 50 updates; NaN where nothing was learned
    wait_s: _Measured  # wall clock, for the worlds
    learn_s: _Measured  # wall clock


class PolicyGuardSettings(Model):
    """What the driver of an exported policy trusts, and what happens when it cannot."""

    oldest_s: _Seconds = 0.3  # a frame that was taken earlier is too old
    deadline_s: _Seconds = 0.1  # from a frame's arrival to the answer
    tick_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    stop_s: _Seconds = 0.5  # within so long the command is zero
    # One after the other, until the policy drives again.
    good_ticks: Annotated[int, within(1, 10_000)] = 10


class ExportedGuardSection(Model):
    """The `guard` of the `meaning.json` of an exported policy."""

    guard: Annotated[PolicyGuardSettings, AfterValidator(_all_named)]


class ShippedPolicyHashes(Model):
    """`files.json` of the policy that comes with wcsim."""

    sha256: Annotated[dict[Name, Sha256], Field(max_length=64)]  # by file


class OnnxPolicySettings(Model):
    """`policy.toml` beside an ONNX model: what it was trained with."""

    preset: Text = "quick"
    settings: Texts = ()  # section.key=value, over the preset

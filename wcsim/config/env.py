"""Sections `[env]` and `[reward]`: episodes, what is seen, what is paid."""

from typing import Annotated, Final, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from wcsim.config.base import Finite, Model, NotNegative, Positive, Text, exclude_if, within

JoystickDistance = Annotated[float, Field(gt=0.0, le=100.0)]

Form = Literal["compact", "compact_rgb", "table3", "state"]
Actions = Literal["square81", "disc69", "stick"]
Classes = Literal["cityscapes", "wcsim"]
EpisodeSteps = Annotated[int, within(1, 1_000_000)]

# From low to high: a share of nothing would be no number.
LEAST_WINDOW: Final = 1e-6

Window = Annotated[int, within(1, 16)]
_CameraName = Annotated[str, Field(max_length=40)]
_CameraNames = Annotated[tuple[_CameraName, ...], Field(min_length=1, max_length=64)]
# A wrong value is reported once, as that of which it looks like.
_OneOrSeveral = Annotated[
    Annotated[_CameraName, Tag("name")] | Annotated[_CameraNames, Tag("list")],
    Discriminator(lambda given: "list" if isinstance(given, list | tuple) else "name"),
]


class FollowRewardConfig(Model):
    """The reward for following the user, and the penalty at the end of a window."""

    base: Finite = 1.0  # Reward of a step within max_follow_distance.
    # Joystick distance to the user with full reward, sqrt(0.125^2 + 0.125^2).
    max_follow_distance: JoystickDistance = 0.1768
    max_distance: JoystickDistance = 2.0  # Joystick distance with the full penalty.
    penalty: NotNegative = 2.0  # Penalty at the upper end of each window.

    @model_validator(mode="after")
    def _distances_are_apart(self) -> Self:
        if self.max_distance - self.max_follow_distance < LEAST_WINDOW:
            raise ValueError(
                f"max_distance {self.max_distance} is not above max_follow_distance "
                f"{self.max_follow_distance} by {LEAST_WINDOW}; expected low < high"
            )
        return self


class RewardConfig(FollowRewardConfig):
    """Reward and crash limits (Tables 1 and 2 of the paper)."""

    # A kerb of 40 mm lies inside this window, and a wall above it (`chair_check/kerbs.py`).

    # Acceleration per axis, from no penalty to a crash.
    accel_window_mps2: tuple[Positive, Positive] = (20.0, 40.0)
    # Roll angle, from no penalty to a crash.
    roll_window_deg: tuple[Positive, Positive] = (5.0, 20.0)
    # Pitch angle, from no penalty to a crash.
    pitch_window_deg: tuple[Positive, Positive] = (20.0, 30.0)
    crash: NotNegative = 100.0  # Penalty for a crash.
    # Impulse of footplate or body on the ground that counts as a crash.
    body_on_ground_Ns: NotNegative = 20.0
    # A fall off a kerb of 12 cm mostly meets none of the paper's limits (ADR 8).
    drop: bool = True  # Whether a wheel that falls off a kerb is a crash. Not in the paper.

    @model_validator(mode="after")
    def _windows_are_open(self) -> Self:
        windows = (self.accel_window_mps2, self.roll_window_deg, self.pitch_window_deg)
        if any(high - low < LEAST_WINDOW for low, high in windows):
            raise ValueError("a window is empty; expected low < high")
        return self


class EnvConfig(Model):
    """Observations, actions and episodes."""

    # Class ids and log-depth as uint8; with colours (compact_rgb); floats of Table 3; no images
    # (state).
    observation: Form = "compact"
    # Name of the camera that networks see, or names of several. Empty: the first. A list with rear
    # mounts a camera of that name behind the chair, where there is none.
    camera: Annotated[_OneOrSeveral, exclude_if("")] = ""
    classes: Classes = "cityscapes"  # Classes of Cityscapes, or wcsim's with kerbs and crosswalks.
    observe_gyro: bool = False  # Whether the observation contains turn rates. Not in the paper.
    observe_yaw: bool = False  # Whether the observation contains the heading. Not in the paper.
    # Images in an observation, one per tick. Without a value: the network decides.
    window: Window | None = None
    # Joystick positions: a 9 by 9 grid, those on the unit disc, or any (stick).
    actions: Actions = "square81"
    max_steps: EpisodeSteps = 10_000  # Longest episode in steps. Training uses learn.episode_steps.
    # Simulated user: a name, FILE.toml, or recorded:FILE (docs/user.md).
    profile: Text = "inattentive"
    truth: bool = False  # Whether info holds the oracle's labels, for baselines and measurements.
    truth_visible: bool = False  # The same, limited to road users that the cameras showed recently.

    @model_validator(mode="after")
    def _state_has_no_images(self) -> Self:
        if self.observation == "state" and self.frames > 1:
            raise ValueError(
                f"window {self.window} with observation 'state', which has no images; expected "
                "env.window=1, or env.observation=compact"
            )
        if self.observation == "state" and self.truth_visible:
            raise ValueError(
                "truth_visible with observation 'state', whose cameras draw nothing; expected "
                "env.truth"
            )
        return self

    @property
    def lattice(self) -> str:
        """The action set that the oracle judges: `actions`, or the paper's grid for any stick."""
        return "square81" if self.actions == "stick" else self.actions

    @property
    def frames(self) -> int:
        """Images in an observation: `window`, or one as long as no network was asked."""
        return 1 if self.window is None else self.window

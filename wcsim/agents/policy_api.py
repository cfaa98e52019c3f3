"""What all policies have in common, and the names of the baselines. Nothing here loads torch.

`agents/policies/baselines.py` has the baselines.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Final, Protocol, runtime_checkable

import numpy.typing as npt

from wcsim.config import RunConfig
from wcsim.core.plugins import wrap_user_code_errors
from wcsim.core.reading import escape
from wcsim.errors import PolicyError
from wcsim.supervisor.actions import ActionSet
from wcsim.types import Bool, Drawn, Truth

Observation = Mapping[str, npt.NDArray[Any]]

DEPTH_KEY: Final = "depth"
CLASS_KEY: Final = "seg"
IMU_KEY: Final = "imu"
JOYSTICK_KEY: Final = "joystick"
ODOMETRY_KEY: Final = "odometry"
RGB_KEY: Final = "rgb"  # of form compact_rgb
COLOURS_KEY: Final = "segmentation"  # of form table3
GYRO: Final = "gyro"  # the IMU's turn rates, among the senses of `NeedsSenses`
MOTION_SENSES: Final = ("odometry", GYRO)  # that tell how the chair moves
STATE_SENSE: Final = "state"  # instead of pictures: the world's truth, see `env.observation=state`
# How long a model or process of others may take: a slow machine may load and compile at first.
ANSWER_S: Final = 90.0

UNAIDED: Final = "follow"  # the user alone, on the grid of actions
BASELINES: Final = (UNAIDED, "random", "zero", "stop", "dwa")
"""What sees no more than a network does."""

UPPER_BOUND: Final = "oracle"
VISIBLE_BOUND: Final = "oracle-visible"
UPPER_BOUNDS: Final = (VISIBLE_BOUND, UPPER_BOUND)
"""They see the truth: not rivals of a network, but what could be reached."""

LEVELLED: Final = "dwa"
VETO: Final = "veto:"
"""Before a policy's name: `dwa` forbids what it holds for unsafe, see `policies/dwa.py`."""
SERVED: Final = "tcp:"
"""Before the address of a process that serves a policy, see `policies/served_policy.py`."""
MODEL_FILE: Final = "policy.onnx"
"""In an ONNX folder, see `policies/onnx_policy.py`."""

HIGHEST_LEVEL: Final = 2.0
USUAL_LEVEL: Final = 1.0
_HELPED: Final = 0.5  # of its choice, where a policy without levels helps


class NotFinite(PolicyError):
    """Raised when a policy's numbers are not finite: a guard brings the chair to rest then."""


def require_level(level: float, levels: tuple[float, float]) -> None:
    """Raise PolicyError for a level of assistance that is not between these two."""
    low, high = sorted(levels)
    if not low <= level <= high:
        raise PolicyError(f"assistance level {level:g}: expected {low:g} to {high:g}")


class Policy(Protocol):
    """Chooses actions for one wheelchair.

    `act` is called once per tick with one observation, not a batch.
    """

    @property
    def name(self) -> str:
        """Its name in tables."""

    def begin(self) -> None:
        """A test starts: clear all state, so that earlier drives cannot affect it."""

    def reset(self) -> None:
        """An episode starts: clear the state of the last one."""

    def act(self, observation: Observation) -> int:
        """The action for this observation."""


def calling(policy: Policy, method: str) -> AbstractContextManager[None]:
    """A context for one call of a policy's method: what a user's code raises becomes a PolicyError.

    An exception of wcsim itself is a bug, and comes with its whole traceback.
    """
    if type(policy).__module__.partition(".")[0] == __name__.partition(".")[0]:
        return nullcontext()
    return wrap_user_code_errors(
        f"policy {policy.name!r} failed in {method}", "correct it, or test the others without it"
    )


@runtime_checkable
class SeesTruth(Protocol):
    """A policy that gets the ground truth before each `act`: an upper bound, no competitor."""

    def see(self, truth: Truth | None) -> None:
        """Take the truth for the next `act`; None if the environment provides none."""


@runtime_checkable
class Warns(Protocol):
    """A policy that can warn its user of danger."""

    @property
    def warning(self) -> bool:
        """Whether it warns, as of its last `act`."""


@runtime_checkable
class HearsSent(Protocol):
    """A policy that needs to know which action was executed, as that may differ from its choice."""

    def choose(self, observation: Observation) -> int:
        """The action for this observation, before it is decided which one is sent."""

    def sent(self, action: int) -> None:
        """Record the action that is executed."""

    def act(self, observation: Observation) -> int:
        """`choose`, then `sent`."""
        action = self.choose(observation)
        self.sent(action)
        return action


@runtime_checkable
class HearsDelay(Protocol):
    """A policy that is given the action delay of each episode, if `[vary]` draws one."""

    def set_delay(self, ticks: int) -> None:
        """From the next `reset` on, commands reach the chair this many ticks late."""


def pass_delay(policy: Policy, drawn: Drawn | None) -> None:
    """Hand on the delay drawn for the episode, before `reset`.

    Without one the policy assumes the configured delay.
    """
    if (
        isinstance(policy, HearsDelay)
        and drawn is not None
        and drawn.action_delay_ticks is not None
    ):
        policy.set_delay(drawn.action_delay_ticks)


@runtime_checkable
class TellsUnsafe(Protocol):
    """A policy that says for every action whether it considers it unsafe."""

    @property
    def unsafe(self) -> Bool:
        """(A,) which actions it considers unsafe, as of its last `act`."""


@runtime_checkable
class Levelled(Protocol):
    """A policy whose level of assistance can be set while it drives."""

    @property
    def levels(self) -> tuple[float, float]:
        """The levels that assist least and most; the first may be the larger number."""

    @property
    def level(self) -> float:
        """The current level."""

    def set_level(self, level: float) -> None:
        """Use this level from the next `act` on. Raises PolicyError for one outside of `levels`."""


class Helping:
    """Raises a policy's level of assistance after a request for help, for a while.

    A policy without levels decides in every tick anyway. Its choice is halved then, so that the
    chair is slower and there is more time.

    Args:
        policy: The policy that assists.
        ticks: How long, from the newest request on; with 0 nothing happens.
        actions: The joystick positions.
    """

    def __init__(self, policy: Policy, ticks: int, actions: ActionSet) -> None:
        self.left = 0  # ticks, while help is on
        self._policy, self._ticks, self._actions = policy, ticks, actions
        self._level: float | None = None  # to go back to

    def request(self) -> None:
        """Assist the most from now on."""
        self.left, policy = self._ticks, self._policy
        if self.left and self._level is None and isinstance(policy, Levelled):
            self._level = policy.level
            policy.set_level(policy.levels[1])

    def choice(self, action: object) -> int:
        """What is done of a policy's choice. Raises BadActionError as `ActionSet.index`."""
        index = self._actions.index(action)
        if not self.left or isinstance(self._policy, Levelled):
            return index
        return self._actions.nearest(_HELPED * self._actions.points[index])

    def tick(self) -> None:
        """A tick is over."""
        self.left = max(0, self.left - 1)
        if not self.left:
            self.end()

    def end(self) -> None:
        """Help is over: the level is the one of before."""
        self.left, level, self._level = 0, self._level, None
        if level is not None and isinstance(self._policy, Levelled):
            self._policy.set_level(level)


@runtime_checkable
class NeedsSenses(Protocol):
    """A policy that needs optional sensors. Tests turn them on for it."""

    @property
    def senses(self) -> tuple[str, ...]:
        """Names of sensors of the section `[sensors]` and `GYRO`, or `STATE_SENSE` alone."""


def level_of(name: str) -> float:
    """How much `dwa@L` assists: 0 at the last moment, 1 as `dwa`, 2 early with wide margins.

    >>> level_of("dwa@0.5"), level_of("dwa"), level_of("follow")
    (0.5, 1.0, 1.0)

    Raises:
        PolicyError: L is no number from 0 to 2.
    """
    base, at, text = name.partition("@")
    if base != LEVELLED or not at:
        return USUAL_LEVEL
    try:
        level = float(text)
    except ValueError:
        level = -1.0
    if not 0.0 <= level <= HIGHEST_LEVEL:
        raise PolicyError(
            f"policy {escape(name)!r} has no such level of assistance; expected "
            f"{LEVELLED}@L with L from 0 to {HIGHEST_LEVEL:g}: "
            f"{LEVELLED}@{USUAL_LEVEL:g} is {LEVELLED}"
        )
    return level


def senses_of(policy: Policy) -> tuple[str, ...]:
    """What a policy wants to sense beside pictures, tilt and joystick."""
    return policy.senses if isinstance(policy, NeedsSenses) else ()


def sense_settings(config: RunConfig, senses: Sequence[str]) -> tuple[str, ...]:
    """The settings that turn these senses on; a sensor that is on already stays as it is."""
    there = config.sensors.on()
    words = {GYRO: "env.observe_gyro=true", STATE_SENSE: "env.observation=state"}
    return tuple(words.get(name, f"sensors.{name}=typical") for name in senses if name not in there)

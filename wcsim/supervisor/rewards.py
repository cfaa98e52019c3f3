"""The reward of one step, as pure functions; why a step is a crash, and by whose fault.

Tables 1 and 2 of the paper, term by term. Table 1 gives a window for every measured quantity: below
it nothing happens, inside it the penalty grows linearly to its full size, above it the step is a
crash. Table 2 gives the sizes: +1 for following the user, -2 for each penalty at full intensity,
-100 for a crash, once. The joystick distance is the exception: above its window the penalty stays
full.

A user's own term is a class with two methods, named `module:Class` on the command line.
"""

import re
from collections.abc import Sequence
from typing import Final, Literal, Protocol

import numpy as np

from wcsim.config import RewardConfig
from wcsim.config.env import FollowRewardConfig
from wcsim.core.frames import deg2rad
from wcsim.core.plugins import import_class
from wcsim.errors import ConfigError
from wcsim.types import F64, ClientSnapshot, Contact, Events, ImuFrame, PlantState, RewardTerms

CrashReason = Literal["", "collision", "drop", "acceleration", "tilt"]
Fault = Literal["own", "other"]

# Grid centres in float32 lie on either side of sqrt(0.125^2 + 0.125^2); both sides must earn the
# base reward.
DISTANCE_TOLERANCE: Final = 1e-6
_ROLLING_PARTS: Final = frozenset({"wheel", "caster", "antitip"})
_GROUND_KINDS: Final = frozenset({"ground", "kerb"})
_NO_TOUCH: Final = {
    "drop": "fell off a kerb",
    "tilt": "tilted too far",
    "acceleration": "was shaken too hard",
}
_STANDING: Final = {
    "ground": "the ground",
    "kerb": "a kerb",
    "static": "something that stands in the street",
}
_LONGEST_ID: Final = 100


def compute_reward_terms(
    distance: float, imu: ImuFrame, plant: PlantState, events: Events, config: RewardConfig
) -> RewardTerms:
    """All terms of one step; `distance` is that of `joystick_distance`.

    The tilt is the true one, whatever is sensed.
    """
    base, joystick = _joystick_terms(distance, config)
    return RewardTerms(
        base=base,
        joystick=joystick,
        accel=_accel_term(imu.accel_peak_mps2, config),
        tilt=_tilt_term(plant.roll_rad, plant.pitch_rad, config),
        crash=_crash_term(events.crashed, config),
    )


def joystick_distance(user: F64, agent: F64, config: RewardConfig) -> float:
    """Euclidean distance between two joystick positions (2,), held at `max_distance`.

    A corner of the action square is up to 2.41 from a stick on the disc; that is no crash of its
    own, so the distance stops at the end of the window.
    """
    return min(float(np.hypot(user[0] - agent[0], user[1] - agent[1])), config.max_distance)


def find_crash_reason(
    imu: ImuFrame,
    plant: PlantState,
    contacts: Sequence[Contact],
    config: RewardConfig,
    *,
    dropped: bool = False,
) -> CrashReason:
    """Why this tick ends the episode, "" when it does not.

    Table 2 row "crash"; Table 1 column "maximum".

    The first explains the others: a collision with what stands or moves in the street, a wheel that
    `dropped` off a kerb, a collision with ground or kerb, an acceleration, a tilt.
    """
    collisions = [contact for contact in contacts if _is_collision(contact, config)]
    # A chair that falls hits the ground: that touch follows from the fall, any other one does not.
    if dropped and all(contact.kind in _GROUND_KINDS for contact in collisions):
        return "drop"
    if collisions:
        return "collision"
    if any(abs(float(axis)) > config.accel_window_mps2[1] for axis in imu.accel_peak_mps2):
        return "acceleration"
    roll_max, pitch_max = deg2rad(config.roll_window_deg[1]), deg2rad(config.pitch_window_deg[1])
    if abs(plant.roll_rad) > roll_max or abs(plant.pitch_rad) > pitch_max:
        return "tilt"
    return ""


def find_hardest_contact(
    reason: str, contacts: Sequence[Contact], config: RewardConfig
) -> Contact | None:
    """The touch with the largest impulse that counts as a collision; None of another crash."""
    if reason != "collision":
        return None
    collisions = [contact for contact in contacts if _is_collision(contact, config)]
    # At a tie the first one; contacts are sorted by kind, actor and part.
    return max(collisions, key=lambda contact: contact.impulse_Ns, default=None)


def judge_crash_fault(reason: str, contacts: Sequence[Contact], config: RewardConfig) -> Fault:
    """Who is at fault: the cause of the hardest touch; without a collision the chair's own."""
    hit = find_hardest_contact(reason, contacts, config)
    return "own" if hit is None else hit.cause


def format_crash_summary(reason: str, at_fault: str, words: str) -> str:
    """A crash in a line: its reason, who is at fault, and `words` as those of `describe_crash`."""
    return f"{reason}, {at_fault} fault: it {words}"


def describe_crash(reason: str, contacts: Sequence[Contact], config: RewardConfig) -> str:
    """What happened to a chair that crashed: into what it drove, or what hit it, by SUMO's id.

    >>> hit = Contact(kind="car", part="body", impulse_Ns=9.0, cause="other", actor_id="v:flow.3")
    >>> (
    ...     describe_crash("collision", (hit,), RewardConfig()),
    ...     describe_crash("drop", (), RewardConfig()),
    ... )
    ('was hit by car flow.3', 'fell off a kerb')
    """
    hit = find_hardest_contact(reason, contacts, config)
    if hit is None:
        return _NO_TOUCH.get(reason, reason)
    # A part of an articulated vehicle has the name of the whole.
    name = re.sub(r"~\d+$", "", hit.actor_id.partition(":")[2])[:_LONGEST_ID]
    other = _STANDING.get(hit.kind, f"{hit.kind} {name}".strip())
    return f"was hit by {other}" if hit.cause == "other" else f"drove into {other}"


def reward_of_distance(distance: F64, config: FollowRewardConfig) -> F64:
    """What Tables 1 and 2 pay for distances of sticks (N,), base and penalty."""
    low, high = config.max_follow_distance, config.max_distance
    paid = -config.penalty * np.clip((distance - low) / (high - low), 0.0, 1.0)
    rewards: F64 = np.where(distance <= low + DISTANCE_TOLERANCE, config.base, paid)
    return rewards


class RewardTerm(Protocol):
    """An additional reward term, computed from the snapshots before and after a tick."""

    def reset(self) -> None:
        """An episode starts."""

    def reward(self, before: ClientSnapshot, after: ClientSnapshot) -> float:
        """What this tick adds to the reward."""


def is_reward_term(value: object) -> bool:
    """Whether an object, or the objects of a class, have these methods."""
    return all(callable(getattr(value, method, None)) for method in ("reset", "reward"))


def make_reward_term(name: str) -> RewardTerm:
    """A new reward term of the class `module:Class`. Raises ConfigError if it is none."""
    term_class = import_class(name, "reward term")
    if not is_reward_term(term_class):
        raise ConfigError(
            f"reward term {name!r} needs the methods reset() and reward(before, after); "
            "see examples/"
        )
    term: RewardTerm = term_class()
    return term


def _joystick_terms(distance: float, config: RewardConfig) -> tuple[float, float]:
    """Base reward and joystick penalty for the distance between user's and agent's joystick.

    Table 2 row "zero joystick distance" (+1 up to `max_follow_distance`), Table 1 row "joystick
    distance" (0.1768..2). Only one of the two is ever not zero.
    """
    if distance <= config.max_follow_distance + DISTANCE_TOLERANCE:
        return config.base, 0.0
    # A difference, here and below, as a negative product of 0 would be -0.0.
    return 0.0, 0.0 - config.penalty * _intensity(
        distance, config.max_follow_distance, config.max_distance
    )


def _accel_term(accel_peak_mps2: F64, config: RewardConfig) -> float:
    """Penalty for the peak acceleration of a tick; (3,) m/s^2, gravity removed.

    Table 1 rows "acceleration x, y, z".
    """
    low, high = config.accel_window_mps2
    return 0.0 - config.penalty * sum(
        _intensity(abs(float(axis)), low, high) for axis in accel_peak_mps2
    )


def _tilt_term(roll_rad: float, pitch_rad: float, config: RewardConfig) -> float:
    """Penalty for leaning: Table 1 rows "roll" (5..20 deg) and "pitch" (20..30 deg)."""
    roll_low, roll_high = (deg2rad(angle) for angle in config.roll_window_deg)
    pitch_low, pitch_high = (deg2rad(angle) for angle in config.pitch_window_deg)
    leaning = _intensity(abs(roll_rad), roll_low, roll_high) + _intensity(
        abs(pitch_rad), pitch_low, pitch_high
    )
    return 0.0 - config.penalty * leaning


def _crash_term(crashed: bool, config: RewardConfig) -> float:
    """Table 2 row "crash" (-100): once, however many things went wrong in the step."""
    return 0.0 - config.crash if crashed else 0.0


def _intensity(value: float, low: float, high: float) -> float:
    """How far `value` is inside its window: from 0 at `low` and below to 1 at `high` and above.

    Raises ConfigError when the window is empty.

    >>> _intensity(30.0, 20.0, 40.0), _intensity(-5.0, 20.0, 40.0), _intensity(99.0, 20.0, 40.0)
    (0.5, 0.0, 1.0)
    """
    if not low < high:
        raise ConfigError(
            f"reward window ({low}, {high}) is empty; expected low < high: "
            "correct the [reward] section"
        )
    return min(1.0, max(0.0, (value - low) / (high - low)))


def _is_collision(contact: Contact, config: RewardConfig) -> bool:
    """Whether a touch counts as a collision.

    Wheels, casters and anti-tips may touch ground and kerb. Anything else that touches ground or
    kerb counts above `body_on_ground_Ns`: a footplate that scrapes over a lowered kerb is no
    accident. Everything else counts always.
    """
    if contact.kind not in _GROUND_KINDS:
        return True
    return contact.part not in _ROLLING_PARTS and contact.impulse_Ns > config.body_on_ground_Ns

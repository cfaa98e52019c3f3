"""Six kinds of users as parameters of one model.

The values follow published ranges for reaction times and tremor; they are plausible and not fitted to recorded driving.
`ataxic` is meant to be held out of training.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wcsim.core.constants import RECORDED
from wcsim.errors import ConfigError, meant

PROFILE_SUFFIX = ".toml"
"""Of the file of a profile, where else the name of one stands."""

PROFILE_LIMITS: dict[str, tuple[float, float]] = {
    "reaction_s": (0.0, 3.0),
    "lag_s": (0.0, 2.0),
    "lookahead_m": (0.1, 5.0),
    "noise": (0.0, 1.0),
    "noise_rate": (0.05, 50.0),
    "tremor": (0.0, 1.0),
    "tremor_hz": (0.5, 15.0),
    "gain": (0.05, 5.0),
    "bias": (-1.0, 1.0),
    "see_share": (0.0, 1.0),
    "see_m": (0.5, 50.0),
    "away_share": (0.0, 0.9),
    "away_s": (0.1, 30.0),
    "correct_every_s": (0.0, 5.0),
    "speed_share": (0.05, 1.0),
    "law_share": (0.0, 1.0),
    "give_up_s": (1.0, 3600.0),
    "ask_share": (0.0, 1.0),
    "hold_s": (0.05, 5.0),
    "spread": (0.0, 0.9),
}
"""Least and most of each number of a profile; of both its parts where it has two."""

PAIRS = ("gain", "bias")
"""The numbers of a profile that have two parts."""

HELD_OUT = ("ataxic",)
"""Profiles that no network is trained with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UserProfile:
    """Parameters of one simulated user."""

    name: str
    reaction_s: float  # from seeing to moving the hand
    lag_s: float  # neuromuscular first-order lag
    lookahead_m: float  # at standstill; grows with speed; short, so that corners of a 2 m pavement are not cut
    noise: float  # standard deviation of the hand's slow wander, in stick units
    noise_rate: float  # how fast the wander forgets itself, 1/s
    tremor: float  # amplitude, in stick units
    tremor_hz: float
    gain: tuple[float, float]  # of the hand, x and y
    bias: tuple[float, float]
    see_share: float  # chance that an obstacle or actor is noticed at all
    see_m: float  # how far people and obstacles are noticed
    away_share: float  # share of the time spent looking elsewhere
    away_s: float  # mean length of a look elsewhere
    correct_every_s: float  # time between corrections, 0 for continuous steering
    speed_share: float  # desired speed as a share of the chair's
    law_share: float  # chance to respect a red light and an approaching vehicle at a crossing
    give_up_s: float  # blocked for so long, the user gives up
    discrete: bool  # four switches instead of a stick
    hold_s: float  # with switches: forward, and a rest after a turn, last at least this long
    ask_share: float = 0.0  # chance to ask for help when it is scared
    spread: float = 0.3  # relative; parameters of an episode lie within 1 -+ this of the profile's


def profile(name: str) -> UserProfile:
    """The profile called `name`. Raises ConfigError with the known names."""
    for known in _PROFILES:
        if known.name == name:
            return known
    names = ", ".join(profile_names())
    raise ConfigError(
        f"unknown user profile {name!r}; expected one of: {names}, FILE.toml, or recorded:FILE"
        f"{meant(name, profile_names())}"
    )


def is_of_file(name: str) -> bool:
    """Whether it names a file in the place of a profile: "recorded:FILE", or "FILE.toml"."""
    return name.startswith(RECORDED) or name.endswith(PROFILE_SUFFIX)


def recordings(profiles: Iterable[str]) -> tuple[str, ...]:
    """Those of these that name a file in the place of a profile."""
    return tuple(sorted({name for name in profiles if is_of_file(name)}))


def profile_names() -> tuple[str, ...]:
    """The names of all profiles."""
    return tuple(item.name for item in _PROFILES)


def sample(base: UserProfile, rng: np.random.Generator) -> UserProfile:
    """The user of one episode: every parameter within the profile's spread of its own (30 %), and within its bounds.

    The chances to see and to keep to the law are spread by their complement (who misses 2 % misses 1.4 to 2.6 %), gains
    by how far they are from one (a faithful hand stays faithful). The chance to ask for help is the profile's.
    """

    def around(value: float) -> float:
        return value * float(rng.uniform(1.0 - base.spread, 1.0 + base.spread))

    user = replace(
        base,
        reaction_s=around(base.reaction_s),
        lag_s=around(base.lag_s),
        lookahead_m=around(base.lookahead_m),
        noise=around(base.noise),
        noise_rate=around(base.noise_rate),
        tremor=around(base.tremor),
        tremor_hz=around(base.tremor_hz),
        gain=(1.0 + around(base.gain[0] - 1.0), 1.0 + around(base.gain[1] - 1.0)),
        bias=(around(base.bias[0]), base.bias[1]),
        see_share=1.0 - around(1.0 - base.see_share),
        see_m=around(base.see_m),
        away_share=around(base.away_share),
        away_s=around(base.away_s),
        correct_every_s=around(base.correct_every_s),
        speed_share=around(base.speed_share),
        give_up_s=around(base.give_up_s),
        law_share=1.0 - around(1.0 - base.law_share),
        hold_s=around(base.hold_s),
    )
    # Last, so that a user of a seed is in all else who it was before this was drawn.
    return _bounded(replace(user, bias=(user.bias[0], around(base.bias[1]))))


def _bounded(user: UserProfile) -> UserProfile:
    """The same user, each number within its bounds."""

    def held(name: str, value: Any) -> Any:
        low, high = PROFILE_LIMITS[name]
        parts = [min(max(part, low), high) for part in (value if name in PAIRS else (value,))]
        return tuple(parts) if name in PAIRS else parts[0]

    return replace(user, **{name: held(name, getattr(user, name)) for name in PROFILE_LIMITS})


_COMPETENT = UserProfile(
    name="competent",
    reaction_s=0.25,
    lag_s=0.12,
    lookahead_m=0.6,
    noise=0.03,
    noise_rate=4.0,
    tremor=0.0,
    tremor_hz=4.5,
    gain=(1.0, 1.0),
    bias=(0.0, 0.0),
    see_share=0.98,
    see_m=6.0,
    away_share=0.0,
    away_s=2.0,
    correct_every_s=0.0,
    speed_share=0.8,
    law_share=0.98,
    give_up_s=15.0,
    discrete=False,
    hold_s=0.3,
)

_PROFILES: tuple[UserProfile, ...] = (
    _COMPETENT,
    replace(
        _COMPETENT,
        name="slow",
        reaction_s=0.6,
        lag_s=0.3,
        lookahead_m=0.9,
        see_share=0.9,
        speed_share=0.6,
        ask_share=0.3,
    ),
    replace(_COMPETENT, name="tremor", reaction_s=0.35, noise=0.06, tremor=0.25, tremor_hz=4.5),
    replace(
        _COMPETENT,
        name="ataxic",
        reaction_s=0.45,
        lag_s=0.2,
        noise=0.18,
        noise_rate=2.0,
        gain=(0.8, 1.2),
        bias=(0.12, 0.0),
        correct_every_s=0.4,
    ),
    replace(_COMPETENT, name="inattentive", reaction_s=0.45, see_share=0.35, see_m=3.0, away_share=0.3, law_share=0.8),
    replace(_COMPETENT, name="switch", reaction_s=0.6, noise=0.0, see_share=0.9, discrete=True, ask_share=0.3),
)

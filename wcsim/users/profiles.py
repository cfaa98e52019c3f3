"""Kinds of users as parameters of one model (`profiles.toml`), and files of profiles: TOML over those of a base.

The values follow published ranges for reaction times and tremor: plausible, but only the hand of `recorded` is fitted.
`ataxic` is meant to be held out of training.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wcsim.core.constants import RECORDED
from wcsim.core.reading import PROFILE, escaped, escaped_value, own_data, parse_json, read_toml
from wcsim.errors import ConfigError, meant

PROFILE_SUFFIX = ".toml"
"""Of the file of a profile, where else the name of one stands."""

_DATA: dict[str, dict[str, Any]] = own_data(__file__)

PROFILE_LIMITS: dict[str, tuple[float, float]] = {
    name: (low, high) for name, (low, high) in _DATA.pop("limits").items()
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
    if name not in _DATA:
        names = ", ".join(profile_names())
        raise ConfigError(
            f"unknown user profile {name!r}; expected one of: {names}, FILE.toml, or recorded:FILE"
            f"{meant(name, profile_names())}"
        )
    numbers = _DATA["competent"] | _DATA[name]
    pairs = {key: tuple(numbers[key]) for key in PAIRS}
    return UserProfile(name=name, **numbers | pairs)


def find_profile(name: str) -> UserProfile:
    """The profile called `name`, or that of a file "FILE.toml". Raises ConfigError as `profile` or `_read_profile`."""
    return _read_profile(Path(name)) if name.endswith(PROFILE_SUFFIX) else profile(name)


def is_of_file(name: str) -> bool:
    """Whether it names a file in the place of a profile: "recorded:FILE", or "FILE.toml"."""
    return name.startswith(RECORDED) or name.endswith(PROFILE_SUFFIX)


def recordings(profiles: Iterable[str]) -> tuple[str, ...]:
    """Those of these that name a file in the place of a profile."""
    return tuple(sorted({name for name in profiles if is_of_file(name)}))


def profile_names() -> tuple[str, ...]:
    """The names of all profiles."""
    return tuple(_DATA)


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


_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")


def _read_profile(path: Path) -> UserProfile:
    """The profile of a file; what it leaves out is that of its `base`, competent where it names none.

    Raises:
        ConfigError: It cannot be read, has another key, or a number that is out of bounds; with the key and the bounds.
    """
    data = read_toml(path, PROFILE)
    base = data.pop("base", "competent")
    if not isinstance(base, str):
        raise ConfigError(
            f"{escaped(path)}: base: got {escaped_value(base)}; expected the name of one of wcsim's profiles"
        )
    return _changed(
        replace(profile(base), name=profile_word(path.stem), spread=0.0), data, escaped(path)
    )


def profile_of_json(text: str, where: str) -> UserProfile:
    """A profile that `profile_json` wrote. Raises ConfigError, beginning with `where`."""
    data = parse_json(text, where, PROFILE)
    return _changed(profile("competent"), data, where)


def profile_json(user: UserProfile) -> str:
    """A profile with every number to the last bit, on one line."""
    return json.dumps(asdict(user), allow_nan=False)


def profile_text(user: UserProfile, notes: Mapping[str, str], head: str = "") -> str:
    """A profile as TOML that `_read_profile` takes; `notes` stand behind their keys, `head` above all."""
    lines = [f"# {line}" for line in head.splitlines()]
    for name, value in asdict(user).items():
        written = f"[{', '.join(map(repr, value))}]" if isinstance(value, tuple) else _plain(value)
        note = notes.get(name, "")
        lines.append(f"{name} = {written}" + (f"  # {note}" if note else ""))
    return "\n".join([*lines, ""])


def _changed(base: UserProfile, data: dict[str, Any], where: str) -> UserProfile:
    known = set(PROFILE_LIMITS) | {"name", "discrete"}
    strange = sorted(key for key in data if key not in known)
    if strange:
        raise ConfigError(
            f"{where}: unknown key {escaped(strange[0], 40)!r}; expected one of: base, {', '.join(sorted(known))}"
        )
    return replace(base, **{key: _value(key, value, where) for key, value in data.items()})


def _value(key: str, value: Any, where: str) -> Any:
    if key == "name":
        if isinstance(value, str) and _NAME.fullmatch(value):
            return value
        raise ConfigError(
            f"{where}: name: got {escaped_value(value)}; expected 1 to 64 letters, digits, - _ or ."
        )
    if key == "discrete":
        if isinstance(value, bool):
            return value
        raise ConfigError(f"{where}: discrete: got {escaped_value(value)}; expected true or false")
    low, high = PROFILE_LIMITS[key]
    numbers = value if key in PAIRS and isinstance(value, list) else [value]
    fits = len(numbers) == (2 if key in PAIRS else 1)
    if not fits or not all(_is_number(number) and low <= number <= high for number in numbers):
        what = "two numbers, each" if key in PAIRS else "a number,"
        raise ConfigError(
            f"{where}: {key}: got {escaped_value(value)}; expected {what} {low:g} to {high:g}"
        )
    return tuple(map(float, numbers)) if key in PAIRS else float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def profile_word(text: str) -> str:
    """A name for a profile that is made of any text, as of its file's name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text)[:64].lstrip(".") or "user"

"""Kinds of users as parameters of one model (`profiles.toml`), and profiles in TOML files of users.

The values follow published ranges for reaction times and tremor: plausible, but only the hand of
`recorded` is fitted; `ataxic` to nobody.
"""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from wcsim.core.constants import RECORDED
from wcsim.core.reading import PROFILE, escape, escape_repr, parse_json, read_module_toml, read_toml
from wcsim.errors import ConfigError, meant

_SUFFIX: Final = ".toml"
_NAME: Final = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")
_DATA: Final[dict[str, dict[str, Any]]] = read_module_toml(__file__)

PROFILE_LIMITS: Final[dict[str, tuple[float, float]]] = {
    name: (low, high) for name, (low, high) in _DATA.pop("limits").items()
}
"""Least and most of each number of a profile; of both its parts where it has two."""

PAIRS: Final = ("gain", "bias")
"""The numbers of a profile that have two parts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UserProfile:
    """Parameters of one simulated user."""

    name: str
    reaction_s: float  # from seeing to moving the hand
    lag_s: float  # neuromuscular first-order lag
    # At standstill; it grows with the speed. Short, so that corners of a 2 m pavement are not cut.
    lookahead_m: float
    noise: float  # standard deviation of the hand's slow wander, in stick units
    noise_rate: float  # how fast the wander forgets itself, 1/s
    tremor: float  # amplitude, in stick units
    tremor_hz: float
    gain: tuple[float, float]  # of the hand, x and y
    bias: tuple[float, float]
    see_share: float  # chance that an obstacle or actor is detected at all
    see_m: float  # how far away obstacles are detected
    away_share: float  # share of the time spent looking elsewhere
    away_s: float  # mean length of a look elsewhere
    correct_every_s: float  # time between corrections, 0 for continuous steering
    speed_share: float  # desired speed as a share of the chair's
    law_share: float  # chance to respect a red light and an approaching vehicle at a crossing
    give_up_s: float  # a user that is blocked for so long gives up
    discrete: bool  # four switches instead of a stick
    hold_s: float  # with switches: forward, and a rest after a turn, last at least this long
    ask_share: float = 0.0  # chance to ask for help when it is scared
    spread: float = 0.3  # parameters of an episode lie within 1 -+ this times the profile's


def find_builtin_profile(name: str) -> UserProfile:
    """The profile called `name`. Raises ConfigError with the known names."""
    if name not in _DATA:
        names = ", ".join(list_profile_names())
        raise ConfigError(
            f"unknown user profile {name!r}; expected one of: {names}, FILE.toml, or recorded:FILE"
            f"{meant(name, list_profile_names())}"
        )
    numbers = _DATA["competent"] | _DATA[name]
    pairs = {key: tuple(numbers[key]) for key in PAIRS}
    return UserProfile(name=name, **numbers | pairs)


def list_profile_names() -> tuple[str, ...]:
    """The names of all profiles."""
    return tuple(_DATA)


def find_profile(name: str) -> UserProfile:
    """The profile called `name`, or that of a file "FILE.toml".

    Raises:
        ConfigError: There is no such profile, or the file cannot be used; with what was expected.
    """
    return _read_profile(Path(name)) if name.endswith(_SUFFIX) else find_builtin_profile(name)


def is_user_file_name(name: str) -> bool:
    """Whether it names a file in the place of a profile: "recorded:FILE", or "FILE.toml"."""
    return name.startswith(RECORDED) or name.endswith(_SUFFIX)


def filter_user_file_names(names: Iterable[str]) -> tuple[str, ...]:
    """Those of these names that are of files in the place of a profile, sorted, each once."""
    return tuple(sorted({name for name in names if is_user_file_name(name)}))


def sample_profile(base: UserProfile, rng: np.random.Generator) -> UserProfile:
    """Draw the user of one episode: every parameter within the profile's spread, and its bounds.

    Chances to see and to obey the law are spread by their complement: 2 % of misses become 1.4 to
    2.6 %. Gains are spread by how far they are from one: a faithful hand stays faithful. The chance
    to request help is the profile's.
    """

    def around(value: float) -> float:
        return value * float(rng.uniform(1.0 - base.spread, 1.0 + base.spread))

    # The order of these draws is part of what a seed means: it is that of the limits.
    drawn = asdict(base)
    for name in PROFILE_LIMITS:
        value = drawn[name]
        if name == "gain":
            drawn[name] = tuple(1.0 + around(part - 1.0) for part in value)
        elif name == "bias":
            drawn[name] = (around(value[0]), value[1])
        elif name in ("see_share", "law_share"):
            drawn[name] = 1.0 - around(1.0 - value)
        elif name not in ("ask_share", "spread"):
            drawn[name] = around(value)
    # Last, so that a user of a seed is in all else what it was before this was drawn.
    drawn["bias"] = (drawn["bias"][0], around(base.bias[1]))
    bounded: dict[str, Any] = {}
    for name, (low, high) in PROFILE_LIMITS.items():
        value = drawn[name]
        if name in PAIRS:
            bounded[name] = tuple(min(max(part, low), high) for part in value)
        else:
            bounded[name] = min(max(value, low), high)
    return replace(base, **bounded)


def profile_from_json(text: str, where: str) -> UserProfile:
    """A profile that `profile_to_json` wrote. Raises ConfigError, beginning with `where`."""
    data = parse_json(text, where, PROFILE)
    return _with_values(find_builtin_profile("competent"), data, where)


def profile_to_json(user: UserProfile) -> str:
    """A profile with every number to the last bit, on one line."""
    return json.dumps(asdict(user), allow_nan=False)


def profile_to_toml(user: UserProfile, notes: Mapping[str, str], head: str = "") -> str:
    """A profile as TOML that `find_profile` reads; `notes` stand behind keys, `head` above all."""
    lines = [f"# {line}" for line in head.splitlines()]
    for name, value in asdict(user).items():
        if isinstance(value, bool):
            written = "true" if value else "false"
        elif isinstance(value, str):
            written = f'"{value}"'
        elif isinstance(value, tuple):
            written = f"[{', '.join(map(repr, value))}]"
        else:
            written = repr(value)
        note = f"  # {notes[name]}" if notes.get(name) else ""
        lines.append(f"{name} = {written}{note}")
    return "\n".join([*lines, ""])


def profile_name_from_text(text: str) -> str:
    """A name for a profile that is made of any text, as of its file's name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text)[:64].lstrip(".") or "user"


def _read_profile(path: Path) -> UserProfile:
    """The profile of a file; what it leaves out is that of its `base` (default competent).

    Raises:
        ConfigError: It cannot be read, has another key, or a number that is out of bounds; with the
            key and the bounds.
    """
    data = read_toml(path, PROFILE)
    base = data.pop("base", "competent")
    if not isinstance(base, str):
        raise ConfigError(
            f"{escape(path)}: base: got {escape_repr(base)}; "
            "expected the name of one of wcsim's profiles"
        )
    plain = replace(find_builtin_profile(base), name=profile_name_from_text(path.stem), spread=0.0)
    return _with_values(plain, data, escape(path))


def _with_values(base: UserProfile, data: dict[str, Any], where: str) -> UserProfile:
    """The profile with the values of a file, checked one by one."""
    known = set(PROFILE_LIMITS) | {"name", "discrete"}
    strange = sorted(key for key in data if key not in known)
    if strange:
        raise ConfigError(
            f"{where}: unknown key {escape(strange[0], 40)!r}; "
            f"expected one of: base, {', '.join(sorted(known))}"
        )
    return replace(base, **{key: _value(key, value, where) for key, value in data.items()})


def _value(key: str, value: Any, where: str) -> Any:
    if key == "name":
        if isinstance(value, str) and _NAME.fullmatch(value):
            return value
        raise ConfigError(
            f"{where}: name: got {escape_repr(value)}; expected 1 to 64 letters, digits, - _ or ."
        )
    if key == "discrete":
        if isinstance(value, bool):
            return value
        raise ConfigError(f"{where}: discrete: got {escape_repr(value)}; expected true or false")
    low, high = PROFILE_LIMITS[key]
    numbers = value if key in PAIRS and isinstance(value, list) else [value]
    fits = len(numbers) == (2 if key in PAIRS else 1) and all(
        # True is an int, and no number here.
        type(number) in (int, float) and low <= number <= high
        for number in numbers
    )
    if not fits:
        what = "two numbers, each" if key in PAIRS else "a number,"
        raise ConfigError(
            f"{where}: {key}: got {escape_repr(value)}; expected {what} {low:g} to {high:g}"
        )
    return tuple(map(float, numbers)) if key in PAIRS else float(value)

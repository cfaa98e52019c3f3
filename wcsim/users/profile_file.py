"""A user's profile in a file: the parameters of `UserProfile` as TOML, over those of a profile that it is based on."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from wcsim.core.reading import FileKind, parse_json, read_toml, shown, shown_value
from wcsim.errors import ConfigError
from wcsim.users.profiles import PAIRS, PROFILE_LIMITS, UserProfile, profile

_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")
_KIND = FileKind(what="a user's profile as TOML", limit_bytes=1 << 16)


def read_profile(path: Path) -> UserProfile:
    """The profile of a file; what it leaves out is that of its `base`, competent where it names none.

    Raises:
        ConfigError: It cannot be read, has another key, or a number that is out of bounds; with the key and the bounds.
    """
    data = read_toml(path, _KIND)
    base = data.pop("base", "competent")
    if not isinstance(base, str):
        raise ConfigError(f"{shown(path)}: base: got {shown_value(base)}; expected the name of one of wcsim's profiles")
    return _changed(replace(profile(base), name=_word(path.stem), spread=0.0), data, shown(path))


def profile_of_json(text: str, where: str) -> UserProfile:
    """A profile that `profile_json` wrote. Raises ConfigError, beginning with `where`."""
    data = parse_json(text, where, _KIND)
    return _changed(profile("competent"), data, where)


def profile_json(user: UserProfile) -> str:
    """A profile with every number to the last bit, on one line."""
    return json.dumps(asdict(user), allow_nan=False)


def profile_text(user: UserProfile, notes: Mapping[str, str], head: str = "") -> str:
    """A profile as TOML that `read_profile` takes; `notes` stand behind their keys, `head` above all."""
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
            f"{where}: unknown key {shown(strange[0], 40)!r}; expected one of: base, {', '.join(sorted(known))}"
        )
    return replace(base, **{key: _value(key, value, where) for key, value in data.items()})


def _value(key: str, value: Any, where: str) -> Any:
    if key == "name":
        if isinstance(value, str) and _NAME.fullmatch(value):
            return value
        raise ConfigError(f"{where}: name: got {shown_value(value)}; expected 1 to 64 letters, digits, - _ or .")
    if key == "discrete":
        if isinstance(value, bool):
            return value
        raise ConfigError(f"{where}: discrete: got {shown_value(value)}; expected true or false")
    low, high = PROFILE_LIMITS[key]
    numbers = value if key in PAIRS and isinstance(value, list) else [value]
    fits = len(numbers) == (2 if key in PAIRS else 1)
    if not fits or not all(_is_number(number) and low <= number <= high for number in numbers):
        what = "two numbers, each" if key in PAIRS else "a number,"
        raise ConfigError(f"{where}: {key}: got {shown_value(value)}; expected {what} {low:g} to {high:g}")
    return tuple(map(float, numbers)) if key in PAIRS else float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _word(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "-", text)[:64].lstrip(".") or "user"

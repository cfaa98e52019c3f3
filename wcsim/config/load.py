"""Configuration from presets, files and `section.key=value`. Every error has the value and what was expected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from wcsim.config.base import Model, fault
from wcsim.config.chair import PROFILE_SPEED_MPS
from wcsim.config.run import RunConfig
from wcsim.config.sensors import by_word
from wcsim.core import reading
from wcsim.core.reading import CONFIG, SETTINGS, VALUE, FileKind, escaped
from wcsim.errors import ConfigError, meant

_PLANTS = Path(__file__).parent / "plants"

_PRESETS = Path(__file__).parent / "presets"

_SPEED = {"profile", "v_max_mps"}  # a plant that says one of them sets both

_FAULTS = 12  # that are told of one file

_PARTS = 16  # of a key of `--set`

M = TypeVar("M", bound=Model)


def read_toml(path: Path, model: type[M], kind: FileKind = SETTINGS) -> M:
    """Read a TOML file as `model`. Raises ConfigError that lists its errors and their keys, or its kind's error."""
    return parse(model, reading.read_toml(path, kind), escaped(path))


def parse(model: type[M], data: dict[str, Any], where: str) -> M:
    """Validate `data` as `model`. Raises ConfigError with `where`, the key, the value and what was expected."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        found = _causes(error.errors())
        told = [fault(model, item) for item in found[:_FAULTS]]
        more = ["and more"] if len(found) > _FAULTS else []
        raise ConfigError(f"{where}: " + "; ".join([*told, *more])) from None


def _causes(found: Sequence[Any]) -> list[Any]:
    """Errors of pydantic without those of lists that are too short only as an item of theirs is wrong."""
    above = {item["loc"][:depth] for item in found for depth in range(len(item["loc"]))}
    return [item for item in found if item["type"] != "too_short" or item["loc"] not in above]


def parse_json(model: type[M], text: str, where: str) -> M:
    """Validate JSON text as `parse` validates data."""
    return parse(model, reading.parse_json(text, where, CONFIG), where)


Layer = Path | str | Mapping[str, Any] | Sequence[str] | None
"""A TOML file, a `section.key=value` (or several of them), or tables of keys; None adds nothing."""


def resolve(base: str | RunConfig, *layers: Layer) -> RunConfig:
    """A configuration: a preset, or one that is resolved already, with layers over it, the last one on top.

    Args:
        base: Name of a preset, or a configuration.
        layers: What is laid over it. Values of a `section.key=value` are in TOML syntax, or words. A plant that a file
            or a `section.key=value` names brings the `[chair]` of its own file, below all layers, and takes away what
            that of the plant before it has set; one in tables of keys, or that is the base's already, does not.

    Raises:
        ConfigError: There is no such preset or file, or a key or value cannot be used; it says what was expected.
    """
    own = [table for layer in layers for table in _tables(layer)]
    where, data = (
        _preset(base) if isinstance(base, str) else ("configuration", base.model_dump(mode="json"))
    )
    data = _giving_way(_with_plant(data, layers), own)
    for _, table in own:
        data = _merged(data, table)
    return parse(RunConfig, data, own[-1][0] if own else where)


def _tables(layer: Layer) -> list[tuple[str, dict[str, Any]]]:
    """The tables of a layer, each with the place that an error names."""
    if layer is None:
        return []
    if isinstance(layer, Path):
        return [(escaped(layer), reading.read_toml(layer, SETTINGS))]
    if isinstance(layer, Mapping):
        return [("configuration", dict(layer))]
    texts = (layer,) if isinstance(layer, str) else layer
    return [(f"--set {escaped(text)}", _override(text)) for text in texts]


def presets() -> str:
    """What each preset learns from, for how long, and what came of it: a table in Markdown."""
    return (_PRESETS / "presets.md").read_text(encoding="utf-8")


def _preset(name: str) -> tuple[str, dict[str, Any]]:
    path = _PRESETS / f"{name}.toml"
    if not path.is_file():
        known = sorted(item.stem for item in _PRESETS.glob("*.toml"))
        told = f"unknown preset {escaped(name)!r}; expected one of: {', '.join(known)}"
        raise ConfigError(told + meant(name, known))
    return f"preset {name}", reading.read_toml(path, SETTINGS)


def _with_plant(data: dict[str, Any], layers: Sequence[Layer]) -> dict[str, Any]:
    """Data with `[chair]` as the plant's file says that somebody names, without what the last plant's file said."""
    told = [
        table for layer in layers if not isinstance(layer, Mapping) for _, table in _tables(layer)
    ]
    chairs = [chair for table in told if isinstance(chair := table.get("chair"), dict)]
    named = [plant for chair in chairs if isinstance(plant := chair.get("plant"), str)]
    was = data.get("chair", {})
    if not named or named[-1] == was.get("plant"):
        return data
    old, new = (_chair_of_plant(plant) for plant in (str(was.get("plant")), named[-1]))
    gone = {key for key, value in old.items() if was.get(key) == value} | new.keys()
    if not gone.isdisjoint(_SPEED):
        gone |= _SPEED
    return {**data, "chair": {key: value for key, value in was.items() if key not in gone} | new}


def _chair_of_plant(plant: str) -> dict[str, Any]:
    """`[chair]` of a plant's file; whoever reads the whole plant says that it is missing or wrong."""
    path = Path(plant if plant.endswith(".toml") else _PLANTS / f"{plant}.toml")
    chair = reading.read_toml(path, SETTINGS).get("chair") if reading.is_file(path) else None
    return chair if isinstance(chair, dict) else {}


def _giving_way(data: dict[str, Any], own: Sequence[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
    """Data below what is asked for: its speed gives way to a named profile's, unless a speed is asked for, too."""
    chairs = [chair for _, table in own if isinstance(chair := table.get("chair"), dict)]
    named = [str(chair["profile"]) for chair in chairs if "profile" in chair]
    if (
        named
        and named[-1] in PROFILE_SPEED_MPS
        and not any("v_max_mps" in chair for chair in chairs)
    ):
        chair = {key: value for key, value in data.get("chair", {}).items() if key != "v_max_mps"}
        return {**data, "chair": chair}
    return data


def sets_key(override: str, key: str) -> bool:
    """Whether a `section.key=value` sets a key, or a part of it; `section={key=value}` does as well.

    >>> sets_key("env.profile=slow", "env.profile"), sets_key("env={profile='slow'}", "env.profile")
    (True, True)
    >>> sets_key("env.window=2", "env.profile")
    False

    Raises:
        ConfigError: It is no `section.key=value`.
    """
    data: Any = _override(override)
    for part in key.split("."):
        if not isinstance(data, dict) or part not in data:
            return False
        data = data[part]
    return True


def texts_of(override: str) -> tuple[str, ...]:
    """Every text that a `section.key=value` sets, in tables and lists too.

    >>> texts_of("chair={plant='my chair.toml'}"), texts_of("env.window=2")
    (('my chair.toml',), ())

    Raises:
        ConfigError: It is no `section.key=value`.
    """
    found, waiting = [], [_override(override)]
    while waiting:
        value: Any = waiting.pop()
        if isinstance(value, str):
            found.append(value)
        elif isinstance(value, dict | list):
            waiting.extend(value.values() if isinstance(value, dict) else value)
    return tuple(found)


def _override(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    where = f"--set {escaped(text)}"
    if not equals or not all(parts) or len(parts) > _PARTS:
        raise ConfigError(
            f"--set {escaped(text)!r} is not section.key=value, for example learn.total_steps=2000"
        )
    try:
        table = reading.parse_toml(f"value = {value}", where, VALUE)
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
    if isinstance(value, dict):
        old = by_word(key, old)  # a key inside it changes that key alone
    if isinstance(old, dict) and isinstance(value, dict):
        return _merged(old, value)
    if isinstance(old, list) and isinstance(value, dict):
        strange = [escaped(item, 40) for item in value if item not in map(str, range(len(old)))]
        if strange:
            raise ConfigError(_no_such_item(key, strange[0], len(old)))
        return [
            _laid(item, value[str(i)], str(i)) if str(i) in value else item
            for i, item in enumerate(old)
        ]
    return value


def _no_such_item(key: str, item: str, count: int) -> str:
    """What is wrong with `key.item` of a list."""
    known = f"{key}.0" if count == 1 else f"{key}.0 to {key}.{count - 1}"
    more = f"; to add more, repeat [[{key}]] in a FILE for --config" if key == "cameras" else ""
    return (
        f"{key}.{item}: there is no such item, the list {key} has {count}; expected {known}{more}"
    )

"""Configuration from presets, files and `section.key=value`.

The rule of precedence: of all layers that set a key, the last one wins. From the bottom the layers
are the models' defaults, a preset (or a configuration), the file of `--config`, each `--set`, the
options of a command, and last what a learner, its network and its run folder fix.

Two keys stand for several: `chair.plant` brings `[chair]` of the plant's file, and `chair.profile`
brings a top speed. What they bring belongs to the bottom layer: it replaces values there, and every
layer wins over it. Tables of wcsim itself choose no plant: they only say where its file lies.

A rear camera that `env.camera` brings has the settings of the first camera, and follows them until
it gets its own.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import ValidationError

from wcsim.config.base import Model, format_validation_error
from wcsim.config.chair import PROFILE_SPEED_MPS
from wcsim.config.run import RunConfig
from wcsim.config.sensors import REAR, sensor_table_from_word
from wcsim.core import reading
from wcsim.core.reading import CONFIG, SETTINGS, VALUE, FileSpec, escape
from wcsim.errors import ConfigError, meant

_PLANTS: Final = Path(__file__).parent / "plants"
_PRESETS: Final = Path(__file__).parent / "presets"

# A plant's file that sets one of them sets both.
_SPEED_KEYS: Final = frozenset({"profile", "v_max_mps"})

# Faults of one file that a message lists.
_MOST_FAULTS: Final = 12

# Parts of a key of --set, separated by dots.
_MOST_PARTS: Final = 16

M = TypeVar("M", bound=Model)

Layer = Path | str | Mapping[str, Any] | Sequence[str] | None
"""A TOML file, a `section.key=value` (or several), or tables of keys; None adds nothing."""


def read_toml(path: Path, model: type[M], kind: FileSpec = SETTINGS) -> M:
    """Read a TOML file as `model`.

    Raises:
        ConfigError: It lists the file's faults with their keys; or the error of its kind.
    """
    return parse(model, reading.read_toml(path, kind), escape(path))


def parse(model: type[M], data: dict[str, Any], where: str) -> M:
    """Validate `data` as `model`.

    Raises:
        ConfigError: It names `where`, the key, the value and what was expected.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # Without lists that are too short only because an item is wrong.
        errors = error.errors()
        above = {item["loc"][:depth] for item in errors for depth in range(len(item["loc"]))}
        causes = [
            each for each in errors if each["type"] != "too_short" or each["loc"] not in above
        ]
        faults = [format_validation_error(model, item) for item in causes[:_MOST_FAULTS]]
        if len(causes) > _MOST_FAULTS:
            faults.append("and more")
        raise ConfigError(f"{where}: " + "; ".join(faults)) from None


def parse_json(model: type[M], text: str, where: str) -> M:
    """Validate JSON text as `parse` validates data."""
    return parse(model, reading.parse_json(text, where, CONFIG), where)


def resolve(base: str | RunConfig, *layers: Layer) -> RunConfig:
    """A preset or a configuration with layers over it, by the rule of precedence of this file.

    Args:
        base: Name of a preset, or a configuration that is resolved already.
        layers: What is laid over it, the last one on top. Values of a `section.key=value` are in
            TOML syntax, or words.

    Raises:
        ConfigError: There is no such preset or file, or a key or value cannot be used; it says what
            was expected.
    """
    # 1. Read all layers. A file or text of the user may choose a plant.
    tables: list[tuple[str, dict[str, Any]]] = []
    plants = []
    for layer in layers:
        read = _tables(layer)
        tables += read
        if not isinstance(layer, Mapping):
            named = (chair.get("plant") for chair in _chairs(read))
            plants += [plant for plant in named if isinstance(plant, str)]

    # 2. Let a chosen plant and a named speed change the bottom layer.
    if isinstance(base, str):
        where, data = _preset(base)
    else:
        where, data = "configuration", base.model_dump(mode="json")
    chair = data.get("chair", {})
    if plants and plants[-1] != chair.get("plant"):
        chair = _with_plant(chair, plants[-1])
    if _names_speed(_chairs(tables)):
        chair = {key: value for key, value in chair.items() if key != "v_max_mps"}
    below = data = {**data, "chair": chair}

    # 3. Lay the layers over it, and validate the whole once.
    for _, table in tables:
        data = _merged(data, table)
    data = _with_rear_camera(data, below)
    return parse(RunConfig, data, tables[-1][0] if tables else where)


def _with_rear_camera(data: dict[str, Any], below: dict[str, Any]) -> dict[str, Any]:
    """`data` with the rear camera that its `env.camera` names; `below` is the bottom layer."""
    before, cameras, env = below.get("cameras", [{}]), data.get("cameras", [{}]), data.get("env")
    names = env.get("camera") if isinstance(env, dict) else None
    # Validation reports what is wrong with them.
    usable = isinstance(cameras, list) and all(isinstance(camera, dict) for camera in cameras)
    if not isinstance(names, list) or REAR["name"] not in names or not usable or not cameras:
        return data
    # One that nobody has changed is made anew of what the first camera is now.
    made, unchanged = {**cameras[0], **REAR}, {**before[0], **REAR}
    cameras = [made if camera == unchanged and camera in before else camera for camera in cameras]
    if all(camera.get("name") != REAR["name"] for camera in cameras):
        cameras.append(made)
    return {**data, "cameras": cameras}


def _tables(layer: Layer) -> list[tuple[str, dict[str, Any]]]:
    """The tables of a layer, each with the place that an error names."""
    if layer is None:
        return []
    if isinstance(layer, Path):
        return [(escape(layer), reading.read_toml(layer, SETTINGS))]
    if isinstance(layer, Mapping):
        return [("configuration", dict(layer))]
    texts = (layer,) if isinstance(layer, str) else layer
    return [(f"--set {escape(text)}", _override(text)) for text in texts]


def _chairs(tables: Sequence[tuple[str, dict[str, Any]]]) -> list[dict[str, Any]]:
    """`[chair]` of each table that has one."""
    return [chair for _, table in tables if isinstance(chair := table.get("chair"), dict)]


def _names_speed(chairs: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the last profile among these brings a speed, and none of them sets a speed."""
    profiles = [str(chair["profile"]) for chair in chairs if "profile" in chair]
    return (
        bool(profiles)
        and profiles[-1] in PROFILE_SPEED_MPS
        and not any("v_max_mps" in chair for chair in chairs)
    )


def _with_plant(chair: dict[str, Any], plant: str) -> dict[str, Any]:
    """`[chair]` with what a plant's file says, and without what the file of its old plant said."""
    old = _chair_of_plant(str(chair.get("plant")))
    new = _chair_of_plant(plant)
    replaced = {key for key, value in old.items() if chair.get(key) == value} | new.keys()
    if not replaced.isdisjoint(_SPEED_KEYS):
        replaced |= _SPEED_KEYS
    return {key: value for key, value in chair.items() if key not in replaced} | new


def _chair_of_plant(plant: str) -> dict[str, Any]:
    """`[chair]` of a plant's file; {} where it is missing or wrong, which its reader reports."""
    path = Path(plant if plant.endswith(".toml") else _PLANTS / f"{plant}.toml")
    chair = reading.read_toml(path, SETTINGS).get("chair") if reading.is_file(path) else None
    return chair if isinstance(chair, dict) else {}


def format_presets_table() -> str:
    """What each preset learns from, for how long, and its results: a table in Markdown."""
    return (_PRESETS / "presets.md").read_text(encoding="utf-8")


def _preset(name: str) -> tuple[str, dict[str, Any]]:
    """What an error names, and the preset's tables."""
    path = _PRESETS / f"{name}.toml"
    if not path.is_file():
        known = sorted(item.stem for item in _PRESETS.glob("*.toml"))
        raise ConfigError(
            f"unknown preset {escape(name)!r}; expected one of: {', '.join(known)}"
            + meant(name, known)
        )
    return f"preset {name}", reading.read_toml(path, SETTINGS)


def is_override_of_key(override: str, key: str) -> bool:
    """Whether a `section.key=value` sets a key or a part of it, as `section={key=value}` does.

    >>> (
    ...     is_override_of_key("env.profile=slow", "env.profile"),
    ...     is_override_of_key("env={profile='slow'}", "env.profile"),
    ... )
    (True, True)
    >>> is_override_of_key("env.window=2", "env.profile")
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


def texts_from_override(override: str) -> tuple[str, ...]:
    """Every text that a `section.key=value` sets, in tables and lists too.

    >>> texts_from_override("chair={plant='my chair.toml'}"), texts_from_override("env.window=2")
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
    where = f"--set {escape(text)}"
    if not equals or not all(parts) or len(parts) > _MOST_PARTS:
        raise ConfigError(
            f"--set {escape(text)!r} is not section.key=value, for example learn.total_steps=2000"
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
    """`over` laid on `base`: tables are merged, all else is replaced, items of lists by number."""
    return {**base, **{key: _laid(base.get(key), value, key) for key, value in over.items()}}


def _laid(old: Any, value: Any, key: str) -> Any:
    if isinstance(value, dict):
        old = sensor_table_from_word(key, old)  # a key inside it changes that key alone
    if isinstance(old, dict) and isinstance(value, dict):
        return _merged(old, value)
    if isinstance(old, list) and isinstance(value, dict):
        strange = [escape(item, 40) for item in value if item not in map(str, range(len(old)))]
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

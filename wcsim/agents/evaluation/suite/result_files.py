"""What a test on a suite leaves in its folder, read again; whoever wrote it, only what fits comes through."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Final

from wcsim.agents.evaluation.suite.records import STATUSES, EpisodeRecord, record_of
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError

RESULT: Final = "result.json"
EPISODES: Final = "episodes.json"
ASKED: Final = "asked.json"  # with what words the test was asked for, as far as the result does not say it
TOWNS: Final = "towns"  # made ones lie there
_KIND = FileKind(what="a file of `wcsim test --suite`: run it again", limit_bytes=1 << 30, error=ConfigError)
_MOST_TEXT: Final = 4096
_LARGEST: Final = 1e12  # of a number, so that sums and squares of any are finite
_PLAIN: Final[Mapping[str, tuple[type, ...]]] = {"int": (int,), "float": (int, float), "str": (str,), "bool": (bool,)}
_COUNTS: Final = ("crashes_own",)  # of a row, which a page adds up
_NUMBERS: Final = (*_COUNTS, "km", "score")
_MEASURED: Final = ("accel_sq_sum", "stick_travel", "asked_travel")  # a result of an older version has none of them

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptEpisode:
    """An episode of a finished test; None is what its version did not record."""

    record: EpisodeRecord
    said: Mapping[str, Any]  # as it stands in the file
    path_m: tuple[tuple[float, float], ...] | None  # W, once a second from the hand-over on, and where it ended
    accel_sq_sum: float | None  # (m/s2)^2, over steps
    stick_travel: float | None  # way of the given stick
    asked_travel: float | None  # way of the user's stick


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptResult:
    """A finished test."""

    suite: str
    set: str
    list_sha256: str
    changed: tuple[str, ...]  # settings, over those of the list
    rows: tuple[Row, ...]  # a policy and a part each
    pooled: tuple[Row, ...]
    episodes: Mapping[str, tuple[KeptEpisode, ...]]  # by policy, as in `pooled`
    list_name: str  # of a list that comes with wcsim, or its path
    preset: str
    network: str
    out: str  # the folder as it was typed, or "" where an older version did not write it down


def read_episodes(folder: Path) -> dict[str, tuple[KeptEpisode, ...]]:
    """The episodes of a finished test, by policy. Raises ConfigError."""
    path = folder / EPISODES
    data = read_json(path, _KIND)
    found = {}
    for name, items in data.items():
        if not isinstance(items, list) or not items:
            raise ConfigError(f"{escaped(path)}: is damaged; expected a list of episodes for each policy")
        found[name] = tuple(_episode(item, path) for item in items)
    return found


def read_result(folder: Path) -> KeptResult:
    """A finished test. Raises ConfigError when the folder holds none, or files in it do not fit each other."""
    path = folder / RESULT
    data = read_json(path, _KIND)
    rows, pooled = (_rows(data.get(name), path) for name in ("rows", "pooled"))
    episodes = read_episodes(folder)
    names = [row["policy"] for row in pooled]
    changed = data.get("changed", [])
    if set(names) != set(episodes) or not isinstance(changed, list):
        raise ConfigError(f"{escaped(path)}: names other policies than {EPISODES}; run the test again with --resume")
    asked = read_json(folder / ASKED, _KIND) if is_file(folder / ASKED) else {}
    return KeptResult(
        suite=_text(data.get("suite"), path),
        set=_text(data.get("set"), path),
        list_sha256=_text(data.get("list_sha256"), path),
        changed=tuple(_text(word, path) for word in changed),
        rows=rows,
        pooled=pooled,
        episodes={name: episodes[name] for name in names},
        list_name=_text(asked.get("suite", data.get("set")), path),
        preset=_text(asked.get("preset", "quick"), path),
        network=_text(asked.get("network", ""), path),
        out=_text(asked.get("out", ""), path),
    )


def _rows(items: object, path: Path) -> tuple[Row, ...]:
    if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
        raise ConfigError(f"{escaped(path)}: is damaged; expected rows of a test")
    for item in items:
        _text(item.get("policy"), path)
        _text(item.get("part"), path)
        wrong = [name for name in _NUMBERS if not _is_number(item.get(name, 0), name)]
        if wrong or "crashes_own" not in item:
            name = wrong[0] if wrong else "crashes_own"
            raise ConfigError(
                f"{escaped(path)}: is damaged; got {name} {str(item.get(name))[:40]!r}, expected a number"
            )
    return tuple(items)


def _is_number(value: object, name: str) -> bool:
    if value is None:
        return name not in _COUNTS
    return _is(value, (int, float)) and (name not in _COUNTS or isinstance(value, int))


def _text(value: object, path: Path) -> str:
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise ConfigError(f"{escaped(path)}: is damaged; got {str(value)[:40]!r}, expected a text")
    return value


def _episode(data: object, path: Path) -> KeptEpisode:
    """One episode of the file; fields that this version's records do not have are those of `_MEASURED` alone."""
    if not isinstance(data, dict):
        raise ConfigError(f"{escaped(path)}: is damaged; expected an episode, got {str(data)[:40]!r}")
    own = {field.name for field in fields(EpisodeRecord)}
    for field in fields(EpisodeRecord):
        there = field.name in data
        expected = _PLAIN.get(str(field.type))
        fits = not there or expected is None or _is(data[field.name], expected)
        if not fits or (not there and field.default is MISSING):
            raise ConfigError(f"{escaped(path)}: is damaged; {field.name} of an episode is not {field.type}")
    beside = {"path_m", *_MEASURED} - own
    try:
        record = record_of({key: value for key, value in data.items() if key not in beside})
        path_m = _points(data["path_m"]) if data.get("path_m") else None
        _points([record.end_m])
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{escaped(path)}: is damaged ({error}); expected an episode") from None
    if record.status not in STATUSES:
        raise ConfigError(f"{escaped(path)}: status {escaped(record.status)!r}; expected one of {', '.join(STATUSES)}")
    measured = {name: _measured(data.get(name), path) for name in _MEASURED}
    return KeptEpisode(record=record, said=data, path_m=path_m, **measured)


def _measured(value: object, path: Path) -> float | None:
    if value is None:
        return None
    if isinstance(value, int | float) and _is(value, (int, float)):
        return float(value)
    raise ConfigError(f"{escaped(path)}: is damaged; got {str(value)[:40]!r}, expected a number")


def _is(value: object, expected: tuple[type, ...]) -> bool:
    if isinstance(value, bool) and bool not in expected:
        return False
    return isinstance(value, expected) and (not isinstance(value, int | float) or abs(value) <= _LARGEST)


def _points(items: Any) -> tuple[tuple[float, float], ...]:
    points = tuple((x, y) for x, y in items)
    if not all(_is(value, (int, float)) for point in points for value in point):
        raise ValueError("a place that is not two numbers")
    return points

"""What a test leaves in its folder, read again; whoever wrote it, only what fits comes through."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wcsim.agents.evaluation.suite.records import SCORE_VERSION, EpisodeRecord, Records, record_of
from wcsim.agents.evaluation.suite.rows import ResultRow, pooled_rows
from wcsim.agents.policy_api import UNAIDED
from wcsim.core import reading
from wcsim.core.reading import JsonObject, escape, is_file, read_json
from wcsim.errors import ConfigError

RESULT: Final = "result.json"
EPISODES: Final = "episodes.json"
# with what words the test was asked for, as far as the result does not say it
ASKED: Final = "asked.json"
LIST: Final = "list.json"  # the episodes that were drawn for it
TOWNS: Final = "towns"  # made ones lie there
_MOST_TEXT: Final = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class TestResult:
    """A finished test; its rows are those of its episodes."""

    __test__ = False  # it is not a test case of pytest

    suite: str
    set: str
    list_sha256: str
    changed: tuple[str, ...]  # settings, over those of the list
    rows: tuple[ResultRow, ...]  # a policy and a part each
    pooled: tuple[ResultRow, ...]
    episodes: Mapping[str, Records]  # by policy, as in `pooled`
    list_name: str  # of a list that comes with wcsim, or its path
    preset: str
    network: str
    out: str  # the folder as it was typed

    @property
    def parts(self) -> list[str]:
        """In the order of their first episodes."""
        return list(dict.fromkeys(row.part for row in self.rows))

    def to_json(self) -> JsonObject:
        """What `result.json` holds: the whole result as plain values.

        The version is in the suite's name.

        The last is a hash over what was asked and every number of its episodes.
        """
        content: JsonObject = {
            name: getattr(self, name) for name in ("suite", "set", "list_sha256")
        }
        content |= {"score_version": SCORE_VERSION, "changed": list(self.changed)}
        text = hashlib.sha256(json.dumps(content).encode())
        for policy, found in self.episodes.items():
            text.update(json.dumps([policy, *(each.to_json() for each in found)]).encode())
        rows, pooled = ([row.to_json() for row in rows] for rows in (self.rows, self.pooled))
        return {**content, "rows": rows, "pooled": pooled, "sha256": text.hexdigest()}


def result_of(episodes: Mapping[str, Sequence[EpisodeRecord]], **content: Any) -> TestResult:
    """The result of these episodes, by policy.

    `content` is the rest of it, by the names of its fields.
    """
    tables = [
        pooled_rows(name, found, episodes.get(UNAIDED, ())) for name, found in episodes.items()
    ]
    return TestResult(
        rows=tuple(row for rows, _ in tables for row in rows),
        pooled=tuple(whole for _, whole in tables),
        episodes={name: tuple(found) for name, found in episodes.items()},
        **content,
    )


def read_episodes(folder: Path) -> dict[str, Records]:
    """The episodes of a finished test, by policy. Raises ConfigError."""
    path = folder / EPISODES
    found = {}
    for name, items in read_json(path, reading.RESULT).items():
        if not isinstance(items, list) or not items:
            raise ConfigError(
                f"{escape(path)}: is damaged; expected a list of episodes for each policy"
            )
        try:
            found[name] = tuple(map(record_of, items))
        except ConfigError as error:
            raise ConfigError(f"{escape(path)}: {error}") from None
    return found


def read_result(folder: Path) -> TestResult:
    """A finished test. Raises ConfigError when the folder holds none."""
    path = folder / RESULT
    data = read_json(path, reading.RESULT)
    request = read_json(folder / ASKED, reading.RESULT) if is_file(folder / ASKED) else {}
    changed = data.get("changed")
    if not isinstance(changed, list):
        raise ConfigError(
            f"{escape(path)}: is damaged; expected the list `changed`: run the test again"
        )
    content = {name: data.get(name) for name in ("suite", "set", "list_sha256")}
    content |= {
        name: request.get(name, usual)
        for name, usual in (("preset", "quick"), ("network", ""), ("out", ""))
    }
    content["list_name"] = request.get("suite", data.get("set"))
    texts = {name: _text(value, path) for name, value in content.items()}
    result = result_of(
        read_episodes(folder), changed=tuple(_text(word, path) for word in changed), **texts
    )
    if _plain(data) != _plain(result.to_json()):
        raise ConfigError(
            f"{escape(path)}: is not what {EPISODES} beside it gives by version {SCORE_VERSION} of "
            "the score; expected both of one test: run it again with --resume, which keeps what "
            "was driven"
        )
    return result


def _plain(content: Any) -> Any:
    """As JSON holds it, without the last digits of its numbers: processors differ in them."""
    return json.loads(json.dumps(content), parse_float=lambda digits: round(float(digits), 6))


def _text(value: object, path: Path) -> str:
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise ConfigError(
            f"{escape(path)}: is damaged; got {str(value)[:40]!r}, expected a text: run the test "
            "again"
        )
    return value

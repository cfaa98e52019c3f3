"""A finished test of five policies over six episodes, made up."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wcsim.agents.evaluation.suite.records import NEEDLESS, EpisodeRecord, Intervention
from wcsim.agents.evaluation.suite.result_files import TestResult, read_episodes, result_of

SCRIPT = "<script>alert(1)</script>"
PATH_M = ((1.0, 0.0), (2.5, 0.0))  # after 1 s, and after 1.5
WAYS = {"path_m": PATH_M, "accel_sq_sum": 25.0, "stick_travel": 30.0, "asked_travel": 10.0}
POLICIES = ("follow", "dwa", "net@0.25", "net@0.75", SCRIPT)


def record(place: int, **changes: Any) -> EpisodeRecord:
    plain: dict[str, Any] = {
        "block": place // 2, "seat": place % 2, "part": "free" if place < 4 else "hazard", "town": "nowhere",
        "profile": "ataxic", "status": "finished", "steps": 100, "time_s": 1.5, "m": 40.0, "route_m": 50.0,
        "done_m": 50.0, "distance_sum": 4.0, "within": 95, "end_m": (2.5, 0.0),
    }  # fmt: skip
    return EpisodeRecord(**{**plain, **changes})


def crashed(place: int, **changes: Any) -> EpisodeRecord:
    plain = {"status": "chair_crashed", "reason": "collision", "fault": "own", "done_m": 20.0}
    return record(place, **{**plain, **changes})


def unreached(place: int) -> EpisodeRecord:
    return record(place, status="not_reached", reason="collision", steps=0, m=0.0)


def records_of(policy: str) -> tuple[EpisodeRecord, ...]:
    """`follow` falls and hits in eight of twelve, `dwa` in none, the others in between."""
    late = [record(place, status="timed_out") for place in (5, 10, 11)]
    if policy == "follow":
        bad = [crashed(0, reason="drop"), crashed(1, partner="car"), crashed(2, partner="static")]
        return (*bad, record(3, red_entries=1), crashed(4), late[0], *map(crashed, range(6, 10)), *late[1:])
    if policy == "dwa":
        return (*map(record, range(5)), late[0], *map(record, range(6, 10)), *late[1:])
    needless = Intervention(first=1, last=9, verdict=NEEDLESS, needless_steps=9)
    helped = record(11, interventions=(needless,))
    worst = crashed(0, partner="pedestrian", end_m=(3.0, 4.0), crash="hit", last_moment_s=0.9, cause="late")
    return (
        worst,
        record(1, status="policy_failed", reason=f"RuntimeError: {SCRIPT}"),
        *map(record, range(2, 11)),
        helped,
    )


UNSAID = {"list_name": "try", "preset": "quick", "network": "", "out": ""}


def write_result(folder: Path, **changes: Any) -> dict[str, Any]:
    """Write the files of a test; `result.json` as it stands there."""
    records = {name: [replace(item, **WAYS) for item in records_of(name)] for name in POLICIES}
    said = {"suite": "made-up-v1", "set": "try", "list_sha256": "0" * 64, "changed": ("world.tick_s=0.1",)}
    result = {**result_of(records, **said, **UNSAID).to_json(), **changes}
    episodes = {name: [item.to_json() for item in found] for name, found in records.items()}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(result))
    (folder / "episodes.json").write_text(json.dumps(episodes))
    return result


def score_anew(folder: Path) -> None:
    """Give a folder's result the rows of the episodes that lie there now."""
    said = json.loads((folder / "result.json").read_text("utf-8"))
    named = {name: said[name] for name in ("suite", "set", "list_sha256")}
    result = result_of(read_episodes(folder), changed=tuple(said["changed"]), **named, **UNSAID)
    (folder / "result.json").write_text(json.dumps(result.to_json()))


def with_episodes(result: TestResult, episodes: Mapping[str, Sequence[EpisodeRecord]]) -> TestResult:
    """The result of other episodes."""
    rest = ("suite", "set", "list_sha256", "changed", "list_name", "preset", "network", "out")
    return result_of(episodes, **{name: getattr(result, name) for name in rest})

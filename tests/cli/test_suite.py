"""`wcsim test --suite`: the result, its keys, and what is refused."""

import json

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from wcsim.agents.evaluation.suite.list_file import write_list
from wcsim.cli import main

KEYS = {
    "policy", "part", "episodes", "status", "km", "crashes_own", "crashes_other", "drops", "crash_reasons",
    "crashes_per_km", "crashes_per_km_ci", "kpi1", "kpi1_free_within", "kpi2_median", "alive_at_end", "speed_mps",
    "arrivals", "attempts", "road_s", "red_entries", "blocked_share", "freezes", "needed", "needless", "missed",
    "warned_share", "false_warnings_per_km", "score", "score_ci",
}  # fmt: skip


@pytest.fixture(scope="module")
def small(corner, tmp_path_factory):
    path = tmp_path_factory.mktemp("list") / "corner.json"
    write_list(suite_in(corner, block_of(corner, max_steps=20)).file, path)
    return path


def run(*words):
    return main.main(["test", *map(str, words)])


def test_a_list_gives_rows_with_all_keys_and_says_what_was_changed(small, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("--suite", small, "stop", "--only", "--out", out, "--clean") == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert {"suite", "set", "list_sha256", "rows", "pooled"} <= result.keys()
    assert [row["policy"] for row in result["pooled"]] == ["follow", "stop"]
    assert all(row.keys() >= KEYS for row in result["rows"] + result["pooled"])
    assert result["changed"] and "CHANGED" in capsys.readouterr().out
    assert set(json.loads((out / "episodes.json").read_text(encoding="utf-8"))) == {"follow", "stop"}
    assert run("--suite", small, "stop", "--only", "--out", out, "--clean") == 2  # something is there
    assert "--resume" in capsys.readouterr().err
    assert run("--suite", small, "stop", "--only", "--out", out, "--clean", "--resume") == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--suite", "nothing"), "no such list"), (("--suite", "dev", "--jobs", "0"), "--jobs")],
)
def test_what_cannot_be_is_refused(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*words) == 2
    assert said in capsys.readouterr().err

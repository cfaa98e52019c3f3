"""`wcsim test --suite`: the result, its keys, and what is refused."""

import io
import json
import re

import pytest
from rich.console import Console

from tests.agents.evaluation.suite.lists import written_list
from tests.agents.evaluation.suite.test_list_rules import run_of
from tests.support.one_process import in_this_process
from wcsim.cli import main
from wcsim.cli.evaluation.result_tables import show_result

KEYS = {
    "policy", "part", "episodes", "status", "km", "crashes_own", "crashes_other", "drops", "crash_reasons",
    "crashes_per_km", "crashes_per_km_ci", "kpi1", "kpi1_free_within", "kpi2_median", "alive_at_end", "speed_mps",
    "arrivals", "attempts", "road_s", "red_entries", "blocked_share", "freezes", "needed", "needless", "missed",
    "warned_share", "false_warnings_per_km", "helps", "score", "score_ci",
}  # fmt: skip


@pytest.fixture(scope="module")
def small(corner, tmp_path_factory):
    return written_list(corner, tmp_path_factory.mktemp("list"), max_steps=20)


def run(*words):
    with in_this_process():
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


def test_a_line_says_which_rules_of_a_run_stay_behind(small, tmp_path, capsys):
    own = run_of(tmp_path / "own", "quick", "reward.drop=false", "world.warmup_s=0")
    assert run("--suite", small, own, "--only", "--out", tmp_path / "out") == 2  # it has no weights
    told = " ".join(capsys.readouterr().err.split())
    assert "was trained with reward.drop=false; all policies of a list are tested with reward.drop=true" in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--suite", "nothing"), "no such list"),
        (("--suite", "dev", "--jobs", "0"), "--jobs"),
        (("--suite", "dev", "--sensitivity", "--forks", "3"), "--sensitivity ignores --forks"),
        (("stop", "--suite", "dev", "--play", "0.0", "--sensitivity"), "--play ignores --sensitivity"),
    ],
)
def test_what_cannot_be_is_refused(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*words) == 2
    assert said in capsys.readouterr().err


def test_an_episode_is_driven_again_and_must_be_the_same(small, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("--suite", small, "--only", "--out", out) == 0
    words = ("follow", "--suite", small, "--out", out, "--play")
    assert run(*words, "0.1") == 0
    assert "the same as the saved one" in capsys.readouterr().out
    assert (out / "play" / "follow-0.1.webm").stat().st_size > 0
    episodes = json.loads((out / "episodes.json").read_text(encoding="utf-8"))
    episodes["follow"][1]["m"] += 0.5
    (out / "episodes.json").write_text(json.dumps(episodes), encoding="utf-8")
    assert run(*words, "0.1") == 2
    assert "run the test again" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [(("follow", "--play", "7.0"), "from 0 to 0"), (("--play", "0.0"), "takes one policy"),
     (("follow", "--play", "0.9"), "no seat 9")],
)  # fmt: skip
def test_what_cannot_be_played_is_refused(small, words, said, tmp_path, capsys):
    assert run("--suite", small, "--out", tmp_path / "out", *words) == 2
    assert said in capsys.readouterr().err


def test_names_in_tables_are_no_markup():
    """What stands in brackets would be gone."""
    rows = [{"policy": name, "episodes": 3, "part": "free"} for name in ("own:Robot:", "runs/[red]a")]
    console = Console(width=120, file=io.StringIO(), emoji=False)
    show_result(console, {"suite": "s [b]", "set": "x", "rows": rows, "pooled": rows}, (), ["runs/[red]b: failed"])
    told = console.file.getvalue()
    assert told.count("runs/[red]a") == 3 and "s [b] x: free" in told and "runs/[red]b: failed" in told


@pytest.mark.parametrize("parts", [("tight",), ("free", "tight")])
def test_a_list_of_one_part_is_shown_once(parts):
    row = {"policy": "follow", "episodes": 3}
    rows, pooled = [{**row, "part": part} for part in parts], [{**row, "part": ""}]
    console = Console(width=120, file=io.StringIO())
    show_result(console, {"suite": "s", "set": "x", "rows": rows, "pooled": pooled}, ())
    shown = re.findall(r"^s x: (.+), safety *$", console.file.getvalue(), re.MULTILINE)
    assert shown == [*parts, *(["all parts"] if len(parts) > 1 else [])]

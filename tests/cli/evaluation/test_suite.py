"""`wcsim test --suite`: the result, its keys, and what is refused."""

import io
import json
import re
from dataclasses import fields, replace

import pytest
from rich.console import Console

from tests.agents.evaluation.suite.lists import written_list
from tests.agents.evaluation.suite.test_records import GOOD
from tests.agents.opening.test_list_rules import run_of
from tests.cli.conftest import parsed
from tests.support.one_process import in_this_process
from wcsim.agents.evaluation.suite import run as suite_run
from wcsim.agents.evaluation.suite.records import NEEDLESS, Intervention
from wcsim.agents.evaluation.suite.result_files import result_of
from wcsim.agents.evaluation.suite.rows import ResultRow
from wcsim.agents.opening.list_file import open_suite, write_list
from wcsim.cli import main
from wcsim.cli.evaluation.result_tables import print_test_result

KEYS = {field.name for field in fields(ResultRow)}


@pytest.fixture(scope="module")
def small(corner, tmp_path_factory):
    return written_list(corner, tmp_path_factory.mktemp("list"), max_steps=20)


def run(*words):
    with in_this_process():
        return main.main(["test", *map(str, words)])


def test_a_list_gives_rows_with_all_keys_and_says_what_was_changed(small, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("--suite", small, "stop", "--only", "--out", out, "--clean") == 0
    result = parsed(out / "result.json")
    assert {"suite", "set", "list_sha256", "rows", "pooled"} <= result.keys()
    assert [row["policy"] for row in result["pooled"]] == ["follow", "stop"]
    assert all(row.keys() >= KEYS for row in result["rows"] + result["pooled"])
    assert result["changed"] and "CHANGED" in capsys.readouterr().out
    assert set(parsed(out / "episodes.json")) == {"follow", "stop"}
    assert run("--suite", small, "stop", "--only", "--out", out, "--clean") == 2  # something is there
    assert "--resume" in capsys.readouterr().err
    assert run("--suite", small, "stop", "--only", "--out", out, "--clean", "--resume") == 0


def test_a_line_says_which_rules_of_a_run_stay_behind(small, tmp_path, capsys):
    own = run_of(tmp_path / "own", "quick", "reward.drop=false", "world.warmup_s=0")
    assert run("--suite", small, own, "--only", "--out", tmp_path / "out") == 2  # it has no weights
    message = " ".join(capsys.readouterr().err.split())
    assert "was trained with reward.drop=false; all policies of a list are tested with reward.drop=true" in message


@pytest.mark.parametrize(
    "words, message",
    [
        (("--suite", "nothing"), "no such list"),
        (("--suite", "dev2", "--jobs", "0"), "--jobs"),
        (("--suite", "dev2", "--sensitivity", "--forks", "3"), "--forks"),
        (("stop", "--suite", "dev2", "--play", "0.0", "--sensitivity"), "--sensitivity"),
        (("--suite", "SMALL", "stop", "dwa", "--together", "--until-decided"), "no --until-decided"),
        (("--suite", "SMALL", "follow", "--play", "7.0"), "from 0 to 0"),
        (("--suite", "SMALL", "--play", "0.0"), "takes one policy"),
        (("--suite", "SMALL", "follow", "--play", "0.9"), "no seat 9"),
    ],
)
def test_what_cannot_be_is_refused(words, message, small, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*(small if word == "SMALL" else word for word in words)) == 2
    assert message in capsys.readouterr().err


def test_an_episode_is_driven_again_and_must_be_the_same(small, tmp_path, capsys):
    out = tmp_path / "out"
    assert run("--suite", small, "--only", "--out", out) == 0
    words = ("follow", "--suite", small, "--out", out, "--play")
    assert run(*words, "0.1") == 0
    assert "the same as the saved one" in capsys.readouterr().out
    assert (out / "play" / "follow-0.1.webm").stat().st_size > 0
    episodes = parsed(out / "episodes.json")
    episodes["follow"][1]["m"] += 0.5
    (out / "episodes.json").write_text(json.dumps(episodes), encoding="utf-8")
    assert run(*words, "0.1") == 2
    assert "run the test again" in capsys.readouterr().err


@pytest.mark.parametrize("saves, many", [(True, 10), (False, 25)])
def test_a_test_stops_as_soon_as_it_is_decided(saves, many, small, tmp_path, monkeypatch, capsys):
    file = open_suite(str(small)).file
    write_list(file.model_copy(update={"blocks": file.blocks * 25}), tmp_path / "many.json")
    crash = replace(GOOD, status="chair_crashed", fault="own")

    def run_suite(order, policies, done, blocks):
        found = {"follow": crash, "stop": GOOD if saves else crash}
        return {name: tuple(replace(found[name], block=each) for each in sorted(blocks)) for name in policies}

    monkeypatch.setattr(suite_run, "run_suite", run_suite)
    words = ("stop", "--suite", tmp_path / "many.json", "--only", "--until-decided", "--out", tmp_path / "out")
    assert run(*words, "--json", tmp_path / "r.json") == 0
    result = parsed(tmp_path / "r.json")
    assert {row["episodes"] for row in result["pooled"]} == {many}
    assert (result["changed"], result["set"]) == ([], "try, 10 of 25 blocks" if saves else "try")


def result(records, **changes):
    head = {"suite": "s", "set": "x", "list_sha256": "", "changed": (), "list_name": "x", "preset": "", "network": ""}
    return result_of(records, **{**head, "out": "", **changes})


def shown(found, width=120, undriven=()):
    console = Console(width=width, file=io.StringIO(), emoji=False, markup=False)
    print_test_result(console, found, undriven)
    return console.file.getvalue()


def test_names_in_tables_are_no_markup():
    """What stands in brackets would be gone."""
    records = {name: [GOOD] for name in ("own:Robot:", "runs/[red]a")}
    message = shown(result(records, suite="s [b]"), undriven=["runs/[red]b: failed"])
    assert message.count("runs/[red]a") == 1 and "s [b] x: free" in message and "runs/[red]b: failed" in message


@pytest.mark.parametrize("parts", [("tight",), ("free", "tight")])
def test_a_list_of_one_part_is_shown_once(parts):
    message = shown(result({"follow": [replace(GOOD, part=part) for part in parts]}))
    found = re.findall(r"^s x: (.+?) *$", message, re.MULTILINE)
    assert found == [*parts, *(["all parts"] if len(parts) > 1 else [])]


def test_the_tables_show_what_was_counted_and_call_the_oracles_upper_bounds():
    crash = {
        "status": "chair_crashed",
        "reason": "drop",
        "fault": "own",
        "crash": "fell off a kerb, edge e",
    }
    record = replace(GOOD, **crash, m=100.0, distance_sum=25.0, within=33, goals=2)
    text = shown(result({"follow": [record] * 2}), width=80)
    assert max(map(len, text.splitlines())) <= 80
    rows = [line.split()[1:] for line in text.splitlines() if line.split()[:1] == ["follow"]]
    assert rows == [["2", "of", "2", "33%", "0", "in", "2", "0", "of", "2", "none"]]
    assert "follow, episode 0.1: drop, own fault: it fell off a kerb, edge e" in text and "upper bound" not in text
    both = shown(result({name: [record] for name in ("follow", "oracle-visible", "oracle")}))
    assert "upper bound" in both and "road users in its cameras" in " ".join(both.split())


@pytest.mark.parametrize("width", [80, 100, 120])
def test_no_name_and_no_number_is_broken_however_long(width):
    many = {"interventions": (Intervention(first=1, last=2, verdict=NEEDLESS),) * 12_345}
    far = "/somewhere/experiments/2026-11/assistive-networks/runs"
    names = ["follow", "runs/demo", "runs/demo:phase1", "oracle-visible", f"{far}/a:phase1", f"{far}/b/two", "c/two"]
    names += [f"{far}/{'d' * 60}"]
    message = shown(result({name: [replace(GOOD, **many)] for name in names}), width)
    lines = [line.rstrip() for line in message.splitlines()]
    assert max(map(len, lines)) <= width and "…" not in message
    joined = "".join(lines)
    labels = [re.split(r" +0 of 1 ", line)[0] for line in lines if " 12345 in 1 " in line]
    assert len(set(labels)) == len(labels) == len(names)
    assert all(name in joined for name in names)

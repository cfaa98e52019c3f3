"""`wcsim report`: pages of a test and of a training, and what is refused."""

import contextlib
import json
import shutil
import sys

import pytest

from tests.agents.evaluation.suite.lists import written_list
from tests.cli.conftest import parsed
from tests.support.one_process import in_this_process
from tests.view.report.results import score_anew, write_result
from wcsim.cli.main import main

OWN = """
from pathlib import Path

Path("ran").write_text("own code")


class Still:
    name = "own:Still"

    def __init__(self, config):
        pass

    def begin(self):
        pass

    def reset(self):
        pass

    def act(self, observation):
        return 40
"""


@pytest.fixture(scope="module")
def finished(corner, tmp_path_factory):
    """A finished test of a short list by the user alone and by code of one's own; no episode comes to its end."""
    place = tmp_path_factory.mktemp("finished")
    (place / "own.py").write_text(OWN)
    written_list(corner, place, max_steps=30)
    with contextlib.chdir(place), in_this_process():
        assert main(["test", "own:Still", "--suite", "corner.json", "--only", "--out", "runs/out"]) == 0
    del sys.modules["own"]
    (place / "ran").unlink()
    return place


@pytest.fixture
def tested(finished, folder):
    shutil.copytree(finished, folder, dirs_exist_ok=True)
    return folder / "runs" / "out"


@pytest.mark.proof
def test_the_page_of_a_test_shows_its_failures_in_pictures_and_their_command_runs(wcsim, tested):
    result = wcsim("report", "runs/out", "--pictures", "1")
    assert result.code == 0 and "report.html" in result.out
    text = (tested / "report.html").read_text()
    driven = parsed(tested / "episodes.json")["follow"]
    assert {record["status"] for record in driven} == {"timed_out"}
    assert text.count("network saw it, 0.0 s before") == 1 and text.count('class="street"') == 1
    command = "wcsim test follow --suite corner.json --play 0.0 --out runs/out"
    assert command in text
    assert wcsim(*command.split()[1:]).code == 0


def test_a_result_that_cannot_be_driven_as_it_was_has_a_page_without_those_pictures(wcsim, tested):
    path = tested / "episodes.json"
    episodes = parsed(path)
    episodes["follow"][0]["m"] += 1.0
    path.write_text(json.dumps(episodes))
    score_anew(tested)
    assert wcsim("report", "runs/out", "--pictures", "2").code == 0
    text = (tested / "report.html").read_text()
    assert "wcsim test follow --suite corner.json --play 0.0 --out runs/out" in text
    assert "No pictures: episode 0.0 differs from the saved one" in text and text.count('class="street"') == 1


def test_another_list_gives_a_page_without_pictures_and_says_why(wcsim, folder):
    write_result(folder / "out", set="dev2")
    score_anew(folder / "out")
    result = wcsim("report", "out", "--out", "elsewhere")
    assert result.code == 0 and "list dev2 has the hash" in result.err
    assert "list dev2 has the hash" in (folder / "elsewhere" / "report.html").read_text()
    assert (folder / "elsewhere" / "report").is_dir() and not (folder / "out" / "report.html").exists()


def test_what_cannot_be_reported_is_refused(wcsim, folder, monkeypatch):
    (folder / "empty").mkdir()
    for place in ("empty", "nowhere"):
        result = wcsim("report", place)
        assert result.code == 2 and "nothing to report" in result.err
    write_result(folder / "out")
    assert wcsim("report", "out", "--jobs", "0").code == 2
    monkeypatch.setattr("wcsim.errors.find_spec", lambda name: None)
    result = wcsim("report", "out")
    assert result.code == 2 and "pip install 'wcsim[report]'" in result.err


def test_code_that_a_result_names_runs_only_when_it_is_named_again(wcsim, tested, folder, monkeypatch):
    monkeypatch.delitem(sys.modules, "own", raising=False)  # as in a process of its own
    assert wcsim("report", "runs/out", "--pictures", "1").code == 0
    page = tested / "report.html"
    assert not (folder / "ran").exists() and "runs when you name it" in page.read_text()
    assert wcsim("report", "runs/out", "--pictures", "1", "--own", "own:Still").code == 0
    assert (folder / "ran").exists() and "runs when you name it" not in page.read_text()

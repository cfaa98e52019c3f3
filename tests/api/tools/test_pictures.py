"""What README says of the help is what a file of results says; what is too large for a page is refused."""

import json

import cv2
import numpy as np
import pytest

from tests.view.report.results import write_result
from tools import pictures
from tools.pages import ROOT
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.view.report.comparisons import verdict


def test_readme_says_what_the_file_of_results_says():
    said = json.loads(pictures.FIGURES.read_text())["verdict"]
    assert f"<!-- help -->\n{said}\n<!-- /help -->" in (ROOT / pictures.README).read_text()


def test_a_new_result_is_said_in_its_place_alone(tmp_path):
    write_result(tmp_path)
    readme, figures = tmp_path / "README.md", tmp_path / "help.json"
    readme.write_text("before\n<!-- help -->\nold\n<!-- /help -->\nafter\n")
    pictures.say_help(read_result(tmp_path), figures, readme)
    said = verdict(read_result(tmp_path))
    assert readme.read_text() == f"before\n<!-- help -->\n{said}\n<!-- /help -->\nafter\n"
    assert json.loads(figures.read_text())["pooled"][0]["policy"] == "follow"


def test_a_film_that_is_too_large_is_refused(tmp_path, monkeypatch):
    frames = [np.full((24, 32, 3), shade, np.uint8) for shade in (0, 250)]
    pictures.write_webp(tmp_path / "a.webp", frames, 100)
    found, animation = cv2.imreadanimation(str(tmp_path / "a.webp"))
    assert found and len(animation.frames) == 2 and list(animation.durations) == [100, 100]
    monkeypatch.setattr(pictures, "MOST_BYTES", 10)
    with pytest.raises(SystemExit, match="expected at most 10"):
        pictures.write_webp(tmp_path / "a.webp", frames, 100)


def test_each_part_says_what_it_makes_and_an_unknown_one_is_refused():
    assert all(each.__doc__ for each in pictures.PARTS.values())
    with pytest.raises(SystemExit, match="unknown part 'atlantis'; expected one of: film, figures"):
        pictures.main(["atlantis"])

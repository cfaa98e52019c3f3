"""The page that a demo ends with."""

from dataclasses import replace

import pytest

from tests.drive.page.conftest import browser  # noqa: F401 - a fixture
from tests.drive.page.stage import IN_CHROMIUM
from tests.view.report.results import record, with_episodes, write_result
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.view.report.comparisons import verdict
from wcsim.view.report.suite_page import write_demo_page

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(300)]


SHOWN = {"learned": "It learned.", "film_webm": b"", "film_says": "", "key": (0, 1), "trained": ["car-door"]}
SHOWN = {**SHOWN, "commands": [("wcsim --help", "says more")]}


def test_no_column_is_cut_on_a_usual_screen(browser, tmp_path):  # noqa: F811 - that fixture
    write_result(tmp_path)
    records = [replace(record(0), m=12_340.0, crossings=100, goals=100, red_entries=10)] * 100
    names = ("follow", "runs/demo/learned", "oracle-visible")
    result = with_episodes(read_result(tmp_path), dict.fromkeys(names, records))
    path = write_demo_page(tmp_path, result, **SHOWN)
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.goto(path.as_uri())
    widths = page.locator(".wide").evaluate_all("(nodes) => nodes.map((node) => [node.scrollWidth, node.clientWidth])")
    assert widths and all(wide <= room for wide, room in widths)


def test_the_sentence_stands_first_the_table_is_narrow_and_the_rule_is_that_of_its_own_list(tmp_path):
    write_result(tmp_path)
    result = read_result(tmp_path)
    other = write_demo_page(tmp_path, result, **SHOWN).read_text()
    text = write_demo_page(tmp_path, replace(result, set="demo"), **SHOWN).read_text()
    assert text.index(verdict(result)) < text.index("<video") < text.index("<table")
    assert text.count('scope="col"') == 6, "policy and five figures"
    assert "How these drives were chosen" in text and "How these drives were chosen" not in other
    assert "families car-door are" in text and "Drive 0.1" in text

"""The page that a demo ends with."""

from dataclasses import replace

import pytest

from tests.drive.page.conftest import browser  # noqa: F401 - a fixture
from tests.drive.page.stage import IN_CHROMIUM
from tests.view.report.results import record, with_episodes, write_result
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.view.report.suite_page import write_demo_page

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(300)]


def test_no_column_is_cut_on_a_usual_screen(browser, tmp_path):  # noqa: F811 - that fixture
    write_result(tmp_path)
    records = [replace(record(0), m=12_340.0, crossings=100, goals=100, red_entries=10)] * 100
    names = ("follow", "runs/demo/learned", "oracle-visible")
    result = with_episodes(read_result(tmp_path), dict.fromkeys(names, records))
    shown = {"learned": "It learned.", "film": "a.webm", "film_says": "", "still_png": b"", "commands": ()}
    path = write_demo_page(tmp_path, result, **shown)
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.goto(path.as_uri())
    widths = page.locator(".wide").evaluate_all("(nodes) => nodes.map((node) => [node.scrollWidth, node.clientWidth])")
    assert widths and all(wide <= room for wide, room in widths)

"""The page that a demo ends with."""

from types import SimpleNamespace

import pytest

from tests.drive.page.test_page import CHROMIUM, FLAGS
from wcsim.view.report.demo_page import DemoShown, write_demo_page

NUMBERS = {
    "crashes_own": 12, "crashes_other": 10, "km": 12.34, "kpi1_mean": 0.123, "kpi1_within": 1.0,
    "kpi2_mean_steps": 1234.0, "routes_completed": 100, "crossings": 100, "red_entries": 10,
}  # fmt: skip


@pytest.mark.browser
@pytest.mark.timeout(300)
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: install Debian's package chromium")
def test_no_column_is_cut_on_a_usual_screen(tmp_path):
    from playwright.sync_api import sync_playwright

    rows = [SimpleNamespace(policy=name, **NUMBERS) for name in ("follow", "runs/demo/learned", "oracle-visible")]
    result = SimpleNamespace(town="monaco", profile="inattentive", seed=1, rows=rows)
    shown = DemoShown(learned="It learned.", results=[result], film="a.webm", film_says="", still_png=b"", commands=())
    path = write_demo_page(tmp_path, shown)
    with sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = chromium.new_page(viewport={"width": 1440, "height": 900})
        page.goto(path.as_uri())
        table = page.locator(".wide")
        wide, room = (table.evaluate(f"(node) => node.{width}Width") for width in ("scroll", "client"))
        chromium.close()
    assert wide <= room

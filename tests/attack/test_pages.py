"""Hostile names on wcsim's pages in a real browser: they are words there, no script runs, and no request leaves."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests.drive.page.conftest import browser  # noqa: F401 - a fixture
from tests.drive.page.stage import ABOUT, IN_CHROMIUM, PageAlone, Stage
from tests.drive.playing import films
from tests.support.worlds import dqn_config
from tests.view.report.results import score_anew, write_result
from wcsim.agents.evaluation.suite.result_files import read_result
from wcsim.agents.runs.metrics import COLUMNS, MetricsFile
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest
from wcsim.cli.main import main
from wcsim.drive.playing.play_runner import FailedLine, _film_about
from wcsim.server.specs import RunInfo
from wcsim.view.report.suite_page import write_demo_page

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(900)]
RAN = "window.evil=1;alert(1);fetch('http://127.0.0.1:9/evil')"
NAMES = (
    f"<script>{RAN}</script>", f'"><img src=x onerror="{RAN}">', f"</style></title></script><script>{RAN}</script>",
    f"<svg onload={RAN}>", f"javascript:{RAN}", f"'-({RAN})-'", "\u202eevil\u2066",
    "$\\mathrm{x}^{$ _ % \\frac{", "\0\x1b[31m",
    "<iframe src=http://127.0.0.1:9/>", f"<a href=javascript:{RAN} autofocus onfocus={RAN}>" + "b" * 3000,
    "<meta http-equiv=refresh content=0;url=http://127.0.0.1:9/>", "&lt;script&gt;", "]]><!--", "{{7*7}}${7*7}",
)  # fmt: skip
TEXTS = ("part", "town", "profile", "reason", "fault", "partner")


@pytest.fixture
def context(browser: Any) -> Iterator[Any]:  # noqa: F811 - that fixture
    with browser.new_context() as found:
        yield found


def shown(context: Any, path: Path) -> str:
    """What a file looks like to its reader; nothing in it ran or asked for anything."""
    page, asked, told = context.new_page(), list[str](), list[str]()
    page.on("request", lambda request: asked.append(request.url))
    page.on("dialog", lambda dialog: (told.append(dialog.message), dialog.dismiss()))
    page.on("pageerror", lambda error: told.append(str(error)))
    page.goto(path.as_uri())
    page.locator("th").first.click() if page.locator("th").count() else None  # its own script sorts
    page.wait_for_timeout(200)
    others = [url for url in asked if url != path.as_uri() and not url.startswith("data:")]
    assert (others, told, page.evaluate("window.evil")) == ([], [], None)
    assert page.locator("script").count() == 1 and page.locator("iframe, svg, meta[http-equiv=refresh]").count() == 0
    text = str(page.locator("body").text_content())
    page.close()
    return text


def hostile_result(folder: Path) -> None:
    """A finished test in which every name is one."""
    write_result(folder, suite=NAMES[0], set=NAMES[1], list_sha256=NAMES[2], changed=list(NAMES))
    episodes = json.loads((folder / "episodes.json").read_text())
    names = dict(zip(episodes, NAMES[2:], strict=False))
    for number, record in enumerate(record for each in episodes.values() for record in each):
        record.update({name: NAMES[(number + place) % len(NAMES)] for place, name in enumerate(TEXTS)})
        record["part"] = NAMES[0] if record["block"] < 2 else NAMES[1]
    (folder / "episodes.json").write_text(json.dumps({names[name]: each for name, each in episodes.items()}))
    score_anew(folder)


def test_the_report_of_a_hostile_test_shows_its_names(context: Any, tmp_path: Path) -> None:
    hostile_result(tmp_path / "<img src=x onerror=alert(1)>")
    assert main(["report", str(tmp_path / "<img src=x onerror=alert(1)>"), "--pictures", "0"]) == 0
    text = shown(context, tmp_path / "<img src=x onerror=alert(1)>" / "report.html")
    assert NAMES[2] in text and NAMES[1] in text


def test_the_report_of_a_hostile_training_shows_its_names(context: Any, tmp_path: Path) -> None:
    run, config = tmp_path / "<svg onload=alert(1)>", dqn_config()
    create_run_folder(run, config, make_run_manifest(config, RunInfo(seed=1, town=NAMES[0], rewards=NAMES[1:3])))
    metrics = MetricsFile(run / "metrics.csv")
    for step, name in enumerate(NAMES, 1):
        row = {"step": 10 * step, "phase": 1, "length": 10, "kpi1": 0.5, "crash_reason": name.replace("\0", "")}
        metrics.add({**dict.fromkeys(COLUMNS, 0), **row})
    assert main(["report", str(run)]) == 0
    assert run.name in shown(context, run / "report.html")


def test_the_page_of_a_hostile_demo_shows_its_names(context: Any, tmp_path: Path) -> None:
    hostile_result(tmp_path)
    said = {"learned": NAMES[0], "film_webm": b"", "film_says": NAMES[1], "key": (0, 0), "trained": [NAMES[1]]}
    page = write_demo_page(tmp_path, read_result(tmp_path), **said, commands=[(NAMES[2], NAMES[3])])
    assert NAMES[2] in shown(context, page)


@pytest.mark.parametrize("name", ["index.html", "play.html"])
def test_a_drive_and_a_film_of_hostile_names_show_them(context: Any, name: str) -> None:
    asked: list[str] = []
    context.on("request", lambda request: asked.append(request.url))
    drives = name == "index.html"
    page = Stage(context) if drives else PageAlone(context, name)
    page.page.on("dialog", lambda dialog: page.errors.append(dialog.message))
    for evil in NAMES:
        if drives:
            words = {key: evil for key in ("place", "town", "policy", "profile")}
            suites = {evil: [(evil, 1)]}
            page.hear("about", **{**ABOUT, **words, "towns": [evil], "profiles": [evil], "suites": suites})
        else:
            line = FailedLine(policy=evil, block=0, seat=0, told=evil)
            about = msgspec.structs.replace(films.ABOUT, title=evil, town=evil)
            page.hear("about", **_film_about(about, (line,), evil, 0))
        page.page.wait_for_timeout(20)
    assert (page.errors, page.page.evaluate("window.evil")) == ([], None)
    assert page.page.locator("iframe, svg[onload], img[onerror], a[autofocus]").count() == 0
    assert all(url.startswith("http://127.0.0.1:9/") and "evil" not in url for url in asked)

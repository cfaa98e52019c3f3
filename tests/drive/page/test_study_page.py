"""The pages of a study in Chromium: by keyboard, by one switch, and as axe sees them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.drive.page.stage import IN_CHROMIUM, axe_finds_nothing
from tests.drive.page.test_page import go_to_page, patient, wait
from tests.drive.recording.studies import write_study
from tests.drive.serving.served import served
from tests.drive.serving.test_served_study import SHORT

pytestmark = [*IN_CHROMIUM, pytest.mark.proof, pytest.mark.timeout(1800)]
GO = "document.getElementById('study-go')"


@pytest.fixture
def page(browser: Any, corner: Path, tmp_path: Path) -> Iterator[Any]:
    words = ("--study", str(write_study(tmp_path, corner, SHORT)), "--participant", "1", "--out", str(tmp_path / "out"))
    with served(None, *words) as (address, _), patient(browser, viewport={"width": 1280, "height": 800}) as context:
        yield go_to_page(context, address)


def until_button(page: Any, text: str) -> None:
    wait(page, f"document.getElementById('study').open && {GO}.textContent === '{text}'")
    wait(page, f"{GO}.getAttribute('aria-disabled') === 'false'")


def test_a_study_by_keyboard_and_one_switch(page: Any, tmp_path: Path) -> None:
    until_button(page, "Continue")
    axe_finds_nothing(page)
    page.focus("#study-go")
    page.keyboard.press("Enter")
    until_button(page, "Start driving")
    page.focus("#study-go")
    page.keyboard.press("Enter")
    wait(page, "!document.getElementById('study').open")
    assert page.inner_text("#study-part") == "Part 1 of 1: Alone"
    assert page.locator("#assist").is_hidden() and page.locator("#pause").is_visible()
    page.keyboard.down("ArrowUp")
    until_button(page, "Save and continue")
    page.keyboard.up("ArrowUp")
    axe_finds_nothing(page)
    page.focus("#study-go")
    page.keyboard.press("Enter")
    wait(page, "document.getElementById('study-trouble').textContent.includes('2 questions have no answer')")
    page.locator("input[name='question-0']").nth(0).focus()
    page.keyboard.press("ArrowRight")
    page.locator("input[name='question-1']").nth(1).focus()
    page.keyboard.press("Space")
    page.focus("#study-go")
    page.keyboard.press("Enter")
    wait(page, "document.getElementById('study-title').textContent === 'Last questions'")

    for name, value in (("scan-s", "0.4"), ("study-steer", "1")):  # the last question by one switch
        page.evaluate(
            "([name, value]) => { const field = document.getElementById(name); field.value = value; "
            "field.dispatchEvent(new Event('change')); }",
            [name, value],
        )
    _pick(page, "fieldset")
    _pick(page, "label:nth-child(2)")
    assert page.is_checked("input[name='question-0'][value='1']")
    _pick(page, "button")
    wait(page, "document.getElementById('study-title').textContent === 'This is the end'")
    axe_finds_nothing(page)
    assert page.errors == []
    table = (tmp_path / "out" / "tiny.csv").read_text().splitlines()
    assert table[1].endswith(",2,no,") and table[2].endswith(",with more")


def _pick(page: Any, what: str) -> None:
    """Press a key while this is highlighted."""
    wait(page, f"document.querySelector('#study [data-at]')?.matches('{what}')")
    page.keyboard.press("b")

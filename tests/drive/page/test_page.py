"""The page in Chromium; a busy machine may take minutes for what a quiet one does in seconds."""

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.drive.page.stage import IN_CHROMIUM, PAD, axe_finds_nothing, let_go
from tests.drive.serving.served import PATIENCE_S, served

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(1800)]
Served = tuple[str, subprocess.Popen[str]]


@contextmanager
def patient(browser: Any, **options: Any) -> Iterator[Any]:
    """A window whose pages may take long."""
    with browser.new_context(**options) as context:
        context.set_default_timeout(1000 * PATIENCE_S)
        yield context


@pytest.fixture(scope="module")
def only_page(browser: Any, running: Served) -> Iterator[Any]:
    with patient(browser, has_touch=True) as context:
        context.add_init_script(PAD)
        yield open_page(context, running[0])


@pytest.fixture
def page(only_page: Any) -> Any:
    """It is read again for each test."""
    let_go(only_page)
    only_page.set_viewport_size({"width": 1280, "height": 800})
    only_page.errors.clear()
    only_page.reload()
    only_page.wait_for_selector("body[data-pictures]")
    return only_page


def go_to_page(context: Any, address: str) -> Any:
    """A new page, whose errors are kept."""
    new = context.new_page()
    new.errors = []
    new.on("pageerror", lambda error: new.errors.append(str(error)))
    new.goto(f"http://{address}/")
    return new


def open_page(context: Any, address: str) -> Any:
    """A new page that shows pictures."""
    new = go_to_page(context, address)
    new.wait_for_selector("body[data-pictures]")
    return new


def wait(page: Any, what: str) -> None:
    """Until an expression of the page holds; by asking again, for the page's policy lets nobody send it code."""
    for _ in range(int(PATIENCE_S / 0.1)):
        if page.evaluate(what):
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"never: {what}; {page.inner_text('#stick-text')}, {page.inner_text('#big')}")


SPEED = "parseFloat(document.getElementById('kpi-speed').textContent)"


def at_rest(page: Any) -> None:
    page.bring_to_front()
    wait(page, f"{SPEED} < 0.05")


def picture_of(page: Any) -> np.ndarray:
    data = np.frombuffer(page.locator("#scene").screenshot(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR).astype(int)


def test_keys_move_the_chair_and_the_picture_and_letting_go_stops_it(page: Any) -> None:
    page.click("#new-place")
    at_rest(page)
    before = picture_of(page)
    assert before.std() > 10.0, "a street, no blank page"
    page.keyboard.down("ArrowUp")
    wait(page, f"{SPEED} > 0.5")
    wait(page, f"Number(document.body.dataset.tick) > {int(page.evaluate('document.body.dataset.tick')) + 10}")
    assert np.abs(picture_of(page) - before).mean() > 0.5
    page.keyboard.up("ArrowUp")
    at_rest(page)
    assert page.errors == []


def test_assistance_help_and_overruling_are_on_the_page(page: Any) -> None:
    page.focus("#scene")
    helps = int(page.inner_text("#kpi-helps"))
    page.keyboard.press("h")
    wait(page, f"document.getElementById('kpi-helps').textContent === '{helps + 1}'")
    wait(page, "document.querySelector('#lamp-assist span').textContent.startsWith('helps for ')")
    wait(page, "document.getElementById('level-text').textContent === 'acts early: 2.00'")
    assert "For 10 s the policy assists the most." in page.inner_text("#notice")
    page.keyboard.down("o")
    wait(page, "document.querySelector('#lamp-assist span').textContent === 'overruled'")
    page.keyboard.up("o")
    wait(page, "document.querySelector('#lamp-assist span').textContent === 'on'")
    wait(page, "document.getElementById('level-text').textContent === 'medium: 1.00'")
    page.keyboard.press("e")
    wait(page, "document.querySelector('#lamp-assist span').textContent === 'off'")
    page.keyboard.press("e")
    wait(page, "document.getElementById('assist').getAttribute('aria-checked') === 'true'")
    page.evaluate("{const l = document.getElementById('level'); l.value = 100; l.dispatchEvent(new Event('input'))}")
    wait(page, "document.getElementById('level-text').textContent === 'acts early: 2.00'")


@pytest.mark.proof
@pytest.mark.parametrize("dress", ["", "#contrast", "#larger"])
def test_axe_finds_nothing(page: Any, dress: str) -> None:
    page.click("#open-display")
    if dress:
        page.check(dress)
    page.keyboard.press("Escape")
    for switches in ("stick", "1"):
        page.select_option("#steer-by", switches)
        axe_finds_nothing(page)


WORDS_OUTSIDE = """[...document.querySelectorAll(".lamp strong, .lamp span")].filter((word) => {
  const lamp = word.closest(".lamp").getBoundingClientRect(), text = document.createRange();
  text.selectNodeContents(word);
  const box = text.getBoundingClientRect();
  return box.left < lamp.left || box.right > lamp.right;
}).map((word) => word.textContent)"""


@pytest.mark.proof
def test_words_of_lamps_stay_inside_them(page: Any) -> None:
    for width in (390, 820, 1024, 1280, 1440):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate(WORDS_OUTSIDE) == [], width
        assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.proof
@pytest.mark.parametrize("height", [844, 664])
def test_nothing_runs_over_the_edge_of_a_telephone(page: Any, height: int) -> None:
    page.set_viewport_size({"width": 390, "height": height})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    stop = page.locator("#stop").bounding_box()
    disc = page.locator("#stick svg").bounding_box()
    assert disc["y"] + disc["height"] <= page.locator(".big-row").bounding_box()["y"], "STOP covers nothing of the disc"
    assert stop["y"] >= 0 and stop["y"] + stop["height"] <= height, "STOP is always in sight"


@pytest.mark.proof
def test_a_lost_server_is_told_of(browser: Any, corner: Path) -> None:
    with served(corner) as (address, process), patient(browser) as context:
        page = open_page(context, address)
        process.send_signal(signal.SIGINT)
        process.wait(120)
        wait(page, "document.getElementById('line').dataset.kind === 'bad'")
        assert "Connection lost" in page.inner_text("#big")


@pytest.mark.proof
def test_an_obstacle_lights_the_lamps(browser: Any) -> None:
    """A drop beside the chair: driven at it, `dwa` warns, steers otherwise and marks positions, whenever one pushes."""
    from wcsim.agents.opening.list_file import open_suite

    blocks = open_suite("dev2").file.blocks
    index = next(number for number, block in enumerate(blocks) if block.town == "turning-beside-drop-near")
    with served(None, "--suite", "dev2", "--block", str(index)) as (address, _), patient(browser) as context:
        page = open_page(context, address)
        page.keyboard.down("ArrowUp")
        wait(page, "document.getElementById('lamp-intervening').dataset.on === 'true'")
        wait(page, "document.querySelectorAll('#stick path.cross').length > 0")
        wait(page, "Number(document.getElementById('kpi-warnings').textContent) > 0")


@pytest.mark.proof
def test_one_switch_reaches_a_destination(page: Any) -> None:
    """Any key picks what is highlighted, any key stops; steered by what the page says of the way, no other key."""
    page.select_option("#steer-by", "1")
    page.fill("#scan-s", "0.8")
    page.dispatch_event("#scan-s", "change")
    page.focus("#steering")
    arrivals = int(page.inner_text("#kpi-arrivals"))
    for _ in range(400):
        if int(page.inner_text("#kpi-arrivals")) > arrivals:
            return
        _pick(page, _choice(page))
        _until_wrong(page)
        page.keyboard.press("b")
    raise AssertionError(f"no arrival; {page.inner_text('#kpi-left')} to go")


def _turn_deg(page: Any) -> float:
    """How far to the left the way's arrow shows."""
    turned = page.evaluate("document.getElementById('way-arrow').getAttribute('transform')")
    return -float(turned.removeprefix("rotate(").split()[0])


def _choice(page: Any) -> str:
    turn_deg = _turn_deg(page)
    if abs(turn_deg) > 35.0:
        return "Turn left" if turn_deg > 0 else "Turn right"
    if abs(turn_deg) > 12.0:
        return "Ahead left" if turn_deg > 0 else "Ahead right"
    return "Slowly ahead"


def _pick(page: Any, name: str) -> None:
    for _ in range(4000):
        here = page.evaluate("document.querySelector('#board [data-at]')?.textContent")
        if here == name:
            page.keyboard.press("b")
            if page.evaluate("document.querySelector('#board [data-at=drives]')?.textContent") == name:
                return
            page.keyboard.press("b")
        page.wait_for_timeout(10)
    raise AssertionError(json.dumps(name))


def _until_wrong(page: Any) -> None:
    """Let the chair go till another choice would be better, or the page has stopped it."""
    chosen = _choice(page)
    for _ in range(150):
        page.wait_for_timeout(100)
        drives = page.evaluate("document.querySelector('#board [data-at=drives]') !== null")
        if not drives or _choice(page) != chosen:
            return

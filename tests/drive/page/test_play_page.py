"""The page of a film in Chromium: a journal in `make test`, a run that is watched in `make proof`."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.drive.page.stage import IN_CHROMIUM, axe_finds_nothing
from tests.drive.page.test_page import open_page, patient, picture_of, wait
from tests.drive.serving.served import PATIENCE_S, serving
from wcsim.log.reader import hash_log

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(1800)]
AT = "Number(document.body.dataset.at)"
COUNT = "Number(document.body.dataset.count)"


@contextmanager
def paged(browser: Any, address: str) -> Iterator[Any]:
    with patient(browser, viewport={"width": 1440, "height": 900}) as context:
        yield open_page(context, address)


def test_a_journal_is_played_jumped_in_and_looked_through(browser: Any, run: Path) -> None:
    with serving("log", "play", str(run)) as (address, _), paged(browser, address) as page:
        wait(page, f"{COUNT} === 150 && document.getElementById('told').textContent.includes('whole journal')")
        page.keyboard.press("Home")
        wait(page, f"{AT} < 140")
        page.uncheck("#lead")
        page.check("#all")
        page.click("#back-intervention") if page.evaluate(AT) > 80 else page.click("#on-intervention")
        wait(page, "document.getElementById('play').textContent === 'Pause' || document.body.dataset.at > 0")
        page.select_option("#pace", "8")
        wait(page, f"{AT} === 149 && document.getElementById('play').textContent === 'Play'")
        before = picture_of(page)
        assert before.std() > 10.0, "a street, no blank page"
        page.evaluate("{const at = document.getElementById('at'); at.value = 60; at.dispatchEvent(new Event('input'))}")
        wait(page, f"{AT} === 60")
        page.keyboard.press("ArrowRight")
        wait(page, f"{AT} === 61")
        page.keyboard.press("Shift+ArrowLeft")
        wait(page, f"{AT} === 51")
        page.click("#chairs button[data-seat='0']")
        wait(page, "document.querySelector('#chairs button[data-seat=\"0\"]').getAttribute('aria-pressed') === 'true'")
        kpi1 = page.inner_text("#kpi-kpi1")
        page.keyboard.press("End")
        wait(page, f"{AT} === 149")
        page.evaluate("{const at = document.getElementById('at'); at.value = 51; at.dispatchEvent(new Event('input'))}")
        wait(page, f"{AT} === 51")
        assert page.inner_text("#kpi-kpi1") == kpi1
        axe_finds_nothing(page)
        page.set_viewport_size({"width": 390, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.errors == []


LEARN = (
    *("patch,fig6", "--steps", "300", "--seed", "1", "--set", "learn.batch_size=8"),
    *("--set", "learn.episode_steps=60", "--set", "world.epoch_ticks=150", "--set", "learn.learning_starts=50"),
)


def trained(corner: Path, out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "wcsim", "train-clients", "--town", str(corner), "--out", str(out), *LEARN]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True)


@pytest.mark.proof
def test_a_watched_run_is_the_run_that_nobody_watched(browser: Any, corner: Path, tmp_path: Path) -> None:
    """The same journal and weights to the bit; the page shows all of it, through the change of its world."""
    alone, watched = tmp_path / "alone", tmp_path / "watched"
    assert trained(corner, alone).wait(4 * PATIENCE_S) == 0
    watched.mkdir()
    process = trained(corner, watched)
    try:
        while not (watched / "journal").exists():
            assert process.poll() is None
            time.sleep(0.2)
        with serving("watch", str(watched)) as (address, _), paged(browser, address) as page:
            wait(page, f"{COUNT} > 20")
            wait(page, "document.querySelectorAll('#chairs button').length === 2")
            page.click("#back")
            wait(page, "document.getElementById('live').getAttribute('aria-pressed') === 'false'")
            page.click("#live")
            wait(page, "document.getElementById('clock').textContent.includes('world 1')")
            assert process.wait(4 * PATIENCE_S) == 0
            wait(page, "document.getElementById('told').textContent.startsWith('The run has ended')")
            axe_finds_nothing(page)
            assert page.errors == []
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            process.wait(PATIENCE_S)
    assert hash_log(watched / "journal") == hash_log(alone / "journal")
    for name in ("patch", "fig6"):
        weights = [next((run / name / "policies" / "final").glob("*.safetensors")) for run in (alone, watched)]
        assert weights[0].read_bytes() == weights[1].read_bytes()

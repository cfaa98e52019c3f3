"""A browser for the pages of a module, and the page of a drive without any drive."""

import os
from collections.abc import Iterator
from typing import Any

import pytest

from tests.drive.page.stage import CHROMIUM, FLAGS, Stage


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        # Its own socket lies in the folder for temporary files, in a path that may be too long for one.
        here = {**os.environ, "TMPDIR": "/tmp"}  # noqa: S108
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS, env=here)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def only_stage(browser: Any) -> Iterator[Stage]:
    """One for all tests of a module: to read a page anew costs a quarter of what another one costs."""
    with browser.new_context(viewport={"width": 1280, "height": 800}, has_touch=True) as context:
        yield Stage(context)


@pytest.fixture
def stage(only_stage: Stage) -> Iterator[Stage]:
    only_stage.anew()
    yield only_stage
    assert only_stage.errors == []

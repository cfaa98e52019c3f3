"""The lamps of a film's page in Chromium, without any film."""

from __future__ import annotations

from typing import Any

import pytest

from tests.drive.page.stage import PageAlone
from tests.drive.page.test_page import CHROMIUM
from tests.drive.playing.films import ABOUT, film_of
from wcsim.drive.playing.film_states import FilmAbout
from wcsim.drive.playing.play_runner import Player, film_about, film_state

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(900),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: install Debian's package chromium"),
]
DECIDES = (
    ("", "policy"),
    ("unaided", "user, not assisted"),
    ("unaided alone", "user alone"),
    ("overruled", "user overrules"),
)
JOURNAL = FilmAbout(title="a journal", town="nowhere", tick_s=0.1, actions="square81")


def test_the_lamp_says_who_decides_where_that_is_known(browser: Any) -> None:
    context = browser.new_context()
    page = PageAlone(context, "play.html")
    for about, told in ((ABOUT, DECIDES), (JOURNAL, [("", "not known")])):
        page.hear("about", **film_about(about, (), "", -1))
        for happened, words in told:
            page.hear("state", **film_state(film_of(1, {0: happened}), Player(), 0, {0: "ann"}, ("", "", True)))
            page.until(lambda words=words: page.text("#lamp-who span") == words)
    assert page.errors == []
    context.close()

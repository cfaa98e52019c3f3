"""What the pages say, in Chromium, without any drive or film."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.drive.page.stage import ABOUT, KPIS, PageAlone, Stage
from tests.drive.page.test_page import CHROMIUM
from tests.drive.playing.films import ABOUT as FILM
from tests.drive.playing.films import chair, frame
from wcsim.drive.playing.play_runner import Player, film_about, film_state
from wcsim.drive.playing.tick_film import TickFilm

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(900),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: install Debian's package chromium"),
]
BUSY = "Opening the street ..."


@pytest.fixture
def film(browser: Any) -> Iterator[PageAlone]:
    """The page of a film, on a phone."""
    context = browser.new_context(viewport={"width": 390, "height": 844})
    page = PageAlone(context, "play.html")
    yield page
    assert page.errors == []
    context.close()


def test_the_hint_goes_when_the_chair_drives_or_is_in_danger(stage: Stage) -> None:
    hint = stage.page.locator("#hint")
    for changes in ({"speed_mps": 0.3}, {"warning": True}, {"intervening": True}):
        stage.state()
        assert hint.is_visible() and "follow the green dots" in hint.inner_text()
        stage.state(**changes)
        assert not hint.is_visible()
    stage.state(bearing_deg=180.0, speed_mps=0.3)
    assert "behind you" in hint.inner_text(), "who turns is still told to"
    stage.state(kpis=KPIS | {"way_m": 1.5})
    assert not hint.is_visible()


def test_what_the_assistance_did_is_not_told_while_it_is_overruled(stage: Stage) -> None:
    stage.state(intervening=True, stick=(0.0, 1.0), commanded=(0.0, 0.5))
    assert stage.text("#did") == "Assistance: slowed …"
    stage.state(overruled=True, stick=(0.0, 1.0), commanded=(0.0, 1.0))
    assert stage.text("#did") == ""
    stage.state()
    assert stage.text("#did") == ""


def test_a_lamp_says_that_the_chair_is_on_the_road(stage: Stage) -> None:
    assert stage.text("#lamp-road span") == "you are not on it"
    stage.state(on_road=True)
    assert stage.text("#lamp-road span") == "you are on the road"
    assert stage.text("#live") == "You are on the road."
    assert stage.page.get_attribute("#lamp-road", "data-on") == "true"


def test_the_place_has_the_seed_of_the_street(stage: Stage) -> None:
    assert stage.page.input_value("#seed") == str(ABOUT["seed"]) == "21"


def test_a_notice_of_a_film_does_not_lie_on_its_crash(film: PageAlone) -> None:
    made = TickFilm(FILM)
    for at in range(3):
        made.add(frame(at, chair(0, at, "crashed" * (at == 1), reason="hit a scooter" * (at == 1))))
    player = Player()
    player.seek(2, range(3))
    film.hear("about", **film_about(FILM, (), "", -1))
    film.hear("marks", marks=made.there)
    film.hear("state", **film_state(made, player, 0, {0: "ann"}, ("", "", False)))
    film.until(lambda: film.text("#big") == "The chair hit a scooter.")
    film.page.click("#on-crash")
    film.until(lambda: film.text("#notice") == "This is the last crash.")
    big, notice = (film.page.locator(name).bounding_box() for name in ("#big", "#notice"))
    assert big["y"] + big["height"] < notice["y"]
    assert "1 crash" in film.text("#legend") and film.text("#chairs .more").endswith("· 1 crash")


def test_both_pages_count_the_seconds_that_a_street_takes(stage: Stage, film: PageAlone) -> None:
    for page in (stage, film):
        page.hear("busy", told=BUSY, waits=True)
        page.until(lambda page=page: re.fullmatch(re.escape(BUSY) + r" \(\d+ s\)", page.text("#big")))
    film.hear("busy", told="The town is gone.", waits=False)
    film.until(lambda: film.text("#big") == "The town is gone.")
    film.page.wait_for_timeout(1200)
    assert film.text("#big") == "The town is gone."

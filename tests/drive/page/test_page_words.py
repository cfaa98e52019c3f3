"""What the pages say, in Chromium, without any drive or film."""

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.drive.page.stage import ABOUT, IN_CHROMIUM, KPIS, PageAlone, Stage
from tests.drive.playing.films import ABOUT as FILM
from tests.drive.playing.films import chair, film_of, frame
from wcsim.drive.messages import DriveBy, of_page
from wcsim.drive.playing.film_states import FilmAbout
from wcsim.drive.playing.play_runner import _film_about, _film_state, _Player
from wcsim.drive.playing.tick_film import TickFilm

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(900)]
BUSY = "Opening the street ..."
DECIDES = (
    ("", "policy"),
    ("unaided", "user, not assisted"),
    ("unaided alone", "user alone"),
    ("overruled", "user overrules"),
)
JOURNAL = FilmAbout(title="a journal", town="nowhere", tick_s=0.1, actions="square81")


@pytest.fixture(scope="module")
def film(browser: Any) -> Iterator[PageAlone]:
    """The page of a film, on a phone; each test reads it anew."""
    with browser.new_context(viewport={"width": 390, "height": 844}) as context:
        page = PageAlone(context, "play.html")
        yield page
        assert page.errors == []


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


def test_the_hint_is_said_once_at_each_new_place(stage: Stage) -> None:
    stage.until(lambda: stage.text("#live") == "")  # a new page says it too
    stage.page.click("#new-place")
    stage.state()
    assert stage.text("#live") == stage.text("#hint") and stage.text("#hint").endswith("follow the green dots.")
    assert stage.heard("newplace")
    stage.until(lambda: stage.text("#live") == "")


def test_the_simulated_user_is_not_called_you_and_the_level_of_what_is_off_is_off(stage: Stage) -> None:
    assert stage.page.locator("#own-level b").count() == 1 and stage.page.is_enabled("#level")
    for driver, called in (("simulated", "simulated user"), ("person", "you")):
        stage.page.select_option("#driver", driver)
        assert [of_page(json.dumps(said).encode()) for said in stage.heard("driveby")] == [DriveBy(who=driver)]
        stage.state(driver=driver)
        assert stage.text("#legend-you") == called
    for on in (False, True):
        stage.page.click("#assist")
        assert [said["on"] for said in stage.heard("assist")] == [on]
        stage.state(assisted=on)
        assert stage.page.is_enabled("#level") is on


DEEDS = (
    ([0, 1], [0, 0], "braked"),
    ([0, 1], [0, 0.5], "slowed"),
    ([0, 1], [-0.5, 0.5], "slowed, turned left"),
    ([0.5, 0.5], [0.75, 0.5], "turned right"),
    ([0, 0], [0, -0.5], "moved while your stick was at rest"),
    ([0, 0.5], [0, -0.5], "went back"),
)


def test_what_the_assistance_did_is_told_in_words(stage: Stage) -> None:
    for stick, commanded, told in DEEDS:
        script = "async ([a, b]) => (await import('/panel.js')).deed(a, b)"
        assert stage.page.evaluate(script, [stick, commanded]) == told


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
    player = _Player()
    player.seek(2, range(3))
    film.open()
    film.hear("about", **_film_about(FILM, (), "", -1))
    film.hear("marks", marks=made.there)
    film.hear("state", **_film_state(made, player, 0, {0: "ann"}, ("", "", False)))
    film.until(lambda: film.text("#big") == "The chair hit a scooter.")
    film.page.click("#on-crash")
    film.until(lambda: film.text("#notice") == "This is the last crash.")
    big, notice = (film.page.locator(name).bounding_box() for name in ("#big", "#notice"))
    assert big["y"] + big["height"] < notice["y"]
    assert "1 crash" in film.text("#legend") and film.text("#chairs .more").endswith("· 1 crash")


def test_the_lamp_says_who_decides_where_that_is_known(film: PageAlone) -> None:
    film.open()
    for about, told in ((FILM, DECIDES), (JOURNAL, [("", "not known")])):
        film.hear("about", **_film_about(about, (), "", -1))
        for happened, words in told:
            film.hear("state", **_film_state(film_of(1, {0: happened}), _Player(), 0, {0: "ann"}, ("", "", True)))
            film.until(lambda words=words: film.text("#lamp-who span") == words)


def test_both_pages_count_the_seconds_that_a_street_takes(stage: Stage, film: PageAlone) -> None:
    film.open()
    for page in (stage, film):
        page.hear("busy", told=BUSY, waits=True)
        page.until(lambda page=page: re.fullmatch(re.escape(BUSY) + r" \(\d+ s\)", page.text("#big")))
    film.hear("busy", told="The town is gone.", waits=False)
    film.until(lambda: film.text("#big") == "The town is gone.")
    film.page.wait_for_timeout(1200)
    assert film.text("#big") == "The town is gone."

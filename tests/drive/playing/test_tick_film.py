import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.drive.playing.films import ABOUT, chair, film_of, frame
from wcsim.drive.messages import spoken
from wcsim.drive.playing.play_runner import CRASH_TICKS, _film_state, _Player
from wcsim.drive.playing.tick_film import MOST_MARKS, TickFilm
from wcsim.errors import ProtocolError

CRASH = "crashed"


def state(film: TickFilm, at: int, seat: int = 0) -> Any:
    """As a page gets it."""
    player = _Player()
    player.seek(at, film.span)
    told = _film_state(film, player, seat, {0: "ann", 1: "ben"}, ("reading", "", True))
    return json.loads(spoken("state", told), object_hook=lambda fields: SimpleNamespace(**fields))


def test_any_frame_is_there_at_once_whatever_was_looked_at_before() -> None:
    film = film_of(700, {})
    for at in (699, 0, 350, 128, 127, 640, 3, 699):
        moment = film.moment(at, 1, jumped=False)
        assert moment is not None
        assert moment.chair.p_WB_m.tolist() == [at, 2.0, 0.0]
        (car,) = moment.actors
        assert (car.id, car.p_W_m.tolist(), car.v_W_mps.tolist()) == ("car", [at, -5.0, 0.0], [10.0, 0.0, 0.0])
        assert moment.signals[0].colours == "Gr"
    assert film.moment(5, 7, jumped=False) is None
    for at in (-1, 700):
        with pytest.raises(ProtocolError, match="no step"):
            film.shot(at)


def test_a_way_is_kept_with_its_length() -> None:
    route = film_of(2, {}).shot(0).frame.route(0)
    assert route is not None
    assert route.arc_m.tolist() == [0.0, 5.0, 11.0]
    assert film_of(1, {}).shot(0).frame.route(7) is None


def test_numbers_up_to_here_are_exact_after_any_jump() -> None:
    """As they were when this frame was the newest."""
    flags = {
        10: "warning", 11: "warning intervening", 12: "intervening", 40: "crashed dropped",
        200: "arrived", 300: CRASH, 301: "intervening", 420: "helped",
    }  # fmt: skip
    whole = film_of(450, flags)
    for at in (449, 12, 300, 40, 39):
        assert state(whole, at).chairs == state(film_of(at + 1, flags), at).chairs
    kpis = state(whole, 449).chairs[0].kpis
    assert (kpis.ticks, kpis.crashes, kpis.drops, kpis.arrivals, kpis.helps) == (450, 2, 1, 1, 1)
    assert (kpis.warnings, kpis.interventions) == (1, 2)
    assert kpis.kpi1 == pytest.approx(0.25)
    assert kpis.kpi2 == pytest.approx((41 + 301) / 2)
    assert kpis.way_m == pytest.approx(450 * 0.05)
    assert state(whole, 39).chairs[0].kpis.crashes == 0


def test_what_is_not_known_counts_for_nothing() -> None:
    film = TickFilm(ABOUT)
    film.add(frame(0, chair(0, 0, stick=None)))
    film.add(frame(1, chair(0, 1)))
    first, second = (state(film, at).chairs[0].kpis for at in (0, 1))
    assert (first.ticks, first.kpi1, second.kpi1) == (1, None, 0.25)


def test_what_was_driven_before_a_handover_is_not_judged() -> None:
    film = TickFilm(ABOUT)
    for alone, ticks in ((3, 8), (2, 4), (5, 5)):
        for at in range(ticks):
            happened = "alone" * (at < alone) + " truncated" * (at == ticks - 1)
            far = (0.0, 0.0) if at < alone else (0.0, 0.75)
            film.add(frame(film.count, chair(0, at, happened, commanded=far)))
    kpis = state(film, film.count - 1).chairs[0].kpis
    assert (kpis.kpi1, kpis.ticks) == (0.25, 17)
    assert kpis.kpi2 == pytest.approx((5 + 2) / 2), "an episode that ended before its handover is none"
    assert state(film, 9).chairs[0].chair.alone and state(film, 5).chairs[0].kpis.kpi2 == 3.0


def test_all_that_begins_in_one_tick_is_marked() -> None:
    both = "warning intervening"
    film = film_of(9, {3: f"{both} arrived helped", 4: both, 6: "intervening", 7: both})
    told = [(mark.at, mark.kind) for mark in film.marks]
    first = [(3, kind) for kind in ("arrival", "help", "warning", "intervention")]
    assert told == [*first, (6, "intervention"), (7, "warning")]
    kpis = state(film, 8).chairs[0].kpis
    assert (kpis.warnings, kpis.interventions) == (2, 2), "as many as there are marks"


def test_marks_are_where_something_begins() -> None:
    flags = {5: "warning", 6: "warning", 9: CRASH, 20: "crashed dropped", 30: "arrived"}
    film = film_of(40, flags)
    film.mark("gap", "a fresh world")
    told = [(mark.at, mark.seat, mark.kind) for mark in film.marks]
    assert told == [(5, 0, "warning"), (9, 0, "crash"), (20, 0, "drop"), (30, 0, "arrival"), (40, -1, "gap")]
    assert state(film, 9 + CRASH_TICKS - 1).crash == ""
    crashed = TickFilm(ABOUT)
    crashed.add(frame(0, chair(0, 0, CRASH, reason="hit a car")))
    assert state(crashed, 0).crash == "hit a car"


def test_a_crash_is_told_for_a_while_and_of_its_own_chair_alone() -> None:
    film = TickFilm(ABOUT)
    for at in range(60):
        film.add(frame(at, chair(0, at, CRASH if at == 20 else "", reason="hit a tram"), chair(1, at)))
    assert [bool(state(film, at).crash) for at in (19, 20, 20 + CRASH_TICKS - 1, 20 + CRASH_TICKS)] == [0, 1, 1, 0]
    assert state(film, 20, seat=1).crash == ""


def test_memory_is_bounded_and_the_oldest_go_first() -> None:
    film = film_of(2000, {}, most_bytes=20_000)
    assert film.packed_bytes <= 20_000
    assert 0 < film.first < film.count == 2000
    assert film.shot(film.first).frame.tick == film.first + 1
    with pytest.raises(ProtocolError, match=f"expected {film.first} to 1999"):
        film.shot(film.first - 1)
    assert state(film, 0).at == film.first
    assert state(film, 1999).chairs[0].kpis.ticks == 2000, "what was let go of still counts"


def test_marks_are_bounded_too() -> None:
    film = film_of(1, {})
    for _ in range(MOST_MARKS + 10):
        film.mark("gap", "again")
    assert len(film.there) == MOST_MARKS


def test_a_chair_that_is_not_in_the_street_is_told_of() -> None:
    film = TickFilm(ABOUT)
    film.add(frame(0, chair(1, 0)))
    now = state(film, 0)
    assert [(line.name, line.chair is not None) for line in now.chairs] == [("ann", False), ("ben", True)]


def test_a_picture_begins_anew_with_an_episode() -> None:
    film = film_of(3, {})
    assert [film.moment(at, 0, jumped=False).jumped for at in (0, 1)] == [True, False]
    assert np.isclose(film.moment(1, 0, jumped=False).yaw_rad, 0.0)

from wcsim.drive.stick_watch import GONE_S, LOST_S, STANDS_STILL_S, StickWatch
from wcsim.types import Joystick
from wcsim.types.chair import AT_REST

AHEAD = Joystick(0.0, 1.0)


def held() -> StickWatch:
    """A watch whose stick was at rest, and then pushed, at second 0."""
    watch = StickWatch()
    watch.hear(AT_REST, False, 0.0)
    watch.hear(AHEAD, True, 0.0)
    return watch


def test_a_stick_counts_for_half_a_second() -> None:
    watch = held()
    assert watch.wish(LOST_S - 0.01).stick == AHEAD
    late = watch.wish(LOST_S + 0.01)
    assert (late.stick, late.overrule) == (AT_REST, False)


def test_after_a_short_gap_it_goes_on_and_after_a_long_one_it_has_to_rest_first() -> None:
    watch = held()
    watch.wish(LOST_S + 0.1)
    watch.hear(AHEAD, False, LOST_S + 0.2)
    assert watch.wish(LOST_S + 0.2).stick == AHEAD
    watch.wish(LOST_S + 0.2 + GONE_S + 0.1)
    watch.hear(AHEAD, False, 5.0)
    assert (watch.wish(5.0).stick, watch.must_rest) == (AT_REST, True)
    watch.hear(AT_REST, False, 5.1)
    watch.hear(AHEAD, False, 5.2)
    assert watch.wish(5.2).stick == AHEAD


def test_nobody_drives_off_with_a_stick_that_is_pushed_from_the_start() -> None:
    watch = StickWatch()
    watch.hear(AHEAD, False, 0.0)
    assert watch.wish(0.0).stick == AT_REST
    begun = held()
    begun.require_rest()
    assert begun.wish(0.1).stick == AT_REST


def test_a_page_that_goes_lets_go_at_once_and_time_stops_later() -> None:
    watch = held()
    assert not watch.stands_still(STANDS_STILL_S - 0.1)
    watch.let_go()
    assert watch.wish(0.0).stick == AT_REST
    assert watch.stands_still(0.0)


def test_a_button_that_was_pressed_between_two_ticks_counts_for_one() -> None:
    watch = StickWatch()
    for overrule in (False, True, False):
        watch.hear(AT_REST, overrule, 0.0)
    assert [watch.wish(0.1).overrule, watch.wish(0.1).overrule] == [True, False]
    watch.hear(AT_REST, True, 0.1)
    watch.hear(AT_REST, False, 0.1)
    watch.require_rest()
    assert not watch.wish(0.2).overrule, "not in the next episode"
    watch.hear(AT_REST, True, 0.2)
    watch.hear(AT_REST, False, 0.2)
    watch.forget_press()
    assert not watch.wish(0.2).overrule, "it was pressed while time stood still"
    watch.hear(AT_REST, True, 0.2)
    watch.forget_press()
    assert watch.wish(0.2).overrule, "it is held"


def test_a_long_loss_that_no_tick_saw_counts_too() -> None:
    watch = held()
    watch.hear(AHEAD, False, GONE_S + 0.1)  # time stood still meanwhile, and nobody asked for a wish
    assert (watch.wish(GONE_S + 0.2).stick, watch.must_rest) == (AT_REST, True)
    watch.hear(AT_REST, False, GONE_S + 0.3)
    watch.hear(AHEAD, False, GONE_S + 0.4)
    assert watch.wish(GONE_S + 0.4).stick == AHEAD

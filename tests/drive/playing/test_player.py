import pytest

from wcsim.drive.playing.play_runner import FASTEST, SLOWEST, _Player

SPAN = range(1000)


class Clocked:
    """A player, and a clock that goes on in uneven bits."""

    def __init__(self, **words: bool) -> None:
        self.player, self._now_s = _Player(**words), 100.0
        self.player.advance(self._now_s, SPAN, 0.1)

    def run(self, seconds: float, span: range = SPAN) -> int:
        end_s = self._now_s + seconds
        while self._now_s < end_s - 1e-9:
            self._now_s = min(end_s, self._now_s + 0.037)
            self.player.advance(self._now_s, span, 0.1)
        return self.player.at


@pytest.mark.parametrize("pace, ticks", [(0.25, 10), (0.5, 20), (1.0, 40), (8.0, 320)])
def test_time_goes_as_fast_as_was_said(pace: float, ticks: int) -> None:
    clocked = Clocked()
    clocked.player.set_pace(pace)
    assert clocked.run(4.0) == ticks


def test_a_pause_owes_nothing_and_a_late_turn_is_not_made_up_for() -> None:
    clocked = Clocked()
    player = clocked.player
    clocked.run(1.0)
    player.pause(True)
    assert clocked.run(5.0) == 10
    player.pause(False)
    player.advance(900.0, SPAN, 0.1)
    assert player.at <= 15
    player.set_pace(99.0)
    assert player.pace == FASTEST
    player.set_pace(0.0)
    assert player.pace == SLOWEST


def test_it_stays_within_what_is_there() -> None:
    clocked = Clocked()
    player = clocked.player
    assert not player.advance(0.0, range(0), 0.1)
    assert clocked.run(5.0, range(20)) == 19
    player.seek(400, SPAN)
    assert (player.at, player.jumped) == (400, True)
    player.seek(4000, SPAN)
    assert player.at == 999
    player.step(-3, SPAN)
    assert (player.at, player.paused) == (996, True)
    player.advance(500.0, range(998, 1000), 0.1)
    assert player.at == 998, "what was let go of is not shown"


def test_live_is_the_newest_until_somebody_goes_elsewhere() -> None:
    clocked = Clocked(live=True)
    player = clocked.player
    assert clocked.run(0.5, range(70)) == 69
    assert clocked.run(0.5, range(75)) == 74
    player.seek(10, SPAN)
    assert not player.live
    assert clocked.run(0.5) == 15
    player.go_live()
    assert clocked.run(0.1) == 999
    player.pause(True)
    assert not player.live

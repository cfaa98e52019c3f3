"""What a stage says of itself, and how long it still takes."""

from functools import partial

import pytest
from rich.console import Console

from wcsim.cli.shared.consoles import StageBar, _time_left


def test_the_time_that_is_left_is_what_the_share_says():
    assert _time_left(60.0, 0.5) == "about 60 s left"
    assert _time_left(61.0, 0.5) == "about 65 s left"
    assert _time_left(60.0, 0.25) == "about 3 min left"
    assert _time_left(60.0, 0.0) == _time_left(60.0, 1.0) == ""


def test_what_was_done_before_takes_no_time_now(capsys):
    now_s = [0.0]
    with StageBar("testing", clock=lambda: now_s[0]) as bar:
        bar.show(0.5, "half of it was done by another run")
        now_s[0] = 30.0
        bar.show(0.75, "as much is left as was done here")
        assert bar.left == "about 30 s left"
        bar.print_line("a line")
        bar.print_line("a word of others", left=False)
        bar.show(1.0, "")
        bar.print_line("the last")
    assert capsys.readouterr().err.splitlines() == ["a line, about 30 s left", "a word of others", "the last"]


def test_where_less_is_done_than_before_another_part_begins():
    now_s = [0.0]
    with StageBar("making", clock=lambda: now_s[0]) as bar:
        for at_s, share, left in ((0.0, 0.0, ""), (30.0, 0.5, "about 30 s left"), (50.0, 1.0, ""), (60.0, 0.25, "")):
            now_s[0] = at_s
            bar.show(share, "")
            assert bar.left == left
        now_s[0] = 80.0
        bar.show(0.625, "")
        assert bar.left == "about 20 s left"


@pytest.fixture
def told(monkeypatch, capsys):
    """What a terminal of 80 columns is told."""
    narrow = partial(Console, force_terminal=True, width=80)
    monkeypatch.setattr("wcsim.cli.shared.consoles.Console", narrow)
    return lambda: capsys.readouterr().err


def test_a_row_fits_into_80_characters(told):
    now_s = [0.0]
    with StageBar("learning", clock=lambda: now_s[0]) as bar:
        bar.show(0.0, "round 1 of 2, segment 3 of 3")
        now_s[0] = 100.0
        bar.show(0.1, "round 2 of 2, update 350")
        bar.rows({"one": "segment 0-1-2, 100 s", "two": "free"})
    told = told()
    assert "about 15 min left" in told and "update 350" in told and "segment 0-1-2, 100 s" in told
    assert "…" not in told


def test_names_beside_a_bar_are_no_markup(told):
    """A class called Robot was shown as the picture of one, and a folder in brackets not at all."""
    with StageBar("own:Robot: of [a]") as bar:
        bar.show(0.5, "own:Robot: in [b]")
        bar.print_line("own:Robot: by [c]")
    told = told()
    assert all(f"own:Robot: {where}" in told for where in ("of [a]", "in [b]", "by [c]"))

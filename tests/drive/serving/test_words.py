from __future__ import annotations

from wcsim.drive import messages as m
from wcsim.drive.serving.words import Words


def test_words_come_in_order_and_of_sticks_the_newest_alone() -> None:
    words = Words()
    for message in (m.Stick(x=0.0, y=1.0), m.Help(), m.Ready(), m.Stick(x=0.0, y=0.5), m.Help(), m.Ready()):
        words.put(message)
    assert words.take() == [m.Help(), m.Stick(x=0.0, y=0.5), m.Help(), m.Ready()]
    assert words.take() == []


def test_a_press_and_a_stick_that_was_let_go_of_are_heard_though_newer_sticks_say_otherwise() -> None:
    words = Words()
    pressed, let_go, pushed = m.Stick(x=0.0, y=1.0, overrule=True), m.Stick(x=0.0, y=0.0), m.Stick(x=0.0, y=1.0)
    for message in (pushed, pressed, pushed, let_go, m.Pause(on=False), pushed, m.Stick(x=0.0, y=0.9), pushed):
        words.put(message)
    assert words.take() == [pressed, let_go, m.Pause(on=False), pushed], "each before what was said after it"
    for number in range(4000):
        words.put(m.Stick(x=number % 7 / 10.0, y=0.0, overrule=number % 3 == 0))
    assert len(words.take()) <= 3


def test_a_drive_that_does_not_hear_costs_no_memory() -> None:
    words = Words()
    for number in range(5000):
        words.put(m.Stick(x=0.0, y=0.0))
        words.put(m.SetLevel(level=number % 100))
    assert len(words.take()) == 256

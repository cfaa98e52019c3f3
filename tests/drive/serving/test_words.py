from __future__ import annotations

from wcsim.drive import messages as m
from wcsim.drive.serving.words import Words


def test_words_come_in_order_and_of_sticks_the_newest_alone() -> None:
    words = Words()
    for message in (m.Stick(x=0.0, y=1.0), m.Help(), m.Ready(), m.Stick(x=0.0, y=0.5), m.Help(), m.Ready()):
        words.put(message)
    assert words.take() == [m.Help(), m.Stick(x=0.0, y=0.5), m.Help(), m.Ready()]
    assert words.take() == []


def test_a_drive_that_does_not_hear_costs_no_memory() -> None:
    words = Words()
    for number in range(5000):
        words.put(m.Stick(x=0.0, y=0.0))
        words.put(m.SetLevel(level=number % 100))
    assert len(words.take()) == 256

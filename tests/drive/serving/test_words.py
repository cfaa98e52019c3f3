from wcsim.drive import messages as m
from wcsim.drive.serving.server import _Words


def stick(y: float, **more: object) -> m.Stick:
    return m.Stick(**{"x": 0.0, "y": y, **more})


def test_words_come_in_order_and_of_a_kind_the_newest_alone() -> None:
    words = _Words()
    for message in (stick(1.0), m.Help(), m.Ready(), stick(0.5), m.Help(), m.Ready()):
        words.put(message)
    assert words.take() == [stick(0.5), m.Help(), m.Ready()]
    assert words.take() == []


def test_a_press_and_a_stick_that_was_let_go_of_are_heard_though_newer_sticks_say_otherwise() -> None:
    words = _Words()
    pressed, let_go, pushed = stick(1.0, overrule=True), stick(0.0), stick(1.0)
    for message in (pushed, pressed, pushed, let_go, m.Pause(on=False), pushed, stick(0.9), pushed):
        words.put(message)
    assert words.take() == [pressed, let_go, m.Pause(on=False), pushed], "each before what was said after it"
    for number in range(4000):
        words.put(stick(0.0, x=number % 7 / 10.0, overrule=number % 3 == 0))
    assert len(words.take()) <= 3


def test_a_drive_that_does_not_hear_costs_no_memory() -> None:
    words = _Words()
    for number in range(5000):
        words.put(stick(0.0))
        words.put(m.SetLevel(level=number % 100))
        words.put(m.StepBy(ticks=1))
    assert len(words.take()) == 256, "steps add up"


def test_of_many_wishes_for_a_place_the_newest_alone_is_heard_and_one_at_a_time() -> None:
    words = _Words()
    words.put(m.SetUser(profile="first"))
    assert words.take() == [m.SetUser(profile="first")]
    for number in range(1000):
        for wish in (m.NewPlace(), m.Open(seed=number), m.Again(), m.SetUser(profile=str(number))):
            words.put(wish)
    words.put(m.Pause(on=True))
    assert words.take() == [], "the first one is being done"
    for wish in (m.Open(seed=999), m.Again()):
        words.done()
        assert words.take() == [wish]
    words.done()
    assert words.take() == [m.SetUser(profile="999"), m.Pause(on=True)]
    words.done()
    words.put(m.Again())
    words.put(m.NewPlace())
    words.put(m.Open(town="here"))
    assert words.take() == [m.Open(town="here")], "a street that is opened makes void what was wanted of another"


def test_a_page_that_is_gone_leaves_nothing_to_do_behind_it_and_the_end_is_heard_at_once() -> None:
    words = _Words()
    for message in (m.Again(), m.SetUser(profile="a"), m.Ready(), stick(1.0), m.Help()):
        words.put(message)
    words.put(m.Gone())
    words.put(stick(0.5))
    assert words.take() == [m.Ready(), m.Gone(), stick(0.5)]
    words.put(m.Again())
    assert words.take() == [m.Again()]
    words.put(m.Open(town="there"))
    words.put(m.End())
    words.put(m.Gone())  # as every page goes when the server ends
    assert words.take() == [m.End(), m.Gone()]

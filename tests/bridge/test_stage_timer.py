"""Time by stage: each stage has its own time, without that of the stages inside of it."""

from itertools import count

import pytest

from wcsim.bridge.stage_timer import Stopwatch


def ticking() -> Stopwatch:
    """One whose clock goes on by a second each time that somebody looks."""
    seconds = count()
    return Stopwatch(lambda: float(next(seconds)))


def test_stages_add_up_and_the_largest_comes_first():
    watch = ticking()
    for stage in ("a", "b", "b"):
        with watch.measure(stage):
            pass
    assert watch.take() == (("b", 2.0), ("a", 1.0))
    assert watch.take() == ()


def test_what_a_stage_inside_takes_is_not_counted_twice():
    watch = ticking()
    with watch.measure("outer"):  # looks at 0 and 5
        for _ in range(2):
            with watch.measure("inner"):  # 1 to 2, 3 to 4
                pass
    assert dict(watch.take()) == {"inner": 2.0, "outer": 3.0}


def test_a_stage_that_fails_is_over():
    watch = ticking()
    with pytest.raises(KeyError), watch.measure("outer"), watch.measure("inner"):
        raise KeyError
    assert dict(watch.take()) == {"inner": 1.0, "outer": 2.0}

"""The count itself: an attack that cannot find anything is no attack."""

import time

from tests.attack.outcomes import Case, Outcome, Tally
from wcsim.errors import ConfigError


def refuse() -> bool:
    raise ConfigError("no")


def fail() -> bool:
    raise KeyError("yes")


def dawdle() -> bool:
    time.sleep(0.2)
    return True


def test_every_outcome_is_counted_and_every_defect_is_told() -> None:
    cases = [
        Case(area="a", name="1", feed=refuse),
        Case(area="a", name="2", feed=lambda: True),
        Case(area="b", name="3", feed=lambda: False),
        Case(area="b", name="4", feed=fail),
        Case(area="b", name="5", feed=dawdle, limit_s=0.01),
        Case(area="b", name="6", feed=lambda: Outcome.OUTSIDE),
        Case(area="b", name="7", feed=lambda: len(bytearray(256 << 20)) > 0, limit_bytes=32 << 20),
    ]
    tally = Tally().run(cases)
    assert {key: count for key, count in tally.counts.items()} == {
        ("a", Outcome.REFUSED): 1,
        ("a", Outcome.HARMLESS): 1,
        ("b", Outcome.WRONG): 1,
        ("b", Outcome.TRACEBACK): 1,
        ("b", Outcome.HUNG): 1,
        ("b", Outcome.OUTSIDE): 1,
        ("b", Outcome.SWOLLEN): 1,
    }
    assert tally.total == 7
    assert [line.split(": ")[2] for line in tally.defects] == ["3", "4", "5", "6", "7"]
    assert "| b | 5 | 0 | 0 | 1 | 1 | 1 | 1 | 1 |" in tally.table()

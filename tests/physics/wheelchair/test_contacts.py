import pytest

from wcsim.physics.engine import BodyTag, Role
from wcsim.physics.wheelchair.contacts import ContactLog, ContactPoint

BODY = 7


def touched(log: ContactLog, speed_mps: float) -> str:
    """Who is the cause when another wheelchair touches from ahead, coming at this speed."""
    tag = BodyTag(role=Role.CHAIR, kind="wheelchair", actor_id="w:1", v_W_mps=(-speed_mps, 0.0, 0.0))
    touch = ContactPoint(point_W_m=(1.0, 0.0, 0.3), v_chair_W_mps=(0.5, 0.0, 0.0), normal_to_chair=(-1.0, 0.0, 0.0))
    log.add(BODY, "body", 1.0, tag, touch)
    (contact,) = log.close()
    return contact.cause


def test_who_came_into_whom_is_kept_until_the_other_has_left_for_good():
    log = ContactLog(0.1)
    assert touched(log, 2.0) == "other"
    assert touched(log, 0.0) == "other"  # pushed on by who hit it before
    log.forget("w:0")
    assert touched(log, 0.0) == "other"
    log.forget("w:1")
    assert touched(log, 0.0) == "own"  # another one of the same name


@pytest.mark.parametrize("tick_s", [0.02, 0.1, 0.25, 1.0])
def test_who_came_into_whom_is_kept_for_a_second_however_long_a_tick_is(tick_s):
    for apart_s, cause in ((1.0 - tick_s, "other"), (1.0, "own")):
        log = ContactLog(tick_s)
        assert touched(log, 2.0) == "other"
        for _ in range(round(apart_s / tick_s)):
            assert log.close() == ()
        assert touched(log, 0.0) == cause

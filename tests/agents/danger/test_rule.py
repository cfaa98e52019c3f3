import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.support.samples import ACTIONS
from wcsim.agents.danger.policy import RECENT_TICKS, _choose, _mask_safe_actions, _next_recent, takes_away_at
from wcsim.config.run_file import DangerRuleSettings, StickValue

RULE = DangerRuleSettings()
STICK = np.array([0.1, 0.9])


def test_where_nothing_is_dangerous_the_user_decides():
    assert _choose(np.zeros(81), STICK, ACTIONS, RULE) == ACTIONS.nearest(STICK)


def test_the_nearest_action_that_is_safe_enough_is_taken():
    danger = np.zeros(81)
    danger[ACTIONS.points[:, 1] > 0.3] = 0.9
    x, y = ACTIONS.points[_choose(danger, STICK, ACTIONS, RULE)]
    assert (x, y) == (0.0, 0.25)


def test_where_nothing_is_safe_the_least_dangerous_is_taken():
    danger = np.full(81, 0.9)
    danger[17] = 0.8
    assert _choose(danger, STICK, ACTIONS, RULE) == 17


def test_the_last_action_is_allowed_a_little_longer():
    wish = ACTIONS.nearest(STICK)
    danger = np.zeros(81)
    danger[wish] = 1.1 * RULE.threshold
    assert _choose(danger, ACTIONS.points[wish], ACTIONS, RULE, last=wish) == wish
    assert _choose(danger, ACTIONS.points[wish], ACTIONS, RULE) != wish


def test_a_way_round_is_kept_but_never_kept_from_who_can_be_followed():
    wish = ACTIONS.nearest(STICK)
    danger = np.zeros(81)
    danger[ACTIONS.points[:, 1] > 0.3] = 0.9
    left, right = ACTIONS.nearest((-0.25, 0.25)), ACTIONS.nearest((0.25, 0.25))
    ahead = np.array([0.0, 0.9])
    assert [_choose(danger, ahead, ACTIONS, RULE, last=last) for last in (left, right)] == [left, right]
    calm = DangerRuleSettings(hysteresis=0.0)
    assert _choose(danger, ahead, ACTIONS, calm, last=left) == _choose(danger, ahead, ACTIONS, calm, last=right)
    assert _choose(np.zeros(81), STICK, ACTIONS, DangerRuleSettings(hysteresis=5.0), last=left) == wish


@given(hnp.arrays(np.float64, 81, elements=st.floats(0.0, 1.0)), st.tuples(st.floats(-1, 1), st.floats(-1, 1)))
def test_a_lower_level_is_never_more_dangerous(danger, stick):
    wish = np.array(stick)
    rules = [DangerRuleSettings(threshold=level, hysteresis=0.0, danger_cost=0.0) for level in (0.1, 0.5, 1.0)]
    chosen = [danger[_choose(danger, wish, ACTIONS, rule)] for rule in rules]
    allowed = [danger.min() < rule.threshold for rule in rules]
    for value, rule, any_is in zip(chosen, rules, allowed, strict=True):
        assert value < rule.threshold or not any_is


def test_where_sticks_have_a_value_the_highest_is_taken():
    wish = ACTIONS.nearest(STICK)
    stick = ACTIONS.points[wish]
    valued = DangerRuleSettings(value=StickValue())
    assert _choose(np.full(81, 0.3), stick, ACTIONS, valued) == wish, "no other stick is worth more"
    danger = np.zeros(81)
    danger[wish] = 0.02
    assert _choose(danger, stick, ACTIONS, valued) == wish, "another one costs more than this danger"
    danger[wish] = 0.5
    other = _choose(danger, stick, ACTIONS, valued)
    assert other != wish and np.linalg.norm(ACTIONS.points[other] - stick) <= 0.26
    danger[wish] = 0.04
    eager = DangerRuleSettings(threshold=0.02, value=StickValue())
    assert _choose(danger, stick, ACTIONS, eager) != wish == _choose(danger, stick, ACTIONS, valued)


PATIENT = DangerRuleSettings(threshold=0.02, at_once=0.6)


def taken_of(dangers: list[float], rule: DangerRuleSettings, others: float = 0.0) -> list[bool]:
    """Whether the user's own action is taken away, tick by tick, for its dangers."""
    wish, recent, found = ACTIONS.nearest(STICK), 0, []
    for level in dangers:
        danger = np.full(81, others)
        danger[wish] = level
        found.append(_choose(danger, ACTIONS.points[wish], ACTIONS, rule, recent=recent > 0) != wish)
        safe = _mask_safe_actions(danger, rule, free=-1 if recent else wish)
        recent = _next_recent(recent, not safe[wish], level, rule)
    return found


def test_a_lone_doubtful_tick_takes_nothing_away_two_in_a_row_do():
    assert taken_of([0.3, 0.0, 0.0, 0.3, 0.3, 0.3], DangerRuleSettings()) == [True, False, False, True, True, True]
    assert taken_of([0.3, 0.0, 0.3, 0.3, 0.3], PATIENT) == [False, False, False, True, True]


def test_who_drives_to_learn_has_no_patience():
    exploring = DangerRuleSettings(at_once=0.6, threshold=0.3).model_copy(update={"at_once": 0.0})
    assert taken_of([0.5], exploring) == [True]


def test_what_is_surely_dangerous_is_taken_away_at_once():
    assert taken_of([0.0, 0.6, 0.0], PATIENT) == [False, True, False]


def test_who_was_helped_a_moment_ago_is_helped_again_at_once():
    for pause in range(RECENT_TICKS):
        assert taken_of([0.9, *[0.0] * pause, 0.3], PATIENT)[-1]
    assert not taken_of([0.9, *[0.0] * RECENT_TICKS, 0.3], PATIENT)[-1]


def test_a_doubtful_tick_counts_as_one_where_nothing_is_safe_too():
    assert taken_of([0.3, 0.3], PATIENT, others=0.25) == [False, True]


def test_a_doubt_takes_nothing_away_however_long_and_whoever_was_helped_gets_the_stick_back_later():
    rule = DangerRuleSettings(threshold=0.05, at_once=0.6)
    doubt = takes_away_at(rule)
    assert 0.3 < doubt < 0.5
    assert not any(taken_of([doubt - 0.01] * 9, rule))
    assert taken_of([doubt, doubt, 0.06, 0.06, 0.0], rule) == [False, True, True, True, False]


def test_levels_are_thresholds():
    with pytest.raises(ValueError, match="frozen"):
        RULE.threshold = 0.5  # type: ignore[misc]

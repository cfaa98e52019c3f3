"""The guard of the example before a chair, whatever comes; and that of a test, which does the same with whole ticks."""

import math
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.samples import ACTIONS
from wcsim.agents.export.guard import GuardedPolicy
from wcsim.agents.policy_api import NotFinite
from wcsim.config.run_file import PolicyGuardSettings

EXAMPLE = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "exported_policy.py"), run_name="example")
RULE = PolicyGuardSettings()
SIDE = st.floats(-1.0, 1.0)
GOOD = st.tuples(st.tuples(SIDE, SIDE), st.just(True), st.just(0.0), st.just(0.0))
TICKS = st.tuples(  # wanted, finite, age and time of the answer
    st.one_of(st.none(), st.tuples(SIDE, SIDE)),
    st.booleans(),
    st.sampled_from([0.0, 0.1, 0.3, 0.30001, 5.0, math.inf, math.nan]),
    st.sampled_from([0.0, 0.002, 0.1, 0.11, math.nan]),
)
MOSTLY_GOOD = st.lists(st.one_of(GOOD, TICKS), max_size=60)
RULES = st.builds(
    PolicyGuardSettings,
    stop_s=st.sampled_from([0.05, 0.3, 0.5, 2.0]),
    good_ticks=st.integers(1, 12),
    tick_s=st.just(0.1),
)


def is_good(tick: tuple[Any, ...]) -> bool:
    wanted, finite, age_s, took_s = tick
    return wanted is not None and finite and age_s <= RULE.oldest_s and took_s <= RULE.deadline_s


def driven(rule: PolicyGuardSettings, ticks: list[tuple[Any, ...]]) -> list[tuple[tuple[float, float], bool, bool]]:
    """The stick after each tick, whether the guard has tripped, and whether the tick was good."""
    guard, states = EXAMPLE["Guard"](rule.model_dump()), [((0.0, 0.0), False, True)]
    for tick in ticks:
        sure = guard.step(*tick)
        states.append((guard.stick, guard.tripped, sure))
    return states


@given(RULES, MOSTLY_GOOD)
def test_whoever_wants_what_only_good_ticks_drive_and_a_bad_one_never_adds_throttle(rule, ticks):
    states = driven(rule, ticks)
    for tick, (before, _, _), (stick, tripped, sure) in zip(ticks, states, states[1:], strict=False):
        assert all(map(math.isfinite, stick)) and sure == is_good(tick)
        if tripped:
            assert math.hypot(*stick) <= math.hypot(*before)
        else:
            assert sure and stick == tick[0]


@given(RULES, MOSTLY_GOOD, st.lists(TICKS.filter(lambda tick: not is_good(tick)), min_size=25, max_size=25))
def test_the_stick_is_at_rest_within_the_stated_time(rule, ticks, bad):
    enough = math.ceil(rule.stop_s / rule.tick_s)
    assert driven(rule, [*ticks, *bad])[len(ticks) + enough][0] == (0.0, 0.0)


@given(RULES, MOSTLY_GOOD)
def test_it_drives_again_after_so_many_good_ticks_and_not_before(rule, ticks):
    bad, good = (None, True, 0.0, 0.0), ((0.25, 0.75), True, 0.0, 0.0)
    again = driven(rule, [*ticks, bad, *[good] * rule.good_ticks])[len(ticks) + 1 :]
    assert [tripped for _, tripped, _ in again] == [True] * rule.good_ticks + [False]
    assert again[-1][0] == (0.25, 0.75)


class Follows:
    """Follows the stick, but for one call, which fails; warns always."""

    name, warning = "follows", True

    def __init__(self, at: int, error: Exception) -> None:
        self.calls, self.resets, self.at, self.error = 0, 0, at, error

    def begin(self) -> None:
        """Nothing."""

    def reset(self) -> None:
        self.resets += 1

    def act(self, observation):
        self.calls += 1
        if self.calls == self.at:
            raise self.error
        return ACTIONS.nearest(observation["joystick"])


def test_who_gives_no_finite_answer_rests_and_forgets_no_more_than_what_was_on_the_way():
    frames, policy = {"joystick": np.array([0.0, 1.0], np.float32)}, Follows(3, NotFinite("NaN"))
    guard = GuardedPolicy(policy, ACTIONS, RULE)
    sent, warned = [], []
    for _ in range(4 + RULE.good_ticks):
        guard.act(frames)
        sent.append(guard.stick)
        warned.append(guard.warning)
    assert sent[:2] == [(0.0, 1.0)] * 2 and warned[:4] == [True, True, False, True]
    on_the_way = sum(stick != (0.0, 0.0) for stick in sent[2:-1])
    assert 0 < on_the_way < RULE.good_ticks / 2 and sent[-1] == (0.0, 1.0)
    assert policy.resets == on_the_way
    with pytest.raises(RuntimeError):  # a fault of the policy is to be seen
        GuardedPolicy(Follows(1, RuntimeError("no memory left")), ACTIONS, RULE).act(frames)


@given(st.lists(st.sampled_from([None, (0.0, 0.0), (0.25, 0.75)]), max_size=40))
def test_the_example_and_a_test_send_and_forget_alike(wishes):
    driver = EXAMPLE["Driver"].__new__(EXAMPLE["Driver"])
    driver.meaning, forgot = {"guard": RULE.model_dump(), "states": {}, "actions_xy": ACTIONS.points.tolist()}, []
    driver.clock, driver.forget = lambda: 0.0, lambda: (setattr(driver, "states", {}), forgot.append(1))
    driver.reset()
    policy = Follows(0, NotFinite())
    guard = GuardedPolicy(policy, ACTIONS, RULE)
    guard.reset()
    for wanted in wishes:
        values = np.eye(81)[None, ACTIONS.nearest(wanted)] if wanted else np.full((1, 81), np.nan)
        policy.act = lambda frames, values=values: policy_answer(values)
        driver.asked = lambda frames, values=values: {"values": values, "warning": np.ones((1, 1))}
        stick = driver.step({"joystick": np.zeros(2)}, 0.0)
        guard.act({"joystick": np.zeros(2, np.float32)})
        assert (stick, driver.warning, len(forgot)) == (guard.stick, guard.warning, policy.resets)


def policy_answer(values: np.ndarray) -> int:
    if not np.isfinite(values).all():
        raise NotFinite("NaN")
    return int(values.argmax())

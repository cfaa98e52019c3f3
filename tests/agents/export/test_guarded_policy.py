"""The guard before a chair, whatever comes; and the same in the example that needs no wcsim."""

from __future__ import annotations

import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wcsim.agents.export.guard import FAULTS, GuardedPolicy, GuardState, GuardTick, _fault_of, guarded
from wcsim.config.run_file import GuardRule
from wcsim.supervisor.actions import action_set

EXAMPLE = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "exported_policy.py"), run_name="example")
RULE = GuardRule()
SIDE = st.floats(-1.0, 1.0)
AGES = st.sampled_from([0.0, 0.1, 0.3, 0.30001, 5.0, math.inf, math.nan])
TICKS = st.builds(
    GuardTick,
    wanted=st.one_of(st.none(), st.tuples(SIDE, SIDE)),
    inputs_finite=st.booleans(),
    outputs_finite=st.booleans(),
    age_s=AGES,
    took_s=st.sampled_from([0.0, 0.002, 0.1, 0.11, math.nan]),
)
MOSTLY_GOOD = st.lists(st.one_of(st.builds(GuardTick, wanted=st.tuples(SIDE, SIDE)), TICKS), max_size=60)
RULES = st.builds(
    GuardRule, stop_s=st.sampled_from([0.05, 0.3, 0.5, 2.0]), good_ticks=st.integers(1, 12), tick_s=st.just(0.1)
)


def driven(rule: GuardRule, ticks: list[GuardTick]) -> list[GuardState]:
    states = [GuardState()]
    for tick in ticks:
        states.append(guarded(rule, states[-1], tick))
    return states


@given(RULES, MOSTLY_GOOD)
def test_whoever_wants_what_only_good_ticks_drive_and_a_bad_one_never_adds_throttle(rule, ticks):
    states = driven(rule, ticks)
    for tick, before, after in zip(ticks, states, states[1:], strict=False):
        assert all(map(math.isfinite, after.stick)) and after.fault in FAULTS
        assert after.fault == _fault_of(rule, tick)
        if after.tripped:
            assert math.hypot(*after.stick) <= math.hypot(*before.stick)
        else:
            assert after.fault == "" and after.stick == tick.wanted


@given(RULES, MOSTLY_GOOD, st.lists(TICKS.filter(lambda tick: _fault_of(RULE, tick)), min_size=25, max_size=25))
def test_the_stick_is_at_rest_within_the_stated_time(rule, ticks, bad):
    enough = math.ceil(rule.stop_s / rule.tick_s)
    assert driven(rule, [*ticks, *bad])[len(ticks) + enough].stick == (0.0, 0.0)


@given(RULES, MOSTLY_GOOD)
def test_it_drives_again_after_so_many_good_ticks_and_not_before(rule, ticks):
    bad, good = GuardTick(wanted=None), GuardTick(wanted=(0.25, 0.75))
    again = driven(rule, [*ticks, bad, *[good] * rule.good_ticks])[len(ticks) + 1 :]
    assert [state.tripped for state in again] == [True] * rule.good_ticks + [False]
    assert again[-1].stick == (0.25, 0.75)


@given(RULES, MOSTLY_GOOD)
def test_the_example_guards_alike(rule, ticks):
    told = {key: getattr(rule, key) for key in GuardRule.model_fields}
    guard = EXAMPLE["Guard"](told)
    for tick, state in zip(ticks, driven(rule, ticks)[1:], strict=True):
        sure = guard.step(tick.wanted, tick.inputs_finite and tick.outputs_finite, tick.age_s, tick.took_s)
        assert (guard.stick, guard.tripped, sure) == (state.stick, state.tripped, state.fault == "")


def test_each_fault_has_its_name():
    good = {"wanted": (0.0, 1.0)}
    found = [_fault_of(RULE, GuardTick(**{**good, **bad})) for bad in (
        {}, {"wanted": None}, {"inputs_finite": False}, {"age_s": 0.31}, {"took_s": 0.2}, {"outputs_finite": False},
    )]  # fmt: skip
    assert tuple(found) == FAULTS


class Fails:
    """Answers, but for one call, which ends in an error of a library."""

    name, warning = "fails", True

    def __init__(self, at: int) -> None:
        self.calls, self.resets, self.at = 0, 0, at

    def begin(self) -> None:
        """Nothing."""

    def reset(self) -> None:
        self.resets += 1

    def act(self, observation):
        self.calls += 1
        if self.calls == self.at:
            raise RuntimeError("the runtime has no memory left")
        return 40 + 9


def test_a_model_that_ends_in_an_error_stops_the_chair_and_drives_again_later():
    frames, actions = {"joystick": np.array([0.0, 1.0], np.float32)}, action_set("square81")
    policy = Fails(at=3)
    guard = GuardedPolicy(policy, actions, clock=lambda: 0.0)
    wanted = tuple(actions.points[49].tolist())
    told = [guard.drive(frames) for _ in range(2)]
    assert told == [wanted, wanted] and guard.warning
    told = [guard.drive(frames) for _ in range(RULE.good_ticks)]  # the bad one and those that do not count yet
    assert all(math.hypot(*stick) < math.hypot(*wanted) for stick in told) and told[-1] == (0.0, 0.0)
    assert policy.resets == RULE.good_ticks, "it wants to drive all the while, which is not sent"
    assert guard.drive(frames) == wanted
    with pytest.raises(RuntimeError):
        GuardedPolicy(Fails(at=1), actions).act(frames)


class Follows(Fails):
    """Follows the stick."""

    def act(self, observation):
        super().act(observation)
        return action_set("square81").nearest(observation["joystick"])


def test_who_rests_while_nothing_is_sent_forgets_no_more_than_what_was_on_the_way():
    frames, policy = {"joystick": np.array([0.0, 1.0], np.float32)}, Follows(at=3)
    guard = GuardedPolicy(policy, action_set("square81"), clock=lambda: 0.0)
    sent = [guard.drive(frames) for _ in range(4 + RULE.good_ticks)]
    on_the_way = sum(stick != (0.0, 0.0) for stick in sent[2:-1])
    assert 0 < on_the_way < RULE.good_ticks / 2 and sent[-1] == (0.0, 1.0)
    assert policy.resets == on_the_way


@given(st.lists(st.tuples(st.sampled_from([None, (0.0, 0.0), (0.25, 0.75)]), AGES), max_size=40))
def test_the_example_forgets_alike(ticks):
    driver = EXAMPLE["Driver"].__new__(EXAMPLE["Driver"])
    driver.meaning = {"guard": {key: getattr(RULE, key) for key in GuardRule.model_fields}, "states": {}}
    driver.meaning["actions_xy"], driver.clock, forgot = [(0.0, 0.0), (0.25, 0.75)], lambda: 0.0, []
    driver.forget = lambda: (setattr(driver, "states", {}), forgot.append(1))
    driver.reset()
    state, expected = GuardState(), 1
    for wanted, age_s in ticks:
        values = np.eye(2)[None, driver.meaning["actions_xy"].index(wanted)] if wanted else np.full((1, 2), np.nan)
        told = {"values": values, "warning": np.ones((1, 1)), "danger": np.zeros((1, 2))}
        driver.asked = lambda frames, told=told: told
        stick = driver.step({"joystick": np.zeros(2)}, age_s)
        asked = wanted if age_s <= RULE.oldest_s else None
        state = guarded(RULE, state, GuardTick(wanted=asked, outputs_finite=asked is not None, age_s=age_s))
        expected += bool(state.fault) or state.stick != asked
        assert (stick, driver.warning and not state.fault) == (state.stick, driver.warning)
        assert len(forgot) == expected

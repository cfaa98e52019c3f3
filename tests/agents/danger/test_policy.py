"""A danger network that drives, and warns."""

import numpy as np
import pytest
import torch

from tests.agents.danger.sights import TWO, observation, small_config
from tests.support.samples import ACTIONS
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.perception.alarm import AlarmState, next_alarm_state
from wcsim.agents.policy_api import NeedsSenses, Warns
from wcsim.config.run_file import DangerRuleSettings
from wcsim.errors import PolicyError

RULE = DangerRuleSettings(warn=0.5)


def policy_of(*words: str, base: float = -3.0) -> DangerPolicy:
    config = small_config(*words)
    torch.manual_seed(1)
    net = channels_last(DangerNet(spec_of(config))).eval()
    with torch.no_grad():
        net.base.fill_(base)
    return DangerPolicy("own", net, config, RULE)


@pytest.mark.parametrize("words", [(), (TWO,)], ids=str)
def test_a_policy_acts_and_a_reset_lets_it_drive_the_same_again(words):
    policy, config = policy_of(*words), small_config(*words)
    assert isinstance(policy, Warns) and isinstance(policy, NeedsSenses)
    drives = []
    for _ in range(2):
        policy.reset()
        policy.begin()
        drives.append([policy.act(observation(config, tick)) for tick in range(6)])
    assert drives[0] == drives[1]
    assert all(0 <= action < 81 for action in drives[0])


def test_it_follows_where_nothing_is_dangerous_and_brings_down_danger_where_all_is():
    safe, config = policy_of(base=-30.0), small_config()
    seen = observation(config)
    assert safe.act(seen) == ACTIONS.nearest(seen["joystick"])
    grim = policy_of(base=30.0)
    assert 0 <= grim.act(seen) < 81


def test_a_tick_of_doubt_is_forgotten_with_everything_else_at_a_reset():
    """Every action has a danger of some 0.3, above the threshold: the second tick takes the user's own away."""
    policy, config = policy_of(base=-0.8), small_config()
    policy.rule = DangerRuleSettings(threshold=0.02, at_once=0.9)
    for _ in range(2):
        policy.reset()
        seen = observation(config)
        own = ACTIONS.nearest(seen["joystick"])
        assert [policy.act(seen) == own for _ in range(2)] == [True, False] and policy.unsafe.all()


def test_what_was_taken_is_given_back_only_where_there_is_room(monkeypatch):
    policy, config = policy_of(), small_config()
    policy.rule = DangerRuleSettings(threshold=0.2, at_once=0.0)
    seen = observation(config)
    own = ACTIONS.nearest(seen["joystick"])
    dangers = iter((0.15, 0.3, 0.15, 0.15, 0.09, 0.15))
    monkeypatch.setattr(policy, "_judge", lambda _: np.where(np.arange(81) == own, next(dangers), 0.0)[None])
    policy.reset()
    assert [policy.act(seen) == own for _ in range(6)] == [True, False, False, False, True, True]


def test_dangers_that_are_no_numbers_are_refused():
    policy = policy_of(base=float("nan"))
    with pytest.raises(PolicyError, match="not finite"):
        policy.act(observation(small_config()))


def test_several_chairs_are_judged_in_one_call_as_each_by_itself_but_for_one_that_sees_nothing():
    config, alone, together = small_config(), [policy_of(), policy_of()], [policy_of(), policy_of()]
    together[1]._net = None  # nobody calls it
    blind = {"joystick": np.zeros(2)}
    for tick in range(4):
        seen = [observation(config, tick), observation(config, tick + 10)]
        together[0].judge_together([*zip(together, seen, strict=True), (alone[0], blind)])
        for policy, other, what in zip(alone, together, seen, strict=True):
            assert policy.act(what) == other.act(what)
            assert np.array_equal(policy.unsafe, other.unsafe)


def test_a_policy_asks_for_odometry():
    assert policy_of().senses == ("odometry", "gyro")


def test_it_warns_of_the_users_own_stick_after_two_ticks_and_not_after_a_reset():
    policy, config = policy_of(base=30.0), small_config()
    told = []
    for tick in range(3):
        policy.act(observation(config, tick))
        told.append(policy.warning)
    assert told == [False, True, True]
    policy.reset()
    assert not policy.warning


def alarms(*dangers: float) -> list[bool]:
    alarm, told = AlarmState(), []
    for danger in dangers:
        alarm = next_alarm_state(alarm, danger, RULE.warn)
        told.append(alarm.on)
    return told


def test_a_single_tick_of_danger_is_no_warning_and_two_are():
    assert alarms(1.0, 0.0, 0.0) == [False] * 3
    assert alarms(0.0, 1.0, 0.0, 1.0, 0.0) == [False, False, False, True, False]
    assert alarms(0.9, 0.9) == [False, True]
    assert alarms(0.4, 0.6, 0.6, 0.6, 0.6)[-1], "what lies above for longer is warned of, however little"


def test_a_warning_does_not_flicker_about_its_level():
    about = [0.9, 0.9] + [0.45, 0.52, 0.42, 0.5, 0.44] * 4
    assert all(alarms(*about)[1:])
    assert not any(alarms(*about[2:])), "the same without a warning before it"
    assert not alarms(*about, 0.1, 0.1)[-1]


def test_a_level_of_one_never_warns_and_zero_always_does():
    assert next_alarm_state(AlarmState(), 0.01, warn=0.0).on
    alarm = AlarmState()
    for _ in range(50):
        alarm = next_alarm_state(alarm, 1.0, warn=1.0)
    assert not alarm.on and np.isclose(alarm.level, 1.0)

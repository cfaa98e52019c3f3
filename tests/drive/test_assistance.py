import numpy as np
import pytest

from tests.drive.lookers import Breaks, HearsDelays, Remembers
from tests.support.samples import ACTIONS
from wcsim.agents.policies.baselines import FollowPolicy
from wcsim.drive.assistance import Assistance
from wcsim.errors import PolicyError
from wcsim.types import Drawn

AHEAD = {"joystick": np.array([0.0, 1.0], np.float32)}
OWN = ACTIONS.nearest((0.0, 1.0))


def test_the_policy_has_its_say_and_hears_what_was_sent() -> None:
    policy = Remembers()
    helped = Assistance(policy, ACTIONS).answer(AHEAD, {}, asked=True)
    assert (helped.chosen, helped.sent, helped.intervening) == (36, 36, True)
    assert helped.unsafe == tuple(range(45, 81))
    assert policy.heard == [36]


@pytest.mark.parametrize("off", [True, False], ids=["off", "overruled"])
def test_without_its_say_the_stick_is_sent_and_the_policy_hears_that(off: bool) -> None:
    policy = Remembers()
    assistance = Assistance(policy, ACTIONS)
    assistance.switch(not off)
    answer = assistance.answer(AHEAD, {}, asked=off)
    assert (answer.sent, answer.intervening, policy.heard) == (OWN, False, [OWN])
    assert answer.chosen == (OWN if off else 36)
    assert bool(answer.unsafe) != off


def test_a_policy_that_breaks_stops_the_chair_once_and_is_off() -> None:
    assistance = Assistance(Breaks(), ACTIONS)
    said = [assistance.answer(AHEAD, {}, asked=True) for _ in range(8)]
    rest = ACTIONS.nearest((0.0, 0.0))
    assert [each.sent for each in said[5:]] == [rest, OWN, OWN]
    assert (assistance.on, assistance.failed) == (False, "ValueError: out of ideas")
    assert [each.warning for each in said] == [True] * 5 + [False] * 3
    assistance.switch(True)
    assert assistance.answer(AHEAD, {}, asked=True).warning, "it is tried again"
    assert assistance.failed == ""


def test_an_action_that_is_none_is_a_failure() -> None:
    assistance = Assistance(Remembers(), ACTIONS)
    assistance._agent.policy.choose = lambda _: 81
    assert assistance.answer(AHEAD, {}, asked=True).sent == ACTIONS.nearest((0.0, 0.0))
    assert "expected an integer from 0 to 80" in assistance.failed


def test_levels_are_those_of_the_policy() -> None:
    with_levels, without = Assistance(Remembers(), ACTIONS), Assistance(FollowPolicy(actions=ACTIONS), ACTIONS)
    with_levels.set_level(0.5)
    assert (with_levels.level, with_levels.levels, with_levels.tells_unsafe) == (0.5, (0.0, 2.0), True)
    assert (without.level, without.levels, without.tells_unsafe) == (None, None, False)
    with pytest.raises(PolicyError, match="no adjustable level"):
        without.set_level(1.0)


class Fragile(Remembers):
    """Raises where it is told to."""

    def __init__(self, where: str) -> None:
        super().__init__()
        self.where = where

    def _may(self, where: str) -> None:
        if where == self.where:
            raise ValueError(where)

    def begin(self) -> None:
        self._may("begin")

    def reset(self) -> None:
        self._may("reset")

    def set_level(self, level: float) -> None:
        self._may("set_level")

    def sent(self, action: int) -> None:
        self._may("sent")

    @property
    def warning(self) -> bool:
        self._may("warning")
        return False


@pytest.mark.parametrize("where", ["begin", "reset", "set_level", "sent", "warning"])
def test_a_policy_may_break_anywhere_and_the_person_drives_on(where: str) -> None:
    assistance = Assistance(Fragile(where), ACTIONS)
    assistance.reset(None)
    assistance.set_level(0.5)
    answer = assistance.answer(AHEAD, {}, asked=True)
    assert (assistance.on, assistance.failed, answer.warning) == (False, f"ValueError: {where}", False)
    assistance.reset(None)
    assert assistance.answer(AHEAD, {}, asked=True).sent == OWN
    assistance.switch(True)
    assert assistance.on is (where != "reset"), "it is tried again"


def test_a_policy_that_is_tried_again_hears_the_delay_of_the_episode_of_now() -> None:
    policy = HearsDelays()
    assistance = Assistance(policy, ACTIONS)
    assistance.reset(Drawn(action_delay_ticks=1))
    assistance.failed = "broken"
    assistance.reset(Drawn(action_delay_ticks=2))
    assistance.switch(True)
    assert policy.heard == [1, "reset", 2, "reset"]


def drive(assistance: Assistance, ticks: int) -> list[tuple[float | None, int]]:
    """The level and what the chair was told, tick by tick."""
    found = []
    for _ in range(ticks):
        sent = assistance.answer(AHEAD, {}, asked=True).sent
        found.append((assistance.level, sent))
        assistance.end_tick()
    return found


def test_help_raises_the_level_for_a_while_and_a_second_request_begins_it_again() -> None:
    assistance = Assistance(Remembers(), ACTIONS, help_ticks=3)
    assistance.set_level(0.5)
    assistance.ask_for_help()
    assert drive(assistance, 2) == [(2.0, 36)] * 2 and assistance.help_left == 1
    assistance.ask_for_help()
    assert drive(assistance, 5) == [(2.0, 36)] * 3 + [(0.5, 36)] * 2
    assert assistance.help_left == 0


def test_a_policy_without_levels_helps_by_half_of_its_choice() -> None:
    assistance = Assistance(FollowPolicy(actions=ACTIONS), ACTIONS, help_ticks=2)
    assistance.ask_for_help()
    half = ACTIONS.nearest((0.0, 0.5))
    assert drive(assistance, 3) == [(None, half), (None, half), (None, OWN)]
    assistance.ask_for_help()
    assert assistance.answer(AHEAD, {}, asked=False).sent == OWN, "who overrules is not helped"


def test_help_is_given_though_the_assistance_is_off_and_not_by_a_policy_that_broke() -> None:
    assistance = Assistance(Remembers(), ACTIONS, help_ticks=2)
    assistance.switch(False)
    assistance.ask_for_help()
    assert assistance.on and drive(assistance, 3) == [(2.0, 36), (2.0, 36), (1.0, OWN)]
    assert not assistance.on
    broken = Assistance(Breaks(), ACTIONS, help_ticks=50)
    broken.ask_for_help()
    drive(broken, 6)
    assert (broken.on, broken.help_left) == (False, 0)
    broken.ask_for_help()
    assert (broken.on, broken.help_left) == (False, 0)


@pytest.mark.parametrize(
    "ends, level",
    [
        (lambda each: each.switch(False), 1.0),
        (lambda each: each.set_level(0.3), 0.3),
        (lambda each: each.reset(None), 1.0),
    ],
    ids=["off", "level", "episode"],
)
def test_help_ends_with_what_else_is_set(ends, level) -> None:
    assistance = Assistance(Remembers(), ACTIONS, help_ticks=9)
    assistance.ask_for_help()
    drive(assistance, 1)
    ends(assistance)
    assert (assistance.level, assistance.help_left) == (level, 0)

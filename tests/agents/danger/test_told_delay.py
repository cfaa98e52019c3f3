"""A danger network is told in tests, too, which delay was drawn for an episode."""

from dataclasses import replace

import pytest

from tests.agents.danger.sights import observation, small_config
from tests.agents.danger.test_policy import policy_of
from tests.agents.driven import Script, driven
from tests.agents.evaluation.suite.lists import block_of, order_of
from tests.drive.lookers import HearsDelays
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.envs.episode_view import OBJECTS
from wcsim.agents.evaluation.suite.drive import drive_block
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policy_api import HearsDelay, pass_delay
from wcsim.config import resolve
from wcsim.types import Drawn


class Drawing(Script):
    """Draws a delay of 0, 1, 2, ... ticks."""

    def _info(self, distance):
        info = super()._info(distance)
        info[OBJECTS].drawn = Drawn(action_delay_ticks=len(self.seeds) - 1)
        return info


@pytest.mark.parametrize("ticks", [0, 3])
def test_a_network_that_was_told_a_delay_sees_what_one_sees_that_was_made_with_it(ticks):
    config, told = small_config(), policy_of()
    made = DangerPolicy("own", told._net, config, told.rule, ticks)
    pass_delay(told, Drawn(action_delay_ticks=ticks + 1))
    pass_delay(told, Drawn(action_delay_ticks=ticks))
    for policy in (told, made):
        policy.reset()
    for tick in range(5):
        seen = observation(config, tick)
        assert told.act(seen) == made.act(seen)
        assert (told.features.vector == made.features.vector).all()
        assert (told.features.start == made.features.start).all()


def test_without_a_drawn_delay_the_configured_one_stays():
    policy, told = policy_of("world.action_delay_ticks=2"), HearsDelays()
    for drawn in (None, Drawn(light=0.5)):
        pass_delay(policy, drawn)
        pass_delay(told, drawn)
    assert policy.extractor.around.ego.delay_ticks == 2 and told.heard == []
    assert isinstance(policy, HearsDelay) and not isinstance(make_baseline_policy("dwa", small_config()), HearsDelay)


def test_a_test_in_a_town_tells_each_episodes_delay_before_it_begins():
    policy = HearsDelays()
    driven(policy, Drawing(crash_at=3), episodes=3, max_steps=9, seed=1)
    assert policy.heard == [0, "reset", 1, "reset", 2, "reset"]


def test_a_suite_tells_each_episodes_delay_before_it_begins(corner):
    piece, place = order_of(corner, block_of(corner, max_steps=4))
    made = [HearsDelays(), HearsDelays()]
    varied = resolve(place.config, "vary.action_delay_ticks=[3,3]")
    drive_block(piece, replace(place, config=varied), iter(made).__next__)
    assert [policy.heard for policy in made] == [[3, "reset"], [3, "reset"]]

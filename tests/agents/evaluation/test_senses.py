"""A policy gets the senses that it asks for, and nobody else's world is another for it."""

from dataclasses import replace

import pytest

from tests.agents.evaluation.suite.lists import Held, block_of, config, order_of, suite_in
from tests.support.one_process import in_this_process
from wcsim.agents.evaluation.suite.drive import drive_block
from wcsim.agents.evaluation.suite.run import SuiteOrder, run_suite
from wcsim.agents.opening.named_policy import list_policy_overrides
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policy_api import sense_settings, senses_of
from wcsim.config import resolve
from wcsim.errors import ConfigError

BOTH = ("odometry", "gyro")


class Feels(Held):
    """Does not go without wheel odometry and turn rates."""

    name, senses = "feels", BOTH

    def __init__(self, config: object) -> None:
        super().__init__(0.0, 0.5)

    def act(self, observation: object) -> int:
        if observation["odometry"].shape != (2,) or observation["imu"].shape != (8,):
            raise RuntimeError("no senses")
        return self.action


class Numb(Feels):
    """The same without asking."""

    senses = ()


def test_senses_are_added_and_a_sensor_that_is_there_stays():
    plain = config()
    seen = resolve(plain, sense_settings(plain, BOTH))
    assert plain.sensors.odometry is None and not plain.env.observe_gyro
    assert seen.sensors.odometry is not None and seen.env.observe_gyro
    assert sense_settings(plain, ()) == ()
    worse = resolve(plain, "sensors.odometry.radius_error=0.1")
    assert resolve(worse, sense_settings(worse, BOTH)).sensors == worse.sensors
    with pytest.raises(ConfigError, match="sonar"):
        resolve(plain, sense_settings(plain, ("sonar",)))


def test_images_that_are_asked_for_are_given_to_who_is_no_network():
    plain = config()
    several = resolve(plain, "env.window=3")
    assert [resolve(one, list_policy_overrides(one, Numb(one))).env.window for one in (plain, several)] == [1, 3]


def test_dwa_asks_for_what_a_chair_has_and_who_does_not_ask_gets_nothing():
    assert senses_of(make_baseline_policy("dwa", config())) == BOTH
    assert senses_of(make_baseline_policy("follow", config())) == ()


def test_the_world_is_the_same_with_further_senses_in_it(corner):
    piece, place = order_of(corner, block_of(corner, max_steps=30))
    feeling = replace(place, config=resolve(place.config, sense_settings(place.config, BOTH)))
    alone, beside = (drive_block(piece, one, lambda: Held(0.1, 0.6)) for one in (place, feeling))
    assert alone == beside and alone[0].m > 0.5


def test_a_suite_turns_on_what_a_policy_asks_for(corner, tmp_path):
    names = [f"{__name__}:{name}" for name in ("Feels", "Numb")]
    suite = suite_in(corner, block_of(corner, max_steps=5))
    with in_this_process():
        feels, numb = (
            run_suite(SuiteOrder(suite=suite, out=tmp_path, preset="quick"), [name], lambda *_: None)[name]
            for name in names
        )
    assert {record.status for record in feels} == {"timed_out"} and feels[0].steps == 5
    assert {record.status for record in numb} == {"policy_failed"} and "odometry" in numb[0].reason

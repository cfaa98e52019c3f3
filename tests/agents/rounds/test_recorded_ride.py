"""Recorded rides as observations: a policy that sees them again does again what it did."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.agents.export.test_danger_graph import network
from tests.support.journals import JournaledWorld
from tests.support.worlds import quick_config
from wcsim.agents.danger.policy import DangerPolicy, load_net, save_danger
from wcsim.agents.policy_api import pass_delay
from wcsim.agents.rounds.recorded_ride import _RecordedRide, recorded_ride
from wcsim.bridge.replay.replayed import config_of
from wcsim.config import RunConfig, resolve
from wcsim.config.run_file import DangerRuleSettings
from wcsim.core.files import iter_unused_paths
from wcsim.drive.recording.session_recorder import SessionRecorder
from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart
from wcsim.errors import ConfigError, JournalError
from wcsim.log.drive import read_drive
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import make_observation
from wcsim.types import Joystick

TICKS = 40


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A danger network that finds much dangerous, for the camera that drives have."""
    place = tmp_path_factory.mktemp("policy") / "policy"
    save_danger(place, network(), DangerRuleSettings(threshold=0.45), resolve("laptop"))
    return place


def again(policy: Path, ride: _RecordedRide, config: RunConfig) -> list[int]:
    """What the policy chooses when it sees a ride."""
    net, rule = load_net(policy)
    chooser = DangerPolicy("own", net, config, rule, ride.delay_ticks)
    chooser.begin()
    chooser.reset()
    return [chooser.act(seen) for seen in ride.seen]


def test_who_sees_a_drive_again_chooses_what_was_chosen(corner: Path, policy: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.drive"
    session = DriveSession(DriveStart(town=str(corner), policy=str(policy), seed=4))
    session.add_observer(SessionRecorder(session, iter_unused_paths(path), lambda news: None))
    sticks = [Joystick(0.8 * math.sin(0.3 * number), 0.6) for number in range(TICKS)]
    chosen = [session.tick(Wish(stick=stick)).action for stick in sticks]
    session.close()
    ride = recorded_ride(path, TICKS)
    assert len(ride.seen) == TICKS and list(ride.actions) == chosen
    given = np.array([(stick.x, stick.y) for stick in sticks], np.float32)
    assert np.array_equal([seen["joystick"] for seen in ride.seen], given)
    assert ride.seen[0]["depth"].any()
    assert again(policy, ride, config_of(read_drive(path).header)) == chosen
    assert len(set(chosen)) > 5
    assert len(recorded_ride(path, 7).seen) == 7


@pytest.mark.parametrize("words, delay", [((), 0), (("vary.action_delay_ticks=[2,2]",), 2)], ids=["as set", "drawn"])
def test_who_sees_a_journals_seat_again_chooses_what_was_chosen(
    corner: Path, policy: Path, tmp_path: Path, words: tuple[str, ...], delay: int
) -> None:
    senses = ("sensors.odometry=typical", "env.observe_gyro=true", "cameras.0.noise=typical", *words)
    config, (net, rule) = quick_config(*senses), load_net(policy)
    points = action_set(config.env.actions).points
    with JournaledWorld(corner, tmp_path, *senses) as it:
        driver = DangerPolicy("own", net, config, rule)
        driver.begin()
        it.admit(0)
        it.admit(1)  # of 25 steps
        pass_delay(driver, it.now.clients[1].drawn)
        driver.reset()
        chosen = []
        for _ in range(30):
            client = it.now.clients[1]
            if client.first is not None:
                break
            chosen.append(driver.act(make_observation(client, config)))
            it.tick(1, {1: Joystick(*points[chosen[-1]].tolist())})
        it.tick(3)
    ride = recorded_ride(tmp_path, 100, seat=1)
    assert len(ride.seen) == 25 and list(ride.actions) == chosen and ride.delay_ticks == delay
    assert again(policy, ride, config) == chosen
    with pytest.raises(ConfigError, match="seat 2 has no tick"):
        recorded_ride(tmp_path, 100, seat=2)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.drive").write_bytes(b"nothing")
    with pytest.raises(JournalError):
        recorded_ride(tmp_path / "a.drive", 5)
    with pytest.raises(JournalError):
        recorded_ride(tmp_path, 5)

"""Wheel odometry wherever a sensor has to be seen: environments, a served world, a journal, ranges; off as before."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.support.worlds import follow, open_world, quick_config
from wcsim.agents.envs.episode_view import SeatEnvAdapter
from wcsim.agents.envs.parallel_env import StreetParallelEnv
from wcsim.agents.envs.vec_env import StreetVecEnv
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.config import RunConfig, resolve
from wcsim.errors import ConfigError, ConfigMismatchError
from wcsim.types import SeatSpec

ON = "sensors.odometry=typical"
SPEC = SeatSpec(max_steps=8)


def said(corner: Path, *overrides: str, seats: int = 1, ticks: int = 6) -> np.ndarray:
    """(ticks + 1, 2) of the first seat."""
    with open_world(corner, "world.demand_scale=0", *overrides, seats=seats, seed=3) as world:
        clients = [world.snapshot.clients[0], *(follow(world).clients[0] for _ in range(ticks))]
    return np.array([client.sensors.readings[0].values for client in clients])


@pytest.mark.filterwarnings("ignore:.*WARN.*:UserWarning")
def test_the_environment_has_an_entry_for_it_and_the_checker_is_content(corner):
    with closing(WheelchairEnv(str(corner), overrides=("world.warmup_s=0", ON))) as env:
        box = env.observation_space["odometry"]
        assert (box.shape, box.dtype, box.low.min(), box.high.max()) == ((2,), np.float32, -1.0, 1.0)
        check_env(env, skip_render_check=True)
        _, info = env.reset(seed=1)
        for _ in range(15):
            observation, _, _, _, info = env.step(info["user_action"])
        assert observation["odometry"] * 4.0 == pytest.approx(info["reading_odometry"], abs=1e-6)
        assert observation["odometry"][0] * 4.0 == pytest.approx(info["speed_mps"], abs=0.1)
        assert info["speed_mps"] > 0.3


def test_every_face_shows_the_same(corner):
    order, seen = {"overrides": ("world.warmup_s=0", ON), "seed": 4}, []
    with closing(WheelchairEnv(str(corner), **order)) as env:
        env.reset(seed=4)
        seen.append([env.step(40)[0]["odometry"] for _ in range(6)])
    with closing(StreetParallelEnv(str(corner), chairs=1, **order)) as env:
        (agent,) = env.reset(seed=4)[0]
        seen.append([env.step({agent: 40})[0][agent]["odometry"] for _ in range(6)])
    with closing(StreetVecEnv(str(corner), chairs=1, **order)) as env:
        env.seed(4)
        env.reset()
        seen.append([env.step(np.array([40]))[0]["odometry"][0] for _ in range(6)])
    assert np.array_equal(seen[0], seen[1]) and np.array_equal(seen[0], seen[2])
    assert np.abs(seen[0]).max() > 0.0


def test_off_is_as_before(corner):
    off, on, none = quick_config(), quick_config(ON), quick_config("sensors.odometry=none")
    assert off == none == resolve(on, "sensors=none")
    assert "sensors" not in off.model_dump() and "sensors" not in off.vary.model_dump()
    assert off.world_digest() != on.world_digest() and RunConfig.model_validate_json(on.model_dump_json()) == on
    assert not resolve("paper").sensors.on()
    with open_world(corner, seed=3) as world:
        assert follow(world).clients[0].sensors.readings == ()


def test_noise_is_that_of_the_seed_whoever_else_is_there(corner):
    alone = said(corner, ON)
    assert said(corner, ON).tobytes() == alone.tobytes()
    assert said(corner, ON, seats=2).tobytes() == alone.tobytes()
    assert (said(corner, ON, "sensors.odometry.speed_density_mps=0")[1:, 0] != alone[1:, 0]).all()
    assert (alone[0] == 0.0).all()  # it stands


def test_its_reading_is_in_the_state_hash(corner):
    def last(*overrides: str) -> str:
        with open_world(corner, ON, *overrides, seed=3) as world:
            return follow(world).state_hash

    assert last() == last()
    assert last("sensors.odometry.speed_density_mps=0.003") != last()


def test_a_range_draws_its_numbers_for_every_episode(corner):
    drawn = 'vary.sensors={"odometry.radius_error"=[0.1,0.2],"odometry.delay_ticks"=[2,4]}'
    with open_world(corner, ON, drawn, spec=SPEC) as world:
        ends = [client for _ in range(24) if (client := follow(world).clients[0]).first]
    values = [dict(client.first.drawn.sensors) for client in ends]
    assert len({value["odometry.radius_error"] for value in values}) == len(values) == 3
    assert all(0.1 <= value["odometry.radius_error"] <= 0.2 for value in values)
    late = said(corner, ON, 'vary.sensors={"odometry.delay_ticks"=[3,3]}', ticks=8)
    assert (late[:4] == 0.0).all() and (late[4:, 0] != 0.0).all()


@pytest.mark.parametrize(
    "override, says",
    [
        ('vary.sensors={"odometry.colour"=[0,1]}', "expected one of .*odometry.ticks_per_turn"),
        ('vary.sensors={"lidar.beams"=[0,1]}', "not a number of an existing sensor"),
        ('vary.sensors={"odometry.radius_error"=[0.1,0.5]}', "vary.sensors.odometry.radius_error.*at most 0.2"),
    ],
)
def test_a_range_of_what_is_not_there_or_out_of_bounds_is_refused(corner, override, says):
    with pytest.raises(ConfigError, match=says):
        open_world(corner, ON, override)


def test_a_world_without_it_is_no_world_for_who_expects_it(corner):
    with open_world(corner) as world:
        bare = world.snapshot.clients[0]
    with pytest.raises(ConfigMismatchError, match=r"sensors are \{\}; expected \{'odometry': 2\}"):
        SeatEnvAdapter(quick_config(ON)).begin(bare)

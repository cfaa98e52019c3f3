"""Ride quality on the mesh of a real town: level pavement must feel level."""

import math

import numpy as np
import pytest

from tests.physics.rig import ray_down
from wcsim.config import ChairConfig, ImuConfig
from wcsim.physics.engine import Engine
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.towns.scenario.town import find_town
from wcsim.towns.street import load_street
from wcsim.types import Joystick

AROUND_M = np.array([(x, y) for x in np.linspace(-1.6, 1.6, 9) for y in np.linspace(-1.6, 1.6, 9)])
EDGES = 400  # at most
WARM_TICKS = 26  # until it cruises


def felt_on_level_ground(engine: Engine, bare: Engine, chair: Wheelchair, way: np.ndarray) -> list[np.ndarray]:
    """Low-passed acceleration, tick by tick, where the ground is level, of a chair that drives along a polyline."""
    arc = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    at = lambda s: np.array([np.interp(s, arc, way[:, 0]), np.interp(s, arc, way[:, 1])])  # noqa: E731
    start, ahead, reached, felt = at(1.0), at(2.0), 1.0, []
    chair.place(np.r_[start, ray_down(bare, start[None])], math.atan2(*(ahead - start)[::-1]))
    for tick in range(int(6.0 * min(arc[-1] - 3.0, 30.0))):
        state = chair.state()
        while reached < arc[-1] and np.hypot(*(at(reached) - state.p_WB_m[:2])) < 1.5:
            reached += 0.1
        gap = at(reached) - state.p_WB_m[:2]
        turn = -1.2 * math.remainder(math.atan2(gap[1], gap[0]) - state.yaw_rad, 2 * math.pi)
        chair.command(Joystick(min(max(turn, -1.0), 1.0), 1.0))
        for _ in range(round(0.1 / engine.step_s)):
            chair.before_step()
            engine.step()
            chair.after_step()
        chair.end_tick(None)
        if chair.contacts():
            break
        level = np.ptp(ray_down(bare, state.p_WB_m[:2] + AROUND_M)) < 1e-6
        if level and tick >= WARM_TICKS and abs(turn) < 0.15:
            felt.append(chair.sensors._sensors["imu"].lowpass_mps2)
    return felt


def felt_in(town: str, plant: str, ticks: int, hz: int) -> np.ndarray:
    """Low-passed acceleration (ticks or more, steps, 3) while cruising on level pavement of a town at 1.67 m/s."""
    street = load_street(find_town(town))
    ways = [edge.points_W_m for edge in street.walk.edges if np.hypot(*np.diff(edge.points_W_m, axis=0).T).sum() > 15.0]
    with Engine(1 / hz) as engine, Engine(1 / hz) as bare:
        for key in street.tiles.keys:  # as a world does it, with seams between them
            engine.add_street(street.tiles.mesh(key))
            bare.add_street(street.tiles.mesh(key))
        chair = Wheelchair(engine, ChairConfig(plant=plant), ImuConfig(), seat=0)
        felt: list[np.ndarray] = []
        for k in np.random.default_rng(3).choice(len(ways), min(EDGES, len(ways)), replace=False):
            felt += felt_on_level_ground(engine, bare, chair, ways[k]) if len(felt) < ticks else []
    return np.array(felt)


@pytest.mark.proof
@pytest.mark.timeout(900)
@pytest.mark.parametrize("hz", [120, 240])
@pytest.mark.parametrize(
    "town, plant, way_m", [("helsinki", "rwd", 200), ("monaco", "rwd", 90), ("helsinki", "mwd", 200)]
)
def test_level_pavement_of_a_real_town_feels_level(town, plant, way_m, hz):
    ticks = math.ceil(way_m / (1.67 * 0.1))
    felt = felt_in(town, plant, ticks, hz)
    assert len(felt) >= ticks
    each_axis = np.sqrt((felt**2).mean(axis=(0, 1)))
    assert each_axis.max() < 0.2  # 0.5 is allowed
    assert np.abs(felt).max() < 5.0

"""Users in real worlds: their hands and eyes show the parameters drawn for them, and they get where they want.

A short sample always runs; the whole table is a proof.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scripts.users import LONGEST_S, TINY_CAMERA, UsersOptions, summary
from benchmarks.users.drives import drive_routes
from benchmarks.users.table import Statistic, statistics
from benchmarks.users.user_sheet import user_sheet, write_sheet
from tests.support.samples import write_recording
from tests.support.worlds import follow, open_world, quick_config
from wcsim.bridge.world import World
from wcsim.config import resolve
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import Town, find_town
from wcsim.types import SeatSpec
from wcsim.users.profiles import list_profile_names
from wcsim.users.recordings.recorded_user import find_user, read_stick_recording

TOWNS = ("helsinki", "monaco", "manhattan")
# How far a mean over 20 routes may lie from the mean of the parameters that were drawn: absolute, then relative.
TOLERANCES = {
    "reaction_s": (0.04, 0.0),
    "lag_s": (0.04, 0.0),
    "gain_x": (0.12, 0.0),
    "gain_y": (0.12, 0.0),
    "bias_x": (0.04, 0.0),
    "bias_y": (0.09, 0.0),
    "noise": (0.004, 0.12),
    "noise_rate": (0.0, 0.3),
    "tremor_hz": (0.12, 0.0),
    "tremor": (0.0, 0.1),
    "correct_every_s": (0.03, 0.0),
    "speed_share": (0.12, 0.0),
    "see_share": (0.15, 0.0),
    "away_share": (0.08, 0.0),
    "away_s": (0.4, 0.0),
    "hold_s": (0.2, 0.0),  # the shortest hold of a route is longer than the least where few were short
}
# People who come so near that an inattentive user must have noticed or missed them are few: more chairs meet more.
CROWD = "world.demand_scale=5"
SEATS = (*list_profile_names(), *("inattentive",) * 5)
FEWEST_MET = {"inattentive": 60}  # so that the bound is more than two standard deviations of the share
FEWEST_MET_OTHERS = 20


def off(rows: Mapping[str, Statistic], looser: float = 1.0) -> dict[str, tuple[float, float]]:
    """The statistics (measured, parameter) that are not what they should be."""
    found = {}
    for name, row in rows.items():
        absolute, relative = TOLERANCES.get(name, (1e-6, 0.0))
        allowed = looser * (absolute + relative * abs(row.parameter))
        over = row.measured - row.parameter if row.at_most else abs(row.measured - row.parameter)
        if over > allowed:
            found[name] = (row.measured, row.parameter)
    return found


def test_users_in_a_street_show_their_parameters(corner_town: Town, tmp_path: Path):
    names = ("tremor", "switch")
    driven = drive_routes(corner_town, quick_config(), names, 1, 20.0, seed=3)
    logs = {name: routes[0].log for name, routes in driven.items()}
    rows = {name: statistics([log]) for name, log in logs.items()}
    assert {"reaction_s", "lag_s", "tremor_hz", "tremor"} <= set(rows["tremor"])
    assert {"reaction_s", "switches_per_s"} <= set(rows["switch"])
    few = {name: row for name, row in rows["tremor"].items() if name in ("reaction_s", "tremor_hz", "tremor")}
    assert not off(few, looser=3.0)
    assert not off({"reaction_s": rows["switch"]["reaction_s"]})
    assert off({"tremor_hz": replace(rows["tremor"]["tremor_hz"], parameter=6.0)}, looser=3.0)
    hands = {name: log.hand for name, log in logs.items()}
    picture = user_sheet(hands, 20.0)
    assert picture.ndim == 3 and len(np.unique(picture.reshape(-1, 3), axis=0)) > 10
    write_sheet(tmp_path / "deep" / "users.png", hands, 20.0)
    assert (tmp_path / "deep" / "users.png").stat().st_size > 10_000


def test_a_recorded_joystick_drives_a_chair_as_it_did(corner: Path, tmp_path: Path):
    with open_world(corner, seed=2, spec=SeatSpec(profile="tremor")) as world:
        sticks = [world.seats[0].user.joystick]
        for _ in range(30):
            follow(world)
            sticks.append(world.seats[0].user.joystick)
    file = tmp_path / "stick.csv"
    write_recording(file, 0.1 * np.arange(len(sticks)), np.array([(j.x, j.y) for j in sticks]))
    assert len(read_stick_recording(file).time_s) == 31
    with open_world(corner, seed=2, spec=SeatSpec(profile=f"recorded:{file}")) as world:
        replayed, gave_up = [world.seats[0].user.joystick], []
        for _ in range(35):
            snapshot = follow(world)
            replayed.append(snapshot.clients[0].user)
            gave_up.append(snapshot.clients[0].events.gave_up)
    assert replayed[:31] == sticks
    assert replayed[31:] == [replayed[-1]] * 5 and replayed[-1].x == replayed[-1].y == 0.0
    assert gave_up.count(True) == 1 and gave_up.index(True) == 30


@pytest.mark.parametrize("name", ["drunk", "recorded:nowhere.csv"])
def test_an_unknown_user_is_refused_before_the_first_tick(corner_town: Town, name: str):
    with pytest.raises(ConfigError, match=r"competent|nowhere\.csv"):
        World(corner_town, quick_config(), (SeatSpec(profile=name),), 1, find_user=find_user)


# --- proofs ---


@pytest.mark.proof
def test_every_statistic_of_every_profile_over_twenty_routes():
    config = resolve("quick", (*TINY_CAMERA, CROWD))
    logs = {name: [] for name in list_profile_names()}
    for number, town in enumerate(TOWNS):
        share = len(range(number, 20, len(TOWNS)))
        # A seed of its own for each town: with one for all, the same few users would be drawn in each again.
        for name, routes in drive_routes(find_town(town), config, SEATS, share, 40.0, seed=number).items():
            logs[name] += [route.log for route in routes]
    met = {name: sum(log.met for log in found) for name, found in logs.items()}
    assert all(count >= FEWEST_MET.get(name, FEWEST_MET_OTHERS) for name, count in met.items()), met
    wrong = {name: off(statistics(found)) for name, found in logs.items()}
    assert not any(wrong.values()), wrong


@pytest.mark.proof
def test_competent_users_arrive_in_an_empty_town_and_inattentive_ones_need_help_in_traffic():
    options = UsersOptions()
    rows = {}
    for name, demand in (("competent", 0.0), ("inattentive", 1.0)):
        config = resolve("quick", (*TINY_CAMERA, f"world.demand_scale={demand}"))
        routes = []
        for number, town in enumerate(options.towns.split(",")):
            share = len(range(number, options.routes, len(TOWNS)))
            routes += drive_routes(find_town(town), config, (name,), share, LONGEST_S, seed=0, truth=True)[name]
        rows[name] = summary(routes)
    assert rows["competent"]["arrived_share"] >= 0.95, rows["competent"]
    assert rows["competent"]["free_share"] >= 0.7
    assert rows["inattentive"]["crashes_per_km"] >= 0.5, rows["inattentive"]

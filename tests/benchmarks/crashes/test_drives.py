"""The bench of crashes, end to end in a street corner: chairs that are driven into what is there."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks.crashes import watch
from benchmarks.crashes.classes import CrashClass
from benchmarks.crashes.drives import CrashDrive, CrashOrder, Rate, drive_crashes
from benchmarks.crashes.watch import SeatWatch
from benchmarks.scripts.crashes import as_json
from tests.support.worlds import open_world, quick_config
from wcsim.agents.policies.baselines import baseline
from wcsim.errors import ConfigError
from wcsim.supervisor.actions import action_set
from wcsim.towns.scenario.town import find_town
from wcsim.types import Command, Joystick, SeatSpec, StartSpec

POINTS = action_set("square81")
CONFIG = quick_config("world.action_delay_ticks=2", "cameras.0.noise=typical", "reward.drop=false")


class Held:
    """A driver that holds one stick."""

    def __init__(self, x: float, y: float) -> None:
        self.action = POINTS.nearest((x, y))
        self.begun = self.episodes = 0

    def begin(self) -> None:
        self.begun += 1

    def reset(self) -> None:
        self.episodes += 1

    def act(self, observation: object) -> int:
        return self.action


def held_sticks() -> list[Held]:
    return [Held(0.0, 1.0), Held(0.25, 0.75), Held(-0.25, 0.75)]


def drive(corner: Path, drivers, ticks: int = 150, seed: int = 3, config=CONFIG) -> CrashDrive:
    order = CrashOrder(policy="held", profile="inattentive", ticks=ticks, seed=seed)
    return drive_crashes(order, find_town(str(corner)), config, drivers)


@pytest.fixture(scope="module")
def held(corner: Path) -> tuple[list[Held], CrashDrive]:
    drivers = held_sticks()
    return drivers, drive(corner, drivers)


def test_every_step_and_episode_is_counted(held):
    drivers, found = held
    assert (found.steps, found.policy) == (3 * 150, "held")
    assert sum(item.steps for item in found.episodes) == found.steps
    assert [driver.begun for driver in drivers] == [1, 1, 1]
    for seat, driver in enumerate(drivers):
        own = [item for item in found.episodes if item.seat == seat]
        assert [item.episode for item in own] == list(range(len(own)))
        assert driver.episodes == len(own)
        assert [item.end for item in own][-1] == ""
    crashed = [(item.seat, item.episode, item.end) for item in found.episodes if item.end not in ("", "cut")]
    assert sorted(crashed) == sorted((crash.seat, crash.episode, crash.reason) for crash in found.crashes)
    assert 0.1 < 1000.0 * found.km / (0.1 * found.steps) < 1.7


def test_who_drives_on_blindly_crashes_and_every_crash_is_told_whole(held):
    _, found = held
    assert found.crashes and found.falls
    for crash in found.crashes:
        assert CrashClass(crash.kind) is not CrashClass.OTHER
        assert crash.reason in ("collision", "acceleration", "tilt", "drop")
        assert crash.way and crash.fault in ("own", "other")
        assert crash.away_share is not None and 0.0 <= crash.away_share <= 1.0
        later = crash.reason != "drop"  # the fall is that crash itself
        assert crash.after_fall == (later and crash.fell_s is not None and crash.fell_s <= 10.0)
        assert crash.step <= 10 or crash.safe_before is not None


def test_a_fall_is_a_crash_where_it_counts_as_one(corner):
    config = quick_config("world.action_delay_ticks=2", "cameras.0.noise=typical")
    found = drive(corner, held_sticks(), ticks=60, config=config)
    assert {crash.kind for crash in found.crashes} == {"drop"}


def test_the_same_seed_gives_the_same_findings_and_another_one_others(corner, held):
    _, found = held
    again = drive(corner, held_sticks())
    assert json.dumps(as_json(again)) == json.dumps(as_json(found))
    assert json.dumps(as_json(drive(corner, held_sticks(), ticks=20, seed=4))["episodes"]) != json.dumps(
        as_json(drive(corner, held_sticks(), ticks=20))["episodes"]
    )


def test_other_policies_begin_at_the_same_places(corner, held):
    _, found = held
    names = ("follow", "oracle")
    other = [drive(corner, [baseline(name, CONFIG) for _ in range(3)], ticks=10) for name in names]
    firsts = [[item.start_W_m for item in one.episodes if item.episode == 0] for one in (found, *other)]
    assert firsts[0] == firsts[1] == firsts[2]


def test_an_episode_is_cut(corner, monkeypatch):
    monkeypatch.setattr("benchmarks.crashes.drives.EPISODE_STEPS", 8)
    found = drive(corner, [Held(0.0, 0.0)], ticks=20)
    assert [(item.steps, item.end) for item in found.episodes] == [(8, "cut"), (8, "cut"), (4, "")]


def watched(corner: Path, stick: Joystick, ticks: int, start: StartSpec, *settings: str, crashes: int = 1) -> SeatWatch:
    """A chair that begins at a place and holds a stick, until it has crashed so often."""
    spec = SeatSpec(profile="competent", max_steps=1000, truth=True, start=start)
    with open_world(corner, *settings, spec=spec, seed=2) as world:
        watch = SeatWatch(world.seats[0], world.street, world.config, world.snapshot.clients[0], ())
        for _ in range(ticks):
            watch.give(stick)
            snapshot = world.tick((Command(seat=0, tick=world.snapshot.tick, joystick=stick),))
            watch.take(snapshot.clients[0], world.snapshot.actors)
            if len(watch.crashes) == crashes:
                break
        watch.close()
    return watch


def beside_the_road(corner: Path) -> tuple[StartSpec, StartSpec]:
    """A place on a pavement, and one on the road beside it, both heading for the kerb between them."""
    with open_world(corner, seed=2) as world:
        grid, walk = world.street.grid, world.street.walk
        for edge in walk.edges:
            (ax, ay), (bx, by) = edge.points_W_m[0], edge.points_W_m[-1]
            middle, yaw = np.array([0.5 * (ax + bx), 0.5 * (ay + by)]), math.atan2(by - ay, bx - ax)
            for side in (yaw + 0.5 * math.pi, yaw - 0.5 * math.pi):
                out = np.array([math.cos(side), math.sin(side)])
                line = middle + np.linspace(0.0, 6.0, 61)[:, None] * out
                raised = grid.raised_at(line)
                clear = float(grid.clearance_at(line).min()) > 1.0
                if edge.kind.value == "sidewalk" and clear and raised[0] > 0.1 and raised[-20:].max() < 0.01:
                    goal = tuple(edge.points_W_m[0])
                    road = line[int(np.argmax(raised < 0.01)) + 25]
                    return (
                        StartSpec(p_W_m=tuple(middle), yaw_rad=side, goal_W_m=goal),
                        StartSpec(p_W_m=tuple(road), yaw_rad=side + math.pi, goal_W_m=goal),
                    )
    raise LookupError("no pavement with a road beside it")


def test_a_fall_off_the_kerb_is_seen_and_what_hits_the_kerb_from_the_road_is_told_apart(corner):
    pavement, road = beside_the_road(corner)
    fell = watched(corner, Joystick(0.0, 0.5), 60, pavement)
    assert fell.falls == 1 or any(crash.kind in (CrashClass.FALLING.value, "drop") for crash in fell.crashes)
    rammed = watched(corner, Joystick(0.0, 1.0), 60, road)
    (crash,) = rammed.crashes
    assert (crash.kind, crash.fault, crash.thing) == (CrashClass.KERB.value, "own", "kerb")
    assert (crash.after_fall, crash.fell_s, crash.in_picture) == (False, None, True)
    assert crash.speed_mps > 1.0 and crash.away_share == 0.0


def test_the_pictures_of_0_3_to_1_s_before_are_looked_at(corner, monkeypatch):
    _, road = beside_the_road(corner)
    eyes_W_m = []

    def unseen(points_W_m, sight, camera, more_m):
        eyes_W_m.append(-sight.T_CW[:, :3].T @ sight.T_CW[:, 3])
        return False

    monkeypatch.setattr(watch, "in_picture", unseen)
    (crash,) = watched(corner, Joystick(0.0, 1.0), 60, road).crashes
    away_m = [math.dist(eye[:2], crash.p_W_m) for eye in eyes_W_m]
    assert crash.in_picture is False
    assert len(away_m) == 8 and away_m == sorted(away_m, reverse=True)
    assert away_m[-1] > 0.2 * crash.speed_mps and away_m[0] > 0.7 * crash.speed_mps


def test_a_fall_before_is_remembered_until_the_next_episode(corner, monkeypatch):
    _, road = beside_the_road(corner)
    monkeypatch.setattr(watch.KerbFall, "see", falls_once_at(3))
    rammed = watched(corner, Joystick(0.0, 1.0), 120, road, crashes=2)
    first, second = rammed.crashes
    assert rammed.falls == 1
    assert (first.kind, first.after_fall) == (CrashClass.KERB_AFTER_FALL.value, True)
    assert first.fell_s == pytest.approx(0.1 * (first.step - 3))
    assert (second.kind, second.after_fall, second.fell_s) == (CrashClass.KERB.value, False, None)


def falls_once_at(tick: int):
    """In the place of `KerbFall.see`: a fall at one tick; the first call sees the start."""
    calls = iter(range(10_000))
    return lambda self, middle: next(calls) == tick


def test_a_kerb_behind_is_not_in_the_picture(corner):
    _, road = beside_the_road(corner)
    turned = StartSpec(p_W_m=road.p_W_m, yaw_rad=road.yaw_rad + math.pi, goal_W_m=road.goal_W_m)
    jolts = ("chair.reverse_share=1.0", "reward.accel_window_mps2=[8.0,20.0]")  # drive wheels stop there
    (crash,) = watched(corner, Joystick(0.0, -1.0), 80, turned, *jolts).crashes
    assert (crash.kind, crash.reason, crash.in_picture) == (CrashClass.JOLT.value, "acceleration", False)
    assert crash.speed_mps > 1.0
    (seen,) = watched(corner, Joystick(0.0, 1.0), 80, road, *jolts).crashes
    assert seen.in_picture is True


def test_the_stick_that_counts_is_the_one_after_the_delay(corner, monkeypatch):
    pavement, _ = beside_the_road(corner)
    tracks = []
    monkeypatch.setattr(watch, "stretches", lambda track, chair: tracks.append(track) or ())
    watched(corner, Joystick(1.0, 0.0), 8, pavement, "world.action_delay_ticks=3")
    (track,) = tracks
    assert track.sticks.tolist() == [[0.0, 0.0]] * 3 + [[1.0, 0.0]] * 5
    assert len(track.speed_mps) == len(track.turn_radps) == 9
    assert abs(track.turn_radps[3]) < 0.1 < abs(track.turn_radps[8])


def test_lost_control_is_told_with_place_tilt_and_duration(corner, monkeypatch):
    """A chair whose stick is said to have been at rest while it drove."""
    pavement, _ = beside_the_road(corner)
    start = StartSpec(p_W_m=pavement.p_W_m, yaw_rad=pavement.yaw_rad + 0.5 * math.pi, goal_W_m=pavement.goal_W_m)
    asked = SeatWatch.give
    monkeypatch.setattr(SeatWatch, "give", lambda self, stick: asked(self, Joystick(0.0, 0.0)))
    watch = watched(corner, Joystick(0.0, 0.75), 30, start)
    (lost,) = watch.lost
    assert lost.rolled and not lost.turned
    assert lost.seconds == pytest.approx(0.1 * watch.lost_steps)
    assert 1.5 < lost.seconds < 3.0 and lost.tick == 31 - watch.lost_steps
    assert math.dist(lost.p_W_m, start.p_W_m) < 2.0 and lost.way
    assert abs(lost.roll_deg) < 5.0 and 0.8 < lost.speed_mps < 1.7


def test_rates_have_their_interval():
    assert Rate(events=5, km=2.0).per_km == pytest.approx((2.5, 0.812, 5.834), abs=1e-3)
    assert Rate(events=0, km=0.0).per_km is None


def test_an_unknown_profile_is_refused(corner):
    order = CrashOrder(policy="held", profile="drunk", ticks=1, seed=0)
    with pytest.raises(ConfigError, match="drunk"):
        drive_crashes(order, find_town(str(corner)), CONFIG, [Held(0.0, 0.0)])


def test_records_are_plain_values(held):
    _, found = held
    assert json.loads(json.dumps(asdict(found)))["steps"] == found.steps

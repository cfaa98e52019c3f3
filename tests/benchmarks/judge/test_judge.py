"""Starts before kerbs, the links of a crash, and what is said of commands, held against copies of the world."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.judge.forks import asked, kinds
from benchmarks.judge.held_stick import HeldStreet
from benchmarks.judge.kerb_places import KerbCase, kerb_starts
from benchmarks.judge.starts import place_of
from benchmarks.judge.why import LINKS, chain
from wcsim.bridge.world_copy import in_copy
from wcsim.errors import PhysicsError
from wcsim.towns.scenario.town import find_town
from wcsim.types import Joystick

TICKS = 60


def street(corner: Path, policy: str, plant: str = "rwd") -> HeldStreet:
    return HeldStreet(find_town(str(corner)), policy, plant, 3)


def before_kerb(here: HeldStreet, case: KerbCase) -> None:
    starts = kerb_starts(here.world.street, case, place_of(here, 3), np.random.default_rng(0))
    assert any(here.begin(start, case.stick) for start in starts)


@pytest.mark.parametrize("plant", ["rwd", "mwd", "whill"])
@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
def test_the_stick_alone_drives_into_a_kerb_and_oracle_and_rule_do_not(corner, plant, angle_deg):
    for policy, crashes in (("follow", True), ("dwa", False), ("oracle", False)):
        with street(corner, policy, plant) as here:
            before_kerb(here, KerbCase(angle_deg=angle_deg))
            driven = here.drive(TICKS)
            assert driven.own is crashes and (driven.taken_steps > 0) is not crashes, (policy, driven)


def test_the_rule_gives_back_what_it_took_only_when_there_is_room(corner):
    with street(corner, "dwa") as here:
        before_kerb(here, KerbCase())
        ahead = []
        assert not here.drive(TICKS, lambda now: ahead.append(here.actions.points[here.driver.action][1])).own
    first = next(tick for tick, y in enumerate(ahead) if y < 1.0)
    assert 0 < first < len(ahead) - 20 and (np.diff(ahead[first:]) <= 0.0).all()


def test_a_chair_that_nobody_helps_breaks_the_link_of_the_verdict(corner):
    with street(corner, "follow") as here:
        before_kerb(here, KerbCase())
        found = chain(here, TICKS)
    assert found.driven.own and found.broke == "verdict"
    assert set(found.held_until_s) == set(LINKS) and found.held_until_s["sweep"] == pytest.approx(0.1)
    assert found.held_until_s["verdict"] is None


def test_a_street_that_the_policy_has_forgotten_breaks_the_link_of_the_map(corner, monkeypatch):
    with street(corner, "dwa") as here:
        before_kerb(here, KerbCase())
        monkeypatch.setattr(here.policy.around.memory, "points_B_m", lambda pose_O, way_m: np.zeros((0, 2)))
        found = chain(here, TICKS)
    assert found.driven.own and found.broke == "map" and found.held_until_s["picture"] is not None


def test_what_is_said_of_commands_is_held_against_copies_of_the_world(corner):
    kind = kinds()[0]
    with street(corner, "oracle") as here:
        rows = list(asked(here, kind, 2, place_of(here, 3), seed=1))
    assert {row.kind for row in rows} == {kind} and any(row.near for row in rows)
    bad = [row for row in rows if row.physics_s is not None]
    good = [row for row in rows if row.physics_s is None]
    assert len(bad) >= 5 <= len(good)
    assert sum(row.oracle_s is None for row in bad) <= 0.1 * len(bad)
    assert sum(row.oracle_s is not None for row in good) <= 0.25 * len(good)


def test_a_copy_moves_nothing_and_says_what_went_wrong_in_it(corner):
    with street(corner, "follow") as here:
        here.hand.stick = Joystick(0.0, 1.0)
        before = here.world.snapshot

        def failing(world):
            raise KeyError("lost")

        with pytest.raises(PhysicsError, match="KeyError: 'lost'"):
            in_copy(here.world, failing)
        assert in_copy(here.world, lambda world: str(id(world.snapshot)).encode()) == str(id(before)).encode()
        assert here.world.snapshot is before

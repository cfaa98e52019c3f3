"""Whom a launcher ends as hanging, by what the world says of its seats: with a clock that is told."""

import selectors

import pytest

from tests.support.events import read_events
from wcsim.server.launch.event_log import EventLogWriter
from wcsim.server.launch.states import ClientLaunchPlan, LauncherTimeouts, WorldStatusReport
from wcsim.server.launch.supervised import WatchedClientProcess

SILENT = ("sh", "-c", "sleep 1000")
LEASE_S, JOINING_S = 30.0, 600.0
RULES = LauncherTimeouts(client_lease_s=LEASE_S, joining_s=JOINING_S)


@pytest.fixture
def ended(tmp_path):
    """Tells whether a client is ended that sees these worlds, each for so many seconds."""

    def is_ended(*worlds):
        selector = selectors.DefaultSelector()
        plan = ClientLaunchPlan(name="a", seat=0, argv=SILENT, log=tmp_path / "log")
        client = WatchedClientProcess(plan, RULES, selector, EventLogWriter(tmp_path))
        client.start(0.0)
        now_s = 0.0
        for world, lasts_s in worlds:
            for _ in range(2 + int(lasts_s)):
                client.set_world(world)
                client.poll(now_s)
                now_s += 1.0
        client.close()
        selector.close()
        return any(line["event"] == "hang" for line in read_events(tmp_path))

    return is_ended


def world(epoch, stage="collect", members=()):
    return WorldStatusReport(stage=stage, epoch=epoch, ticks=20, members=members)


SEATED = (world(0, members=("a",)), 5.0)


def test_who_waits_with_others_for_a_late_one_after_the_end_of_an_epoch_is_left_alone(ended):
    gathers = (world(1, "empty"), 2.0 * LEASE_S)
    assert not ended(SEATED, (None, 2.0), gathers, (world(1, members=("a",)), 5.0))


def test_who_comes_late_after_that_has_the_same_time_as_any_other(ended):
    gathers = (world(1, "empty"), 2.0 * LEASE_S)
    assert not ended(SEATED, gathers, (world(1, members=("b",)), 0.5 * LEASE_S))
    assert ended(SEATED, gathers, (world(1, members=("b",)), 1.5 * LEASE_S))


@pytest.mark.parametrize("stage", ["empty", "collect"])
def test_who_was_given_up_and_does_not_notice_is_ended(ended, stage):
    """Also the last one, whose world is empty then."""
    assert ended(SEATED, (world(0, stage), 1.5 * LEASE_S))


def test_who_does_not_come_back_at_all_to_a_world_that_has_nobody_else_is_ended(ended):
    assert ended(SEATED, (world(1, "empty"), 1.5 * JOINING_S))


def test_who_has_never_had_its_seat_waits_as_long_as_its_world_does(ended):
    assert not ended((world(0, "empty"), 2.0 * JOINING_S))
    assert ended((world(0, members=("b",)), 1.5 * JOINING_S))

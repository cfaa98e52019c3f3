"""One contract for every link: the same order gives the same frames, whichever way they came."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from tests.worlds import quick_config
from wcsim.errors import LinkClosedError, ProtocolError, TownError
from wcsim.server.link import LocalLink, WorldOrder
from wcsim.server.messages import Frame, decode_reply, encode
from wcsim.server.open_link import open_link
from wcsim.server.process_link import ProcessLink
from wcsim.types import Joystick, SeatSpec

LINKS = [LocalLink, ProcessLink]
AHEAD = Joystick(0.1, 0.8)


def order(corner, seed=4) -> WorldOrder:
    return WorldOrder(town=str(corner), config=quick_config(), seat=SeatSpec(max_steps=25), seed=seed)


def ledger(link, ticks=40):
    """Every frame as bytes, because images are views that later frames overwrite."""
    frame = link.join()
    frames = [encode(Frame(frame))]
    for _ in range(ticks):
        frame = link.act(frame.tick, AHEAD)
        frames.append(encode(Frame(frame)))
    return frames


@pytest.fixture(scope="module")
def reference(corner):
    with LocalLink(order(corner)) as link:
        return ledger(link)


@pytest.mark.parametrize("make", LINKS)
def test_frames_are_the_same_to_the_bit(make, corner, reference):
    with make(order(corner)) as link:
        assert ledger(link) == reference


@pytest.mark.parametrize("make", LINKS)
def test_join_respawn_and_rebuild(make, corner, reference):
    with make(order(corner)) as link:
        first = link.join()
        link.act(first.tick, AHEAD)
        assert link.join().tick == first.tick + 1
        again = link.respawn()
        assert (again.tick, again.events.episode, again.events.step) == (first.tick + 1, 1, 0)
        anew = link.rebuild(4)
        start = decode_reply(reference[0])
        assert isinstance(start, Frame)
        assert np.array_equal(anew.plant.p_WB_m, start.client.plant.p_WB_m)
        assert anew.tick == 0


@pytest.mark.parametrize("make", LINKS)
def test_an_action_for_another_tick_is_refused_and_the_link_lives_on(make, corner):
    with make(order(corner)) as link:
        with pytest.raises(ProtocolError, match="tick 0"):
            link.act(5, AHEAD)
        assert link.act(0, AHEAD).tick == 1


@pytest.mark.parametrize("make", LINKS)
def test_an_unknown_town_is_the_same_error(make):
    with pytest.raises(TownError, match="atlantis"):
        make(WorldOrder(town="atlantis", config=quick_config(), seat=SeatSpec(), seed=0))


def test_the_second_world_gets_a_process_of_its_own(corner, reference):
    with open_link(order(corner)) as first, open_link(order(corner)) as second:
        assert isinstance(first, LocalLink)
        assert isinstance(second, ProcessLink)
        assert ledger(second, 10) == reference[:11]
        assert ledger(first, 10) == reference[:11]


def test_a_world_that_dies_is_noticed(corner):
    with ProcessLink(order(corner)) as link:
        os.kill(link._child.pid, signal.SIGKILL)
        with pytest.raises(LinkClosedError, match="ended"):
            link.act(0, AHEAD)


def test_a_closed_link_says_so(corner):
    link = ProcessLink(order(corner))
    link.close()
    link.close()
    with pytest.raises(LinkClosedError, match="closed"):
        link.act(0, AHEAD)

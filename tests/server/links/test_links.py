"""One contract for every link: the same order gives the same frames, whichever way they came."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.server.servers import AHEAD, QUICK, Server, alone, driven, far_order, frames_of, stand_in_order
from tests.support.worlds import quick_config
from wcsim.core.own_folder import LockedTempFolder, world_endpoint_from_folder
from wcsim.errors import (
    ConfigMismatchError,
    LinkClosedError,
    ProtocolError,
    SeatTakenError,
    ServerGoneError,
    TownError,
    VersionMismatchError,
    WorldFullError,
)
from wcsim.server.links import base
from wcsim.server.links.base import ProcessSeatLink, SeatLink, open_seat_links
from wcsim.server.links.local import LocalSeatLinkGroup
from wcsim.server.links.socket import ProcessSeatLinkGroup, SocketSeatLink
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import ClientCore, JoinSettings, Patience
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import SeatRequest, WorldBuildSpec
from wcsim.server.transport.keys import create_missing_keys
from wcsim.types import SeatSpec

SEED, CONFIG, SPEC = 4, quick_config(), SeatSpec(max_steps=25, truth_visible=True)
TICKS = 40


def order(corner, seed=SEED) -> WorldBuildSpec:
    return WorldBuildSpec(town=str(corner), config=CONFIG, seat=SPEC, seed=seed)


@pytest.fixture(scope="module")
def reference(corner):
    with alone(LocalSeatLinkGroup(order(corner))) as link:
        return frames_of(link, TICKS)


@dataclass
class Opened:
    """A link, and every frame it gave from a new world."""

    link: SeatLink
    frames: list[bytes]


@contextmanager
def over_tcp(corner, folder, keys: str) -> Iterator[ProcessSeatLink]:
    """A seat for a client on another machine."""
    world = far_order(folder, corner, config=CONFIG, seed=SEED, keys=keys)
    with Server(world, folder) as server:
        address = server.status().listening
        with SocketSeatLink(SeatRequest(endpoint=address, name="far", claim="x", spec=SPEC, keys=keys)) as link:
            yield link


@pytest.fixture(scope="module", params=["local", "process", "tcp", "tcp+curve"])
def opened(request, corner, reference, tmp_path_factory):
    del reference  # its world has to be closed before another one is opened
    with ExitStack() as held:
        if request.param == "local":
            link = held.enter_context(alone(LocalSeatLinkGroup(order(corner))))
        elif request.param == "process":
            link = held.enter_context(alone(ProcessSeatLinkGroup(order(corner))))
        else:
            folder, keys = tmp_path_factory.mktemp("far"), ""
            if request.param == "tcp+curve":
                keys = str(folder / "keys")
                create_missing_keys(folder / "keys", ("far",))
            link = held.enter_context(over_tcp(corner, folder, keys))
        yield Opened(link, frames_of(link, TICKS))


def test_frames_are_the_same_to_the_bit(opened, reference):
    assert opened.frames == reference


def test_join_respawn_and_rebuild(opened, reference):
    first = opened.link.rebuild(SEED)
    assert first.tick == 0
    start = m.decode_reply(reference[0])
    assert isinstance(start, m.Frame)
    assert np.array_equal(first.plant.p_WB_m, start.client.plant.p_WB_m)
    opened.link.act(0, AHEAD)
    assert opened.link.join().tick == 1
    again = opened.link.respawn()
    assert (again.tick, again.events.episode, again.events.step) == (1, 1, 0)
    assert opened.link.act(1, AHEAD).tick == 2


def test_an_action_for_another_tick_is_refused_and_the_link_lives_on(opened):
    here = opened.link.join().tick
    with pytest.raises(ProtocolError, match=f"tick {here}"):
        opened.link.act(here + 5, AHEAD)
    assert opened.link.act(here, AHEAD).tick == here + 1


def test_a_link_knows_its_seat_and_where_its_time_went(opened):
    before = opened.link.waits
    opened.link.act(opened.link.join().tick, AHEAD)
    after = opened.link.waits
    assert opened.link.seat == 0
    assert after.steps == before.steps + 1
    assert after.link_s > before.link_s
    assert after.simulation_s > before.simulation_s


@pytest.mark.parametrize("make", [LocalSeatLinkGroup, ProcessSeatLinkGroup])
def test_an_unknown_town_is_the_same_error(make, capfd):
    with pytest.raises(TownError, match="atlantis"):
        make(WorldBuildSpec(town="atlantis", config=CONFIG, seat=SPEC, seed=0))
    assert capfd.readouterr().err == ""


def test_a_world_that_dies_is_noticed_and_a_closed_link_says_so(corner):
    with alone(ProcessSeatLinkGroup(order(corner))) as link:
        link.join()
        os.kill(link._child.process.pid, signal.SIGKILL)
        with pytest.raises(LinkClosedError, match="ended"):
            link.act(0, AHEAD)
    link.close()
    link.beat(1)  # nobody is there to hear it
    with pytest.raises(LinkClosedError, match="closed"):
        link.act(0, AHEAD)


# --- several clients of one process ---


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """A server with three seats and a stand-in for a world."""
    folder = tmp_path_factory.mktemp("hall")
    with Server(stand_in_order(folder, 3, rules=ServerRules(capacity=3, config="abc", notice_s=0.2)), folder) as server:
        server.status()
        yield server


def arrived(link):
    """Ask for a seat, and wait until the server says whom it waits for: messages of two sockets may overtake."""
    link.request_join()
    while not link.core.late:
        link._pump()


def test_two_clients_step_together_and_one_that_leaves_does_not_stop_the_other(hall):
    with SocketSeatLink(hall.seat("a")) as a:
        with SocketSeatLink(hall.seat("b")) as b:
            here = b.join().tick
            arrived(a)  # who comes later gets in after the next tick
            assert b.act(here, AHEAD).tick == a.receive().tick == here + 1
            assert [frame.tick for frame in driven([a, b], 30)] == [here + 31] * 2
            assert (a.master, b.master) == (False, True)
        assert driven([a], 10)[0].tick == here + 41
        assert a.master


def test_who_does_not_fit_hears_why(hall):
    with SocketSeatLink(hall.seat("a", seat=1)) as a:
        a.join()
        with SocketSeatLink(hall.seat("b", seat=1)) as b, pytest.raises(SeatTakenError, match="seat 1 belongs to a"):
            b.join()
        with SocketSeatLink(hall.seat("c", seat=7)) as c, pytest.raises(SeatTakenError, match="0 to 2"):
            c.join()
        with SocketSeatLink(hall.seat("d", config="xyz")) as d, pytest.raises(ConfigMismatchError, match=r"xyz.*abc"):
            d.join()
        with SocketSeatLink(hall.seat("e", config="abc")) as e, SocketSeatLink(hall.seat("f")) as f:
            arrived(e)
            arrived(f)
            with SocketSeatLink(hall.seat("g")) as g, pytest.raises(WorldFullError, match="all 3 seats"):
                g.join()


def test_another_version_is_named(hall, monkeypatch):
    monkeypatch.setattr(m, "PROTOCOL", 99)
    with SocketSeatLink(hall.seat("a")) as a, pytest.raises(VersionMismatchError, match=r"protocol 99.*server has 8"):
        a.join()


def test_nobody_there_is_said_in_time(tmp_path):
    order = SeatRequest(
        endpoint=f"ipc://{tmp_path}/nobody", name="a", claim="a", patience=replace(QUICK, reconnect_s=0.5)
    )
    with SocketSeatLink(order) as a, pytest.raises(ServerGoneError, match="is it running"):
        a.join()


@contextmanager
def sole_client(folder, **order):
    """A stand-in for a world, and a client that is in it alone."""
    with Server(stand_in_order(folder, **order), folder) as server, SocketSeatLink(server.seat("a")) as a:
        a.join()
        yield server, a


@pytest.mark.parametrize("works", [False, True])
def test_a_client_that_is_to_end_does_not_wait_for_a_world_that_does_not_answer(tmp_path, works):
    """Also one that learns while it waits, in whose stead another thread listens."""
    with sole_client(tmp_path) as (server, a):
        server.kill()
        a.send(0, AHEAD)
        if works:
            a.while_waiting(a.wait_no_more)
        else:
            a.wait_no_more()
        with pytest.raises(ServerGoneError, match="requested to stop"):
            a.receive()


def test_a_client_says_that_its_world_is_gone_long_before_it_gives_up(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("wcsim.server.links.socket._CUT_S", 0.3)
    with sole_client(tmp_path) as (server, a):
        a.core.patience = replace(QUICK, reconnect_s=4.0)
        server.kill()
        with pytest.raises(ServerGoneError, match="silent"):
            a.act(0, AHEAD)
    assert [record.getMessage().startswith("wcsim: the connection to ipc:") for record in caplog.records] == [True]


@pytest.mark.parametrize("launcher_lives", [True, False])
def test_a_world_that_nobody_can_start_again_is_given_up_soon(tmp_path, monkeypatch, launcher_lives):
    monkeypatch.setattr("wcsim.server.links.base.LEAVING_S", 0.5)
    place = LockedTempFolder(tmp_path)
    with sole_client(tmp_path, endpoint=world_endpoint_from_folder(place.path)) as (server, a):
        a.core.patience = replace(QUICK, reconnect_s=3.0)
        server.kill()
        if not launcher_lives:
            os.close(place._lock)  # as the kernel does for one that is killed
        with pytest.raises(ServerGoneError, match="silent"):
            a.act(0, AHEAD)
        assert a.core.patience.reconnect_s == (3.0 if launcher_lives else 0.5)


def test_a_client_that_is_asked_to_end_gives_up_a_silent_world_sooner(tmp_path, monkeypatch):
    monkeypatch.setattr("wcsim.server.links.base.LEAVING_S", 0.5)
    with sole_client(tmp_path) as (server, a):
        a.wait_less()
        assert a.act(0, AHEAD).tick == 1, "one that answers is waited for"
        server.kill()
        with pytest.raises(ServerGoneError, match="silent"):
            a.act(1, AHEAD)
        assert a.core.patience.tick_s == QUICK.tick_s


def test_a_client_that_is_to_end_takes_an_answer_that_is_there(tmp_path):
    with sole_client(tmp_path) as (_, a):
        a.wait_no_more()
        assert a.core.master and not a.core.waiting
        assert a.join().tick == 0


def test_a_world_of_this_machine_that_dies_in_the_handshake_has_refused_nobody(tmp_path):
    """It is waited for as any other: whoever started it starts it again."""
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(tmp_path / "world"))
        door.listen()
        met = []

        def hang_up() -> None:
            while True:
                try:
                    caller, _ = door.accept()
                except OSError:
                    return
                met.append(caller.recv(1))
                caller.close()

        greeter = threading.Thread(target=hang_up)
        greeter.start()
        request = SeatRequest(
            endpoint=f"ipc://{tmp_path}/world", name="a", claim="a", patience=Patience(resend_s=0.2, reconnect_s=1.5)
        )
        with SocketSeatLink(request) as link, pytest.raises(ServerGoneError):
            link.join()
        door.shutdown(socket.SHUT_RDWR)
        greeter.join()
    assert met, "nobody came"


def test_work_between_send_and_receive_is_done_while_the_world_ticks(tmp_path):
    """The master works longer than the others wait for word of it, and its world has gone on all the same."""
    rules = ServerRules(capacity=2, expected=2, gather_s=60.0, notice_s=0.2)
    with Server(stand_in_order(tmp_path, rules=rules), tmp_path) as server, ExitStack() as held:
        links = [held.enter_context(SocketSeatLink(server.seat(name, seat=k))) for k, name in enumerate("ab")]
        driven(links, 3)
        master, other = links if links[0].master else links[::-1]
        ticked = threading.Event()
        master.send(3, AHEAD)

        def other_drives() -> None:
            assert other.act(3, AHEAD).tick == 4
            ticked.set()

        beside = threading.Thread(target=other_drives)
        beside.start()
        master.while_waiting(lambda: ticked.wait(30.0))
        assert ticked.is_set(), "the world stood still while its master worked"
        beside.join()
        assert master.receive().tick == 4
        waits = master.waits
        assert 0.0 < waits.worked_s <= waits.link_s and other.waits.worked_s == 0.0


KILLED = """
import os, signal
from wcsim.core.own_folder import LockedTempFolder
folder = LockedTempFolder().path
(folder / "seat-0").write_bytes(bytes(1000))
print(folder, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_world_of_ones_own_leaves_nothing_and_removes_what_the_killed_have_left(corner, tmp_path, monkeypatch):
    """Killed notebooks leave pictures in memory; no command that serves a world may ever be typed on that machine."""
    told = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, text=True, check=False).stdout
    left = Path(told.strip())
    assert (left / "seat-0").exists()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with alone(ProcessSeatLinkGroup(order(corner))) as link:
        link.join()
        assert not left.exists()
        place = Path(link._child.endpoint.removeprefix("ipc://")).parent
        assert place.exists()
        assert list(tmp_path.iterdir()) == [], "there is one place for all of it, which a killed process loses"
    assert not place.exists()


class AloneLink(ProcessSeatLink):
    """A link to a world that says nothing."""

    def _post(self, message: m.Request) -> None:
        del message

    def _pump(self) -> None:
        self.perform(self.core.clock(self._now_s()))

    def _end(self) -> None:
        pass


def test_a_client_that_was_stopped_has_not_waited_for_its_world(monkeypatch):
    """As when a container is paused for an hour: the world in it has not been silent, and goes on."""
    now = [1000.0]
    monkeypatch.setattr(base, "time", SimpleNamespace(monotonic=lambda: now[0], perf_counter=time.perf_counter))
    link = AloneLink(
        ClientCore(JoinSettings(claim=b"x", name="a", spec=SPEC), Patience(reconnect_s=90.0), base.make_session_id)
    )
    link.request_join()
    now[0] += 3600.0
    link._pump()
    assert link.core.waiting
    for _ in range(500):
        now[0] += 0.2
        link._pump()
    with pytest.raises(ServerGoneError, match="silent for 90 s"):
        link.receive()


def test_the_second_world_gets_a_process_of_its_own(corner):
    first = open_seat_links(order(corner))
    second = open_seat_links(order(corner))
    assert isinstance(first, LocalSeatLinkGroup)
    assert isinstance(second, ProcessSeatLinkGroup)
    with alone(first) as here, alone(second) as there:
        assert frames_of(there, 10) == frames_of(here, 10)

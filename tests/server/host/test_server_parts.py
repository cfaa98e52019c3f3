"""The small parts of a server process: its clock, its accounts of peers, its lifelines."""

import os
import socket
import subprocess
import sys
import time
from dataclasses import replace

import pytest
import zmq

from benchmarks.barrier.fake_world import FakeWorld
from tests.server.servers import stand_in_order
from wcsim.errors import ConfigError
from wcsim.log.reader import read_header
from wcsim.log.records import Ended
from wcsim.log.writer import JOURNAL, LogWriter
from wcsim.server.host.opening import EPOCH_OVER, REGATHER_S, open_server_parts
from wcsim.server.host.process import _ProcessWatch
from wcsim.server.launch.awake_clock import LEAP_S, SuspendSafeClock
from wcsim.server.protocol.events import ServerRules
from wcsim.server.transport.sockets import BURST, MAX_PEERS, MOST_FAULTS, PeerLimits, ServerSockets


def nobody():
    return frozenset()


def test_the_clock_leaps_over_time_in_which_the_server_was_stopped_but_not_over_steps():
    clock = SuspendSafeClock(100.0)
    assert clock.look(100.2) == pytest.approx(0.2)
    assert clock.look(4000.0) == pytest.approx(0.2 + LEAP_S)
    assert clock.look(4030.0, 29.9) == pytest.approx(0.3 + LEAP_S + 29.9)
    assert clock.look(4030.0, 50.0) == pytest.approx(0.3 + LEAP_S + 79.9)  # never backwards


def test_a_peer_that_sends_too_fast_is_told_and_at_last_ignored():
    peers = PeerLimits()
    heard = [peers.admit(b"x", 0.0, nobody) for _ in range(int(BURST) + MOST_FAULTS + 5)]
    assert heard.count(True) == BURST
    assert heard.count(False) == MOST_FAULTS
    assert heard[-1] is None
    assert peers.admit(b"y", 0.0, nobody)


def test_a_patient_peer_is_always_heard():
    peers = PeerLimits()
    assert all(peers.admit(b"x", 0.001 * tick, nobody) for tick in range(20_000))


def test_strangers_make_room_and_members_do_not():
    peers = PeerLimits()
    for number in range(MAX_PEERS):
        assert peers.admit(b"%d" % number, float(number), nobody)
    members = frozenset(b"%d" % number for number in range(MAX_PEERS) if number != 7)
    assert peers.admit(b"new", MAX_PEERS, lambda: members)
    assert peers.admit(b"other", MAX_PEERS, lambda: members | {b"new"}) is None


def test_a_crowd_of_strangers_that_talks_on_and_on_keeps_nobody_out():
    peers = PeerLimits()
    for second in range(5):
        for number in range(MAX_PEERS):
            peers.admit(b"%d" % number, float(second), nobody)
    assert peers.admit(b"client", 4.5, nobody)
    assert peers.admit(b"stranger", 5.0, lambda: {b"client"})
    assert peers.admit(b"client", 5.5, lambda: {b"client"})


def test_the_end_of_a_process_and_of_the_reader_is_news():
    reader, writer = os.pipe()
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    with _ProcessWatch(writer) as processes:
        assert processes.watch(child.pid, b"one")
        assert processes.watch(child.pid, b"two")
        assert processes.watch(os.getpid(), b"mine")
        assert not processes.watch((1 << 22) + 1, b"never there")
        assert processes.take_ended() == ([], False)
        processes.forget_all_but([b"one", b"mine"])
        child.communicate(b"\n")
        assert processes.take_ended() == ([b"one"], False)
        assert processes.take_ended() == ([], False)
        os.close(reader)
        assert processes.take_ended() == ([], True)
    os.close(writer)


def test_the_end_of_a_connection_is_told_once_and_of_whom(tmp_path):
    """Also when the next one has the same descriptor, as it mostly does."""

    peers: list[bytes] = []
    lost: list[bytes] = []

    def look(seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and (seconds < 1.0 or not peers):
            doors.wait(50)
            lost.extend(doors.take_lost())
            peers.extend(one.peer for one in doors.messages())

    def spoken(client: zmq.Socket[bytes]) -> None:
        client.connect(doors.listening)
        client.send(b"here")

    with ServerSockets(f"ipc://{tmp_path}/s/world", "tcp://127.0.0.1:*") as doors, zmq.Context() as context:
        for early in (False, True, False):  # also one that is gone before it is heard
            peers.clear()
            with context.socket(zmq.DEALER) as client:
                spoken(client)
                if not early:
                    look(30.0)
                    look(0.3)
                    assert peers[-1] not in lost
            if early:
                time.sleep(0.5)
                lost.extend(doors.take_lost())
            look(30.0)
            look(0.9)
            assert lost.count(peers[-1]) == 1


def test_what_a_dead_connection_said_last_is_not_taken_for_words_of_the_next(tmp_path):
    with ServerSockets(f"ipc://{tmp_path}/s/world", "tcp://127.0.0.1:*") as doors, zmq.Context() as context:
        lost: list[bytes] = []
        peers: dict[bytes, bytes] = {}

        def look(seconds: float) -> None:
            end_s = time.monotonic() + seconds
            while time.monotonic() < end_s:
                doors.wait(20)
                peers.update({one.data: one.peer for one in doors.messages()})
                lost.extend(doors.take_lost())

        with context.socket(zmq.DEALER) as first:
            first.connect(doors.listening)
            for _ in range(5):
                first.send(b"first")
            time.sleep(0.5)
        time.sleep(0.5)  # its descriptor is free
        with context.socket(zmq.DEALER) as second:
            second.connect(doors.listening)
            second.send(b"second")
            time.sleep(0.5)
            look(0.5)
            assert lost == [peers[b"first"]]
        look(1.0)
        assert lost == [peers[b"first"], peers[b"second"]]


def test_connections_that_nobody_looks_at_keep_nobody_out(tmp_path):
    """Of the news of a socket's connections, ZeroMQ keeps 2,000; its only thread waited for room then."""
    with ServerSockets(f"ipc://{tmp_path}/s/world", "tcp://127.0.0.1:*") as doors, zmq.Context() as context:
        _, _, port = doors.listening.rpartition(":")
        for _ in range(1_500):
            socket.create_connection(("127.0.0.1", int(port)), timeout=30.0).close()
        with context.socket(zmq.DEALER) as late:
            late.connect(doors.listening)
            late.send(b"late")
            end_s = time.monotonic() + 30.0
            while not (heard := [one.data for one in doors.messages()]) and time.monotonic() < end_s:
                doors.wait(50)
        assert heard == [b"late"]


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"endpoint": "ipc://relative"}, "absolute path"),
        ({"endpoint": "ipc:///" + "x" * 120}, "107 bytes"),
        ({"listen": "tcp://0.0.0.0:0"}, "can be reached from other machines"),
        ({"listen": "udp://1"}, "HOST:PORT"),
        ({"listen": "tcp://127.0.0.1:0", "keys": "/nowhere"}, "no NAME.public"),
    ],
)
def test_doors_that_cannot_be_opened(tmp_path, changes, words):
    order = stand_in_order(tmp_path, **changes)
    with pytest.raises(ConfigError, match=words):
        ServerSockets(order.endpoint, order.listen, order.keys)


def test_a_folder_that_others_can_enter_is_no_place_for_a_socket(tmp_path):
    (tmp_path / "s").mkdir()
    (tmp_path / "s").chmod(0o755)
    with pytest.raises(ConfigError, match="other users can enter"):
        ServerSockets(f"ipc://{tmp_path}/s/world")


def test_a_world_that_died_before_its_first_epoch_waits_for_all_as_a_new_one_does(tmp_path):
    order = stand_in_order(
        tmp_path, run=str(tmp_path / "new"), rules=ServerRules(capacity=2, expected=2, gather_s=20.0)
    )
    first = open_server_parts(order, FakeWorld).journal
    assert first is not None
    first.close()
    (tmp_path / "died").mkdir()
    LogWriter(tmp_path / "died" / JOURNAL, read_header(tmp_path / "new" / JOURNAL)).close()
    again = replace(order, run=str(tmp_path / "died"))
    for epoch, expected, gather_s in ((0, 2, 20.0), (1, 1, REGATHER_S)):
        opened = open_server_parts(again, FakeWorld)
        rules = opened.core.rules
        assert (opened.core.epoch, rules.expected, rules.gather_s) == (epoch, expected, gather_s)
        assert opened.journal is not None
        opened.journal.close()


@pytest.mark.parametrize("reason", ["asked to end", EPOCH_OVER])
def test_the_first_world_of_a_launch_waits_for_all_who_load_whatever_its_journal_says(tmp_path, reason):
    order = stand_in_order(
        tmp_path, run=str(tmp_path / "run"), rules=ServerRules(capacity=2, expected=2, gather_s=600.0)
    )
    first = open_server_parts(order, FakeWorld).journal
    assert first is not None
    with first:
        first.append(Ended(reason=reason))
    resumed = open_server_parts(replace(order, begins=True), FakeWorld)
    assert resumed.journal is not None
    resumed.journal.close()
    assert (resumed.core.epoch, resumed.core.rules) == (1, order.rules)

"""A world process that is killed, stopped, starved or asked to end, and clients that are."""

import resource
import signal
import socket
import stat
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from tests.server.servers import AHEAD, WAIT_S, Server, driven, joined, stand_in_order, stub_client, together
from tests.support.framing import read_whole
from wcsim.bridge.replay.replayed import verify
from wcsim.errors import AccessError, DiskFullError, LinkError, WorldRestartedError
from wcsim.log.reader import list_log_parts
from wcsim.log.records import Ended, EpochBegun, Ticked
from wcsim.log.writer import JOURNAL
from wcsim.server.host.process import main
from wcsim.server.launch.states import WorldExitCode
from wcsim.server.ledger import audit_ledgers, iter_ledger_frames
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import encode_json_line
from wcsim.server.transport.keys import create_missing_keys

BOTH = ServerRules(capacity=2, expected=2, gather_s=60.0, lease_s=10.0 * WAIT_S, notice_s=0.2)


def two_seats(server, folder):
    return [server.seat(name, seat=number, ledger=f"{folder}/{name}") for number, name in enumerate("ab")]


@contextmanager
def two_linked(order, folder):
    """A world, the links of its two clients, and what closes them."""
    with Server(order, folder) as server, ExitStack() as held:
        yield server, [held.enter_context(SocketSeatLink(seat)) for seat in two_seats(server, folder)], held


def audited(folder):
    """The journal of two clients, of whose steps none was lost, doubled or made up."""
    records = read_whole(folder / "run" / JOURNAL).records
    found, *_ = audit_ledgers(records, [(0, iter_ledger_frames(folder / "a")), (1, iter_ledger_frames(folder / "b"))])
    assert (found.lost, found.doubled, found.phantom) == (0, 0, 0)
    return records


def _ended(server, held):
    """The clients leave, and the world ends when it is asked to."""
    held.close()
    server.process.terminate()
    assert server.wait() == 0


def drive_through(link, ticks=30):
    """So many ticks, with the restarts of the world among them counted."""
    seen, restarts = link.join(), 0
    for _ in range(ticks):
        try:
            seen = link.act(seen.tick, AHEAD)
        except WorldRestartedError:
            seen, restarts = link.join(), restarts + 1
    return restarts


def killed_after(ticks, folder, **world):
    """The journal of a world that was killed after so many ticks, and came back for 29 more."""
    order = stand_in_order(folder, run=str(folder / "run"), rules=BOTH, **world)
    with two_linked(order, folder) as (server, links, held):
        server.status()
        assert [seen.tick for seen in driven(links, ticks)] == [ticks, ticks]
        server.kill()
        server.start()
        assert together(links, drive_through) == [1, 1]
        assert (links[0].epoch, links[0].join().tick) == (1, 29)
        _ended(server, held)
    return audited(folder)


def test_a_world_that_is_killed_comes_back_and_no_step_is_lost_or_doubled(tmp_path):
    records = killed_after(20, tmp_path)
    assert [len(read_whole(part).records) > 20 for part in list_log_parts(tmp_path / "run" / JOURNAL)] == [True, True]
    assert [record.epoch for record in records if isinstance(record, EpochBegun)] == [0, 1]
    assert isinstance(records[-1], Ended)


@pytest.mark.proof
def test_a_real_world_that_was_killed_and_the_next_one_are_verified(tmp_path, corner):
    killed_after(15, tmp_path, town=str(corner))
    verified = verify(tmp_path / "run" / JOURNAL, None, 0, None)
    assert (verified.ticks, verified.mismatches) == (44, 0)


def test_a_world_that_was_stopped_gives_nobody_up(tmp_path):
    order = stand_in_order(tmp_path, rules=replace(BOTH, lease_s=4.0))
    with two_linked(order, tmp_path) as (server, links, _):
        driven(links, 3)
        server.process.send_signal(signal.SIGSTOP)
        time.sleep(6.0)
        server.process.send_signal(signal.SIGCONT)
        assert [seen.tick for seen in driven(links, 3)] == [6, 6]


def test_a_client_that_hangs_is_given_up_and_the_other_goes_on(tmp_path):
    order = stand_in_order(tmp_path, rules=replace(BOTH, lease_s=4.0))
    with two_linked(order, tmp_path) as (_, links, _):
        joined(links)
        assert links[1].act(0, AHEAD).tick == 1
        with pytest.raises(LinkError, match="no sign of progress"):
            links[0].act(0, AHEAD)


@contextmanager
def two_processes(folder, remote=True):
    """A world, its two clients as processes of their own, and its first word of them that drive."""
    order = stand_in_order(folder, rules=BOTH, listen="tcp://127.0.0.1:*")
    with Server(order, folder) as server, ExitStack() as held:
        address = server.status().listening if remote else order.endpoint
        seats = [replace(seat, endpoint=address) for seat in two_seats(server, folder)]
        clients = {seat.name: held.enter_context(stub_client(seat, folder)) for seat in seats}
        yield server, clients, server.status(lambda s: s.ticks > 10)


@pytest.mark.parametrize("victim, remote", [("a", True), ("b", False)], ids=["a-tcp", "b-ipc"])
def test_a_client_that_is_killed_does_not_stop_the_other(tmp_path, victim, remote):
    with two_processes(tmp_path, remote) as (server, clients, running):
        assert running.members == ("a", "b")
        clients[victim].kill()
        alone = server.status(lambda s: len(s.members) == 1 and s.tick > running.tick)  # long before the lease ends
        (survivor,) = alone.members
        assert survivor != victim
        assert server.status(lambda s: s.tick > alone.tick).master == survivor


@pytest.mark.parametrize("remote", [True, False], ids=["tcp", "ipc"])
def test_nobody_waits_for_long_for_a_client_that_a_signal_holds_and_it_comes_back(tmp_path, remote):
    with two_processes(tmp_path, remote) as (server, clients, _):
        clients["b"].send_signal(signal.SIGSTOP)
        time.sleep(2.0)
        stopped = server.status()
        assert stopped.members == ("a", "b")
        alone = server.status(lambda s: s.tick > stopped.tick + 1)
        assert alone.members == ("a",)
        clients["b"].send_signal(signal.SIGCONT)
        again = server.status(lambda s: s.members == ("a", "b"))
        server.status(lambda s: s.tick > again.tick)
        if not remote:  # who is alone keeps nobody
            clients["a"].kill()
            clients["b"].send_signal(signal.SIGSTOP)
            time.sleep(7.0)
            clients["b"].send_signal(signal.SIGCONT)
            assert server.status(lambda s: s.tick > again.tick + 1).members == ("b",)


class Cable:
    """Carries connections to an address, until it is cut for a moment."""

    def __init__(self, held: ExitStack, address: str) -> None:
        self._far = ("127.0.0.1", int(address.rpartition(":")[2]))
        self._door = held.enter_context(socket.create_server(("127.0.0.1", 0)))
        self._ends: list[socket.socket] = []
        self.address = f"tcp://127.0.0.1:{self._door.getsockname()[1]}"
        held.callback(self._close)
        threading.Thread(target=self._open, daemon=True).start()

    def cut(self) -> None:
        for end in self._ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def _close(self) -> None:
        self.cut()
        for end in self._ends:
            end.close()

    def _open(self) -> None:
        with suppress(OSError):
            while True:
                near, far = self._door.accept()[0], socket.create_connection(self._far)
                self._ends += [near, far]
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                sink.sendall(data)
        for end in (source, sink):  # not closed: the kernel keeps what the other thread still reads from
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def test_a_client_whose_connection_was_lost_for_a_moment_joins_again(tmp_path):
    order = stand_in_order(tmp_path, run=str(tmp_path / "run"), rules=BOTH, listen="tcp://127.0.0.1:*")
    with Server(order, tmp_path) as server, ExitStack() as held:
        cable = Cable(held, server.status().listening)
        near, far = two_seats(server, tmp_path)
        links = [held.enter_context(SocketSeatLink(seat)) for seat in (near, replace(far, endpoint=cable.address))]
        assert [seen.tick for seen in driven(links, 5)] == [5, 5]
        cable.cut()
        assert server.status(lambda s: s.members == ("a",))
        through = threading.Event()

        def drive(link):
            if link is links[0]:
                seen = link.join()
                while not through.is_set():
                    seen = link.act(seen.tick, AHEAD)
                return 0
            restarts = drive_through(link)
            link.close()
            through.set()
            return restarts

        assert together(links, drive) == [0, 1]
        _ended(server, held)
    audited(tmp_path)


def test_it_ends_when_it_is_asked_to_and_says_goodbye(tmp_path):
    order = stand_in_order(tmp_path, run=str(tmp_path / "run"))
    with Server(order, tmp_path) as server, SocketSeatLink(server.seat("a")) as a:
        driven([a], 5)
        assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o700
        assert stat.S_IMODE((tmp_path / "s" / "world").stat().st_mode) == 0o600
        server.process.terminate()
        with pytest.raises(LinkError, match="requested to stop"):
            for tick in range(5, 1000):
                a.act(tick, AHEAD)
        assert server.wait() == 0
        assert server.errors() == ""
    last = read_whole(tmp_path / "run" / JOURNAL).records[-1]
    assert last == Ended(reason="requested to stop")


def test_ctrl_c_is_for_whoever_started_it_and_without_that_one_it_ends(tmp_path):
    with Server(stand_in_order(tmp_path), tmp_path) as server:
        server.status()
        server.process.send_signal(signal.SIGINT)
        assert server.status().stage == "empty"
        server.let_go()
        assert server.wait() == 0


def test_a_full_disk_ends_it_with_a_word_to_everybody(tmp_path):
    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, 1 << 16))

    order = stand_in_order(tmp_path, run=str(tmp_path / "run"))
    with Server(order, tmp_path, little_room) as server, SocketSeatLink(server.seat("a")) as a:
        a.join()
        with pytest.raises(DiskFullError, match="make room"):
            for tick in range(2000):
                a.act(tick, AHEAD)
        assert server.wait() == WorldExitCode.DISK_FULL
        assert "DiskFullError" in server.errors()
    journal = read_whole(tmp_path / "run" / JOURNAL)
    assert not journal.torn
    assert sum(isinstance(record, Ticked) for record in journal.records) > 100


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"listen": "tcp://0.0.0.0:0"}, "ConfigError: tcp://0.0.0.0:0 can be reached from other machines"),
        ({"town": "atlantis"}, "TownError: unknown town 'atlantis'"),
    ],
)
def test_an_order_that_cannot_be_used_is_said_in_a_line(tmp_path, changes, words):
    with Server(stand_in_order(tmp_path, **changes), tmp_path) as server:
        assert server.wait() == 2
        told = server.errors()
    assert words in told
    assert told.count("\n") == 1


def test_a_journal_of_another_world_is_not_gone_on_with(tmp_path):
    order = stand_in_order(tmp_path, run=str(tmp_path / "run"))
    with Server(order, tmp_path) as server:
        server.status()
    with Server(replace(order, seed=order.seed + 1), tmp_path) as server:
        assert server.wait() == 2
        assert "its seed is '3', not '4'" in server.errors()


def test_what_is_no_order_is_refused(tmp_path, capfd):
    assert main([]) == 2
    assert main([str(tmp_path / "missing")]) == 2
    assert "expected an order to a process of wcsim" in capfd.readouterr().err


def test_clients_of_other_machines_need_a_key_that_the_server_knows(tmp_path):
    keys, others = tmp_path / "keys", tmp_path / "others"
    create_missing_keys(keys, ("far",))
    create_missing_keys(others, ("far",))
    stranger, mistaken = tmp_path / "stranger", tmp_path / "mistaken"
    for folder, server_of, client_of in ((stranger, keys, others), (mistaken, others, keys)):
        create_missing_keys(folder, ("far",))
        (folder / "server.public").write_bytes((server_of / "server.public").read_bytes())
        (folder / "clients" / "far.secret").write_bytes((client_of / "clients" / "far.secret").read_bytes())
    order = stand_in_order(tmp_path, listen="tcp://127.0.0.1:*", keys=str(keys), rules=BOTH)
    with Server(order, tmp_path) as server:
        far = server.seat("far", endpoint=server.status().listening)
        for folder, told in ((stranger, "does not know the public key"), (mistaken, "is not that of this server")):
            with (
                SocketSeatLink(replace(far, keys=str(folder))) as link,
                pytest.raises(AccessError, match=told) as refused,
            ):
                link.join()
            assert f"{folder}" in str(refused.value) and "code" not in str(refused.value)
        with SocketSeatLink(far) as link, pytest.raises(AccessError, match=r"needs a key; .*--keys FOLDER"):
            link.join()  # no keys at all
        with SocketSeatLink(replace(far, keys=str(keys))) as far_link, SocketSeatLink(server.seat("near")) as near:
            frames = driven([far_link, near], 5)
            assert [seen.tick for seen in frames] == [5, 5]
            pictures = [seen.sensors.cameras[0].depth_m for seen in frames]
            assert [picture[0, 0] for picture in pictures] == [5.0, 5.0]
            assert pictures[0].base is not None


def has_ipv6() -> bool:
    """Whether this machine can be reached by itself at ::1."""
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_addresses_of_ipv6_can_be_listened_at_and_joined(tmp_path):
    keys = tmp_path / "keys"
    create_missing_keys(keys, ("far",))
    with Server(stand_in_order(tmp_path, listen="tcp://[::1]:*", keys=str(keys)), tmp_path) as server:
        address = server.status().listening
        assert address.startswith("tcp://[::1]:")
        with SocketSeatLink(server.seat("far", endpoint=address, keys=str(keys))) as link:
            assert driven([link], 2)[0].tick == 2


def test_the_server_tells_its_clients_what_world_it_is(tmp_path):
    with Server(stand_in_order(tmp_path), tmp_path) as server, SocketSeatLink(server.seat("a")) as a:
        told: list[m.Welcome] = []
        a._welcomed = lambda welcome, then=a._welcomed: (told.append(welcome), then(welcome))
        a.join()
    assert (told[0].town, told[0].config_json) == ("nowhere", server.order.config.model_dump_json())
    assert Path(told[0].ring).name == "seat-0"
    assert encode_json_line(server.order)

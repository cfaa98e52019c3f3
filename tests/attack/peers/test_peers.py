"""A real world process, an honest client in it, and a peer that reads its files, breaks it or lies about its name."""

import math
import os
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.attack.peers.messages import hostile_request
from tests.attack.peers.peers import Attacker, a_join, real_order, refusal
from tests.attack.peers.wire import shapes
from tests.server.servers import AHEAD, Server, stand_in_order
from tests.support.samples import write_recording
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import ServerRules
from wcsim.server.transport.keys import create_missing_keys
from wcsim.types import ClientSnapshot, Joystick, SeatSpec, StartSpec
from wcsim.users.profiles import filter_user_file_names

AHEAD_A_LITTLE = Joystick(0.0, 0.05)  # within the dead band: the street stays the same
NAN, INF = math.nan, math.inf
SOUND = StartSpec(p_W_m=(0.0, 0.0), yaw_rad=0.0, goal_W_m=(0.0, 0.0))
STARTS = [replace(SOUND, p_W_m=place) for place in ((NAN, NAN), (INF, 0.0), (1e300, -1e300), (9e5, 9e5))]
STARTS += [replace(SOUND, goal_W_m=(NAN, 0.0)), replace(SOUND, yaw_rad=NAN)]


class Town:
    """A world process with an honest client in it."""

    def __init__(self, server: Server, honest: SocketSeatLink, network: str) -> None:
        self.server, self.honest, self.network = server, honest, network
        self.seen = honest.join()

    def goes_on(self, ticks: int = 2) -> bool:
        """Whether the honest client drives on as if nothing had happened."""
        before = self.seen.tick
        for _ in range(ticks):
            self.seen = self.honest.act(self.seen.tick, AHEAD)
        return self.seen.tick == before + ticks and self.server.process.poll() is None


@pytest.fixture(scope="module")
def town(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Town]:
    folder = tmp_path_factory.mktemp("town")
    with Server(real_order(corner, folder), folder) as server:
        network = server.status().listening
        with SocketSeatLink(server.seat("honest")) as honest:
            yield Town(server, honest, network)


@pytest.mark.parametrize("local", [False, True], ids=["network", "local"])
@pytest.mark.parametrize("protocol", [m.PROTOCOL, 99])
def test_a_join_names_no_file_of_the_server(town: Town, tmp_path: Path, local: bool, protocol: int) -> None:
    secret = tmp_path / "secret"
    secret.write_text("swordfish\n", encoding="utf-8")
    endpoint = town.server.order.endpoint if local else town.network
    told = set()
    for path in (secret, tmp_path / "missing", tmp_path):
        with Attacker(endpoint) as peer:
            failure = refusal(peer.say(a_join(SeatSpec(profile=f"recorded:{path}"), protocol=protocol)))
        assert "swordfish" not in failure.message and str(tmp_path) not in failure.message
        told.add(failure.message)
    assert len(told) == 1  # not even whether there is such a file
    assert town.goes_on()


def test_a_recording_that_the_world_was_started_with_is_replayed(corner: Path, tmp_path: Path) -> None:
    file = tmp_path / "hand.csv"
    write_recording(file, np.arange(0.0, 5.0, 0.1), np.full((50, 2), [0.0, 0.7]))
    profile = f"recorded:{file}"
    rules = ServerRules(capacity=1, expected=1, recordings=filter_user_file_names(["competent", profile]))
    with Server(real_order(corner, tmp_path, rules=rules), tmp_path) as server:
        network = server.status().listening
        with SocketSeatLink(server.seat("own", endpoint=network, spec=SeatSpec(profile=profile))) as seat:
            first = seat.join()
            assert seat.act(first.tick, AHEAD).user.y == pytest.approx(0.7)


def test_no_join_ends_or_hangs_the_world(town: Town, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    profiles = ("recorded:\0", f"recorded:{pipe}", "recorded:/dev/zero", "\x1b[31m", "")
    specs = [SeatSpec(start=start) for start in STARTS]
    specs += [SeatSpec(profile=profile) for profile in profiles]
    specs += [SeatSpec(max_steps=steps) for steps in (0, -7, 1_000_001, (1 << 63) - 1)]
    for endpoint in (town.network, town.server.order.endpoint):
        for spec in specs:
            with Attacker(endpoint) as peer:
                peer.shout(a_join(spec))
                while not (told := peer.news(within_ms=50)):
                    assert town.goes_on(1)  # it is let in, or not, after a tick
                assert any(isinstance(reply, m.Failure) for reply in told)
    assert town.goes_on()
    assert town.server.status().members == ("honest",)


def test_a_start_is_chosen_on_the_worlds_own_machine_only(town: Town) -> None:
    x, y, _ = town.seen.plant.p_WB_m.tolist()
    start = StartSpec(p_W_m=(x + 3.0, y), yaw_rad=0.0, goal_W_m=(x, y))
    with Attacker(town.network) as peer:
        assert "own machine may choose its start" in refusal(peer.say(a_join(SeatSpec(start=start)))).message
    with ThreadPoolExecutor() as pool:
        with SocketSeatLink(town.server.seat("second", spec=SeatSpec(start=start))) as second:
            joining = pool.submit(second.join)
            driving = pool.submit(town.goes_on, 1)
            while not joining.done():  # as soon as it is in, the other's tick waits for it
                wait((joining, driving), return_when=FIRST_COMPLETED)
                if driving.done() and not joining.done():
                    assert driving.result()
                    driving = pool.submit(town.goes_on, 1)
            assert joining.result().plant.p_WB_m[0] == pytest.approx(x + 3.0, abs=0.05)
        assert driving.result()
    assert town.goes_on()


def test_a_name_is_a_plain_word(town: Town) -> None:
    for name in ("", "..", ".x", "a b", "a\nb", "\x1b[31mred", "../../x", "x" * 65, "[bold]", "ä"):
        with Attacker(town.network) as peer:
            failure = refusal(peer.say(a_join(name=name)))
        assert failure.error == "ProtocolError" and "\x1b" not in failure.message and "\n" not in failure.message
    assert town.goes_on()


def test_a_connection_has_one_seat(town: Town) -> None:
    with Attacker(town.network) as peer:
        first, second = a_join(name="one"), a_join(name="two")
        peer.shout(first)
        assert refusal(peer.say(second)).error == "SeatTakenError"
        assert isinstance(peer.say(m.Leave(first.session))[-1], m.Bye)
    assert town.goes_on()


def test_nobody_waits_for_a_client_that_is_not_heard_any_more(tmp_path: Path) -> None:
    rules = ServerRules(capacity=2, expected=2, gather_s=60.0, lease_s=1e6, notice_s=60.0)
    with Server(stand_in_order(tmp_path, rules=rules), tmp_path) as server, ThreadPoolExecutor() as pool:
        server.status()
        with SocketSeatLink(server.seat("honest")) as honest, Attacker(server.order.endpoint) as peer:
            joining = pool.submit(honest.join)
            peer.shout(a_join(name="mad"))
            seen = joining.result()
            for _ in range(30):
                peer.shout(b"garbage")
            assert honest.act(seen.tick, AHEAD).tick == seen.tick + 1
        assert server.process.poll() is None


def test_an_empty_claim_takes_no_seat_of_another_empty_claim(tmp_path: Path) -> None:
    rules = ServerRules(capacity=2, expected=2, gather_s=60.0, notice_s=60.0)
    order = stand_in_order(tmp_path, rules=rules)
    with Server(order, tmp_path) as server, Attacker(order.endpoint) as one, Attacker(order.endpoint) as other:
        server.status()
        one.shout(a_join(name="one", claim=b""))
        other.shout(a_join(name="other", claim=b""))
        welcomes = [peer.hear()[0] for peer in (one, other)]
        assert [type(reply).__name__ for reply in welcomes] == ["Welcome", "Welcome"]
        assert {getattr(reply, "seat", None) for reply in welcomes} == {0, 1}


def test_a_client_is_known_by_the_name_of_its_key_and_a_key_can_be_taken_back(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    create_missing_keys(keys, ("ann", "ben"))
    rules = ServerRules(capacity=4, expected=3, gather_s=60.0, notice_s=60.0)
    order = stand_in_order(tmp_path, rules=rules, listen="tcp://127.0.0.1:*", keys=str(keys))
    with Server(order, tmp_path) as server:
        network = server.status().listening
        with (
            Attacker(network, keys, "ann") as one,
            Attacker(network, keys, "ann") as two,
            Attacker(network, keys, "ben") as three,
        ):
            for peer, name in ((one, "ben"), (two, "ann.2"), (three, "ann.3")):
                peer.shout(a_join(name=name))
            for peer in (one, two, three):
                peer.hear()
            assert sorted(server.status(lambda now: len(now.members) == 3).members) == ["ann", "ann.2", "ben"]
        (keys / "clients" / "ann.public").unlink()
        with Attacker(network, keys, "ben") as peer:
            assert peer.say(m.Beat(b"x" * 16, 0))
        with Attacker(network, keys, "ann") as peer:
            peer.shout(m.Beat(b"x" * 16, 0))
            assert not peer.answers(within_ms=2000)


def test_what_strangers_say_does_not_grow_the_world(tmp_path: Path) -> None:
    order = stand_in_order(tmp_path, rules=ServerRules(capacity=1, expected=1, notice_s=60.0))
    with Server(order, tmp_path) as server, SocketSeatLink(server.seat("honest")) as honest:
        server.status()
        seen = honest.join()
        for _ in range(50):
            seen = honest.act(seen.tick, AHEAD)
        before_mb = server.status().rss_mb
        for _ in range(40):
            with Attacker(order.endpoint) as peer:
                for _ in range(50):
                    peer.shout(m.Leave(os.urandom(16)))
                peer.hear()
                for _ in range(19):
                    peer.shout(m.Leave(os.urandom(8000)))
                peer.hear()
                for _ in range(5):
                    peer.shout(m.Beat(os.urandom((1 << 20) - 64), 1))
        assert honest.act(seen.tick, AHEAD).tick == seen.tick + 1
        assert server.status().rss_mb - before_mb < 16.0


def _drive(honest: SocketSeatLink, seen: ClientSnapshot) -> ClientSnapshot:
    """As long as a world needs to meet its street, also on the way that is driven among hostile messages."""
    for _ in range(300):
        seen = honest.act(seen.tick, (seen.first or seen).user)
    for _ in range(200):
        seen = honest.act(seen.tick, AHEAD_A_LITTLE)
    return seen


@pytest.mark.proof
def test_fifty_thousand_hostile_messages_leave_the_world_as_large_as_it_was(corner: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    kinds = [shape for shape in shapes() if shape.request]
    (tmp_path / "first").mkdir()
    order = real_order(corner, tmp_path / "first", seats=1)
    with Server(order, tmp_path / "first") as server, SocketSeatLink(server.seat("honest")) as honest:
        _drive(honest, honest.join())  # where nothing is compiled yet, compiling grows the first world
    with Server(real_order(corner, tmp_path, seats=1), tmp_path) as server:  # a guest who stays would hold it
        network = server.status().listening
        with SocketSeatLink(server.seat("honest")) as honest:
            seen = _drive(honest, honest.join())
            before_mb = server.status().rss_mb
            for number in range(2000):
                with Attacker(network if number % 2 else server.order.endpoint) as peer:
                    for _ in range(25):
                        peer.shout(hostile_request(kinds, rng, 0, seen.tick))
                    peer.answers(within_ms=200)
                if number % 10 == 0:
                    seen = honest.act(seen.tick, AHEAD_A_LITTLE)
            assert server.status().members == ("honest",)
            assert server.status().rss_mb - before_mb < 16.0
        assert server.process.poll() is None

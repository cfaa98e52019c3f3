"""Messages of hostile peers: read alone, and said to a server that has an honest client."""

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.barrier.fake_world import FakeWorld
from tests.attack.outcomes import Case
from tests.attack.peers.wire import each_field, shapes, spoilt
from tests.attack.scenarios.twists import Rng, draws, integer, pick
from tests.server.protocol.desk import join_of
from tests.support.worlds import quick_config
from wcsim.server.host.opening import ServerParts
from wcsim.server.host.process import _ProcessWatch, _ServerLoop
from wcsim.server.host.status import StatusPipeWriter
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import ServerRules
from wcsim.server.protocol.members import REMEMBERED
from wcsim.server.protocol.server_core import ServerCore
from wcsim.server.specs import WorldBuildSpec, WorldProcessSpec
from wcsim.server.transport.sockets import LOCAL, REMOTE, IncomingMessage, PeerLimits
from wcsim.types import SeatSpec

HONEST = LOCAL + b"honest"
SESSION = b"h" * m.SESSION_BYTES


def cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """Spoilt messages of every kind, read."""
    del work
    kinds = shapes()
    for number, rng in draws(count, seed):
        shape = pick(rng, kinds)
        yield read_case(f"{shape.kind} {number}", shape.request, spoilt(shape, rng))


def field_cases() -> Iterator[Case]:
    """Every field of every message times every nasty value, read."""
    for shape in shapes():
        for place, value, data in each_field(shape):
            yield read_case(f"{shape.kind}{list(place)} = {str(value)[:40]!r}", shape.request, data)


def read_case(name: str, request: bool, data: bytes) -> Case:
    """One message, read."""
    decode = m.decode_request if request else m.decode_reply

    def feed() -> bool:
        message = decode(data)
        again = decode(m.encode_message(message))
        return _same(again, message) and all(
            _sane(leaf) for leaf in _leaves(msgspec.msgpack.decode(m.encode_message(message)))
        )

    return Case(area="messages", name=name, feed=feed)


class Besieged:
    """A server in this process, through its own loop, with an honest client on seat 0 and the attacker's door open."""

    def __init__(self, work: Path) -> None:
        work.mkdir(parents=True, exist_ok=True)
        config = quick_config()
        rules = ServerRules(capacity=3, lease_s=1e9, notice_s=1e9)
        order = WorldProcessSpec(town="x", config=config, seed=1, rules=rules, endpoint="", ring=str(work))
        world = FakeWorld(WorldBuildSpec(town="x", config=config, seed=1), (None,) * 3, 1)
        self.core = ServerCore(rules)
        self.doors = _Doors()
        self._lifelines = _ProcessWatch()
        opened = ServerParts(world=world, core=self.core, journal=None)
        self.loop = _ServerLoop(order, opened, self.doors, self._lifelines, StatusPipeWriter(-1))  # type: ignore[arg-type]
        self.world = world
        self._said = 0
        self.say(HONEST, m.encode_message(_honest_join()))

    def say(self, peer: bytes, data: bytes, key: str | None = None) -> None:
        """A message comes in, and is dealt with."""
        self.doors.inbox.append(IncomingMessage(peer, data, key))
        self.loop._turn()

    def attack(self, data: bytes) -> bool:
        """Say one hostile message; whether the honest client then drives on, through exactly one tick."""
        self._said += 1
        if self._said % 1000 == 0:  # no client sends as many messages a second as the honest one here
            self.loop._peers = PeerLimits()
        peer = (REMOTE if self._said % 2 else LOCAL) + b"evil-%d" % (self._said // 10)
        self.doors.sent.clear()
        self.say(peer, data)
        answers = [part for to, parts in self.doors.sent if to == peer for part in parts]
        for answer in answers:
            m.decode_reply(answer)
        ok = self._honest_step()  # lets in who waits
        self._send_home()
        return ok and self._bounded()

    def close(self) -> None:
        """Watch nothing any more."""
        self._lifelines.close()

    def _send_home(self) -> None:
        """Seats that the attacker got are given back, as when its lease is over."""
        for entry in [*self.core.roster.members, *self.core.roster.pending]:
            if entry.session != SESSION:
                self.say(entry.peer, m.encode_message(m.Leave(entry.session)))

    def _honest_step(self) -> bool:
        mine = self.core.roster.member(SESSION)
        if mine is None or [entry.seat for entry in self.core.roster.members] != [0]:
            return False
        before = self.world.snapshot.tick
        self.say(HONEST, m.encode_message(m.Act(SESSION, self.core.epoch, self.core.tick, mine.life, 0.5, 0.5)))
        return self.world.snapshot.tick == before + 1 == self.core.tick

    def _bounded(self) -> bool:
        roster = self.core.roster
        lists = (roster.retired, roster.forgotten)
        return not roster.pending and all(len(item) <= REMEMBERED and all(len(s) == 16 for s in item) for item in lists)


def siege_cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """Hostile requests, one after the other, to one server."""
    kinds = [shape for shape in shapes() if shape.request]
    siege = Besieged(work / f"siege-{seed}-{os.getpid()}")
    try:
        for number, rng in draws(count, seed):
            data = hostile_request(kinds, rng, siege.core.epoch, siege.core.tick)
            yield Case(area="server", name=f"{seed} {number}: {data[:60]!r}", feed=lambda data=data: siege.attack(data))
    finally:
        siege.close()


def hostile_request(kinds: list[Any], rng: Rng, epoch: int, tick: int) -> bytes:
    """A request to a server at about this tick: spoilt, or sound but for what it says."""
    way = integer(rng, 4)
    if way == 0:
        return spoilt(pick(rng, kinds), rng)
    if way == 1:  # one that is let in, but for what it asks
        profile = pick(rng, ("inattentive", "ataxic", "recorded:/etc/passwd", "recorded:\0", "x" * 40))
        steps = pick(rng, (1, 0, 1 << 40, 1_000_000))
        join = msgspec.structs.replace(_honest_join(), session=rng.bytes(16), claim=rng.bytes(4), seat=m.ANY_SEAT)
        spec = SeatSpec(profile=profile, max_steps=steps)
        seat = pick(rng, (m.ANY_SEAT, 0, 1, 2, 3, -2, 99))
        return m.encode_message(msgspec.structs.replace(join, spec=spec, seat=seat, pid=integer(rng, 1 << 22)))
    session = pick(rng, (SESSION[:15], rng.bytes(16), rng.bytes(16)))
    epoch, tick = epoch + int(rng.integers(-1, 2)), tick + int(rng.integers(-2, 3))
    said: tuple[m.Request, ...] = (
        m.Act(session, epoch, tick, 0, float(rng.normal()), math.nan),
        m.Respawn(session, epoch, tick, 0),
        m.Rebuild(session, epoch, 7),
        m.Beat(session, integer(rng, 1 << 62)),
        m.Leave(session),
        m.Leave(rng.bytes(integer(rng, 8000))),
    )
    return m.encode_message(pick(rng, said))


def _honest_join() -> m.Join:
    return join_of(0, session=SESSION, claim=b"honest", name="honest")


class _Doors:
    """The doors' part in a server loop, without sockets."""

    def __init__(self) -> None:
        self.inbox: list[IncomingMessage] = []
        self.sent: list[tuple[bytes, list[bytes]]] = []

    def watch(self, fileno: int) -> None:
        del fileno

    def wait(self, most_ms: int) -> bool:
        del most_ms
        return False

    def messages(self) -> Iterator[IncomingMessage]:
        while self.inbox:
            yield self.inbox.pop(0)

    def take_lost(self) -> set[bytes]:
        return set()

    def send(self, peer: bytes, parts: list[bytes]) -> None:
        self.sent.append((peer, [bytes(part) for part in parts]))


def _same(one: Any, other: Any) -> bool:
    return type(one) is type(other) and m.encode_message(one) == m.encode_message(other)


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from (key, *_leaves(item))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item)
    else:
        yield value


def _sane(leaf: Any) -> bool:
    if isinstance(leaf, float):
        return math.isfinite(leaf)
    if isinstance(leaf, int):
        return abs(leaf) < 1 << 63
    return True

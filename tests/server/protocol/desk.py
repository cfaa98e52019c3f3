"""A server core and what tests say to it, in a few words."""

from typing import TypeVar

from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import (
    Effect,
    Event,
    MessageReceivedEvent,
    SendMessageEffect,
    ServerRules,
    TimePassedEvent,
    WorldSteppedEvent,
)
from wcsim.server.protocol.server_core import ServerCore
from wcsim.types import SeatSpec

Kind = TypeVar("Kind")


def session_of(who: int) -> bytes:
    """The session of a client."""
    return bytes([who]) * m.SESSION_BYTES


def join_of(who: int, **other: object) -> m.Join:
    """What a client says first; `other` replaces fields."""
    fields: dict[str, object] = {
        "protocol": m.PROTOCOL,
        "schema": m.hash_message_schema(),
        "config": "",
        "session": session_of(who),
        "claim": bytes([who]),
        "seat": who,
        "name": f"c{who}",
        "spec": SeatSpec(),
    }
    return m.Join(**{**fields, **other})  # type: ignore[arg-type]


class Desk:
    """A server, of two seats unless told otherwise, with `members` clients in it; every call returns the effects."""

    def __init__(self, members: int = 2, **rules: float) -> None:
        told = {"capacity": 2, "expected": max(1, members), "config": "cfg", **rules}
        self.core = ServerCore(ServerRules(**told))  # type: ignore[arg-type]
        self.now_s = 5000.0
        for who in range(members):
            self.say(who, join_of(who))

    def feed(self, event: Event) -> list[Effect]:
        """Let something happen now."""
        return self.core.handle(event, self.now_s)

    def say(self, who: int, message: m.Request) -> list[Effect]:
        """A client says something."""
        return self.feed(MessageReceivedEvent(bytes([who]), message))

    def act(self, who: int, tick: int = 0, x: float = 0.5, y: float = 0.0) -> list[Effect]:
        """A client acts."""
        return self.say(who, m.Act(session_of(who), 0, tick, 0, x, y))

    def step(self, tick: int = 0) -> list[Effect]:
        """Everybody acts, the world is done."""
        acted = [self.act(member.session[0], tick) for member in list(self.core.roster.members)]
        return acted[-1] + self.feed(WorldSteppedEvent(tick + 1))

    def wait(self, seconds: float) -> list[Effect]:
        """Time passes."""
        self.now_s += seconds
        return self.feed(TimePassedEvent())


def only(effects: list[Effect], kind: type[Kind], peer: int | None = None) -> Kind:
    """The one message, or the one effect, of a kind; to a peer, when it is named."""
    found: list[Kind] = [e for e in effects if isinstance(e, kind)]
    sent = [e for e in effects if isinstance(e, SendMessageEffect) and (peer is None or e.peer == bytes([peer]))]
    messages: list[object] = [e.message for e in sent]
    found += [message for message in messages if isinstance(message, kind)]
    assert len(found) == 1, f"{effects}"
    return found[0]


def failure(effects: list[Effect]) -> tuple[str, str]:
    """The name and the text of the error that a client is told."""
    told = only(effects, m.Failure)
    return told.error, told.message

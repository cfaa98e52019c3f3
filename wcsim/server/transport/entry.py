"""Who is heard by a server, and what may be asked from where: beside the world, or on another machine."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass

import msgspec

from wcsim.errors import ProtocolError
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import Peer

MAX_PEERS = 64
MESSAGES_PER_S, BURST = 10_000.0, 10_000.0  # a sole master in a world that costs nothing sends 2,500 (measured)
MOST_FAULTS = 20  # messages that could not be read, or came too fast, after which a peer is not heard any more


@dataclass(slots=True)
class _Account:
    tokens: float
    heard_s: float
    faults: int = 0


class PeerLimits:
    """Accounts of all peers."""

    def __init__(self) -> None:
        self._accounts: dict[Peer, _Account] = {}

    def hears(self, peer: Peer, now_s: float, members: Callable[[], Container[Peer]]) -> bool | None:
        """Whether a message of a peer may be read now; None when nothing shall even be answered.

        Args:
            peer: Whose message.
            now_s: The time.
            members: Tells the peers whose accounts are kept whatever comes.
        """
        account = self._accounts.get(peer)
        if account is None:
            account = self._opened(peer, now_s, members)
            if account is None:
                return None
        if account.faults >= MOST_FAULTS:
            return None
        account.tokens = min(BURST, account.tokens + MESSAGES_PER_S * (now_s - account.heard_s)) - 1.0
        account.heard_s = now_s
        if account.tokens < 0.0:
            account.tokens = 0.0
            account.faults += 1
            return False
        return True

    def fault(self, peer: Peer) -> None:
        """A message of the peer could not be read."""
        account = self._accounts.get(peer)
        if account is not None:
            account.faults += 1

    def is_shut_out(self, peer: Peer) -> bool:
        """Whether nothing of the peer is heard any more."""
        account = self._accounts.get(peer)
        return account is not None and account.faults >= MOST_FAULTS

    def _opened(self, peer: Peer, now_s: float, members: Callable[[], Container[Peer]]) -> _Account | None:
        if len(self._accounts) >= MAX_PEERS:
            kept = members()
            strangers = [other for other in self._accounts if other not in kept]
            if not strangers:
                return None
            # Whoever was silent for longest goes, so that a crowd of strangers cannot keep a client out.
            del self._accounts[min(strangers, key=lambda other: self._accounts[other].heard_s)]
        self._accounts[peer] = _Account(tokens=BURST, heard_s=now_s)
        return self._accounts[peer]


def at_the_door(join: m.Join, remote: bool, key: str | None) -> m.Join:
    """A join as the server takes it from this door.

    A client with a key is known by the key's name, or by that with a dot and a word after it (`ann.2`).

    Args:
        join: What the client says.
        remote: Whether it came over the network.
        key: The name of the key that it has shown; None where none is asked for.

    Raises:
        ProtocolError: It asks over the network for what only the world's own machine may choose.
    """
    if key and join.name != key and not join.name.startswith(f"{key}."):
        join = msgspec.structs.replace(join, name=key)
    if not remote:
        return join
    if join.spec.start is not None:
        raise ProtocolError("only a client on the world's own machine may choose its start; leave it out")
    return msgspec.structs.replace(join, pid=0)

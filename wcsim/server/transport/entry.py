"""What a client may ask for depends on where it stands: beside the world, or on another machine."""

from __future__ import annotations

import msgspec

from wcsim.errors import ProtocolError
from wcsim.server.protocol import messages as m


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

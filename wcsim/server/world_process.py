"""A world in a process of its own: `python -m wcsim.server.world_process ENDPOINT`, started by `ProcessLink`.

One request, one reply, over a ZeroMQ pair on an ipc socket in a folder that only its owner can enter. The process
ends when it is told to, or when its parent has gone.
"""

from __future__ import annotations

import os
import signal
import sys

import zmq

from wcsim.config import RunConfig
from wcsim.errors import ProtocolError, WcsimError
from wcsim.server import messages as m
from wcsim.server.link import LocalLink, WorldOrder

POLL_MS = 1000


def main() -> int:
    """Serve one client until it leaves."""
    parent = os.getppid()
    # Ctrl-C at a terminal reaches the whole group; what it means is for the client to say, who still needs the world.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with zmq.Context() as context, context.socket(zmq.PAIR) as socket:
        socket.setsockopt(zmq.LINGER, 1000)
        socket.setsockopt(zmq.MAXMSGSIZE, m.MAX_MESSAGE_BYTES)
        socket.connect(sys.argv[1])
        link: LocalLink | None = None
        try:
            while os.getppid() == parent:
                if not socket.poll(POLL_MS):
                    continue
                request = m.decode_request(socket.recv())
                if isinstance(request, m.Leave):
                    socket.send(m.encode(m.Bye()))
                    break
                try:
                    link, reply = _answer(link, request)
                except WcsimError as error:
                    reply = m.failure_of(error)
                socket.send(m.encode(reply))
        finally:
            if link is not None:
                link.close()
    return 0


def _answer(link: LocalLink | None, request: m.Request) -> tuple[LocalLink, m.Reply]:
    if isinstance(request, m.Open):
        if request.protocol != m.PROTOCOL:
            raise ProtocolError(f"client speaks protocol {request.protocol}, world {m.PROTOCOL}; use one version")
        link = LocalLink(
            WorldOrder(
                town=request.town,
                config=RunConfig.model_validate_json(request.config_json),
                seat=request.seat,
                seed=request.seed,
                run=request.run,
                hook=request.hook,
            )
        )
        return link, m.Frame(link.join())
    if link is None:
        raise ProtocolError(f"{type(request).__name__} came before Open; open a world first")
    if isinstance(request, m.Act):
        return link, m.Frame(link.act(request.tick, m.joystick_of(request)))
    if isinstance(request, m.Rebuild):
        return link, m.Frame(link.rebuild(request.seed))
    return link, m.Frame(link.respawn() if isinstance(request, m.Respawn) else link.join())


if __name__ == "__main__":
    raise SystemExit(main())

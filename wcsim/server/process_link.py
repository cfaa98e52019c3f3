"""A link to a world in a child process of its own; used when a world already lives in this process."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import weakref
from pathlib import Path
from types import TracebackType
from typing import Self

import zmq

from wcsim.errors import LinkClosedError, LinkTimeoutError, ProtocolError
from wcsim.server import messages as m
from wcsim.server.link import WorldOrder
from wcsim.types import ClientSnapshot, Joystick

OPEN_TIMEOUT_S = 300.0  # building a town's mesh for the first time and warming its traffic up
ANSWER_TIMEOUT_S = 120.0
POLL_MS = 200


class ProcessLink:
    """A world with one seat in a child process."""

    def __init__(self, order: WorldOrder) -> None:
        """Start the process and open the world; raises what opening it in this process would raise."""
        folder = tempfile.TemporaryDirectory(prefix="wcsim-")
        endpoint = f"ipc://{Path(folder.name) / 'world'}"
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PAIR)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.MAXMSGSIZE, m.MAX_MESSAGE_BYTES)
        self._socket.bind(endpoint)
        self._child = subprocess.Popen(
            [sys.executable, "-m", "wcsim.server.world_process", endpoint], stdin=subprocess.DEVNULL
        )
        # Also when nobody closes the link: ZeroMQ would else wait for ever at the end of a process whose world died.
        self._end = weakref.finalize(self, _end, self._socket, self._context, self._child, folder)
        request = m.Open(
            protocol=m.PROTOCOL,
            town=order.town,
            config_json=order.config.model_dump_json(),
            seat=order.seat,
            seed=order.seed,
            run=order.run and str(Path(order.run).absolute()),
            hook=order.hook,
        )
        try:
            self._first = self._ask(request, OPEN_TIMEOUT_S)
        except BaseException:
            self.close()
            raise

    def join(self) -> ClientSnapshot:
        """See `WorldLink.join`."""
        return self._ask(m.Join(), ANSWER_TIMEOUT_S)

    def act(self, tick: int, joystick: Joystick) -> ClientSnapshot:
        """See `WorldLink.act`."""
        return self._ask(m.Act(tick=tick, x=joystick.x, y=joystick.y), ANSWER_TIMEOUT_S)

    def respawn(self) -> ClientSnapshot:
        """See `WorldLink.respawn`."""
        return self._ask(m.Respawn(), ANSWER_TIMEOUT_S)

    def rebuild(self, seed: int) -> ClientSnapshot:
        """See `WorldLink.rebuild`."""
        return self._ask(m.Rebuild(seed=seed), OPEN_TIMEOUT_S)

    def close(self) -> None:
        """Ask the process to end, wait for it, and end it when it does not; a second call does nothing."""
        self._end()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, request: m.Request, timeout_s: float) -> ClientSnapshot:
        if not self._end.alive:
            raise LinkClosedError("this link is closed; make a new one")
        self._wait(zmq.POLLOUT, timeout_s)
        self._socket.send(m.encode(request))
        self._wait(zmq.POLLIN, timeout_s)
        reply = m.decode_reply(self._socket.recv())
        if isinstance(reply, m.Failure):
            m.raise_failure(reply)
        if not isinstance(reply, m.Frame):
            raise ProtocolError(f"the world answered {type(reply).__name__}; expected a frame")
        return reply.client

    def _wait(self, event: int, timeout_s: float) -> None:
        """Until the socket can send or receive; watches the child, because a ZeroMQ peer that dies is silent."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self._socket.poll(POLL_MS, event):
                return
            if self._child.poll() is not None and not self._socket.poll(0, event):
                raise LinkClosedError(
                    f"the world process ended with code {self._child.returncode}; its messages above say why"
                )
        self.close()  # a late answer must not be taken for the answer to the next question
        raise LinkTimeoutError(f"the world process did not answer within {timeout_s:g} s; open another link")


def _end(
    socket: zmq.Socket[bytes],
    context: zmq.Context[zmq.Socket[bytes]],
    child: subprocess.Popen[bytes],
    folder: tempfile.TemporaryDirectory[str],
) -> None:
    try:
        socket.send(m.encode(m.Leave()), zmq.NOBLOCK)
        child.wait(timeout=5.0)
    except (zmq.ZMQError, subprocess.TimeoutExpired):
        child.kill()
        child.wait()
    socket.close()
    context.term()
    folder.cleanup()

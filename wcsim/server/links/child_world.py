"""A world in a child process of its own, for one seat or a group; used when a world already lives in this process."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import time
import weakref
from dataclasses import replace
from pathlib import Path

import msgspec

from wcsim.errors import ConfigError, LinkClosedError, LinkTimeoutError
from wcsim.server.links.base import SeatGroup
from wcsim.server.links.socket import SocketSeat
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import Patience
from wcsim.server.protocol.events import Rules
from wcsim.server.specs import SeatRequest, WorldOrder, WorldSpec, WorldStatus, of_line, to_line
from wcsim.server.transport.world_folder import RingFolder, endpoint_in, remove_stale_rings
from wcsim.types import SeatSpec

_OPEN_TIMEOUT_S = 300.0  # building a town's mesh for the first time and warming its traffic up
_END_TIMEOUT_S = 5.0
_NEVER_S = 1e12


def private_rules(capacity: int, expected: int) -> Rules:
    """Of a world whose clients are all of one process: nobody can hang or die alone."""
    return Rules(
        capacity=capacity,
        expected=expected,
        gather_s=_NEVER_S,
        lease_s=_NEVER_S,
        tick_lease_s=_NEVER_S,
        notice_s=_NEVER_S,
        recordings=None,
    )


class _WorldChild:
    """A world process that belongs to this one, ready for its clients."""

    def __init__(self, order: WorldOrder) -> None:
        """Start the process and wait for its world; raises what opening it in this process would raise.

        Its first tick waits for all seats.
        """
        remove_stale_rings()
        place = RingFolder()
        self.endpoint = endpoint_in(place.path)
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        server = WorldSpec(
            town=order.town,
            config_json=order.config.model_dump_json(),
            seed=order.seed,
            rules=private_rules(order.seats, order.seats),
            endpoint=self.endpoint,
            ring=str(place.path / "ring"),
            run=order.run and str(Path(order.run).absolute()),
            journal=False,
            hook=order.hook,
            status_fd=theirs,
            quiet=True,
        )
        path = place.path / "order.json"
        path.write_bytes(to_line(server))
        command = [sys.executable, "-m", "wcsim.server.host.process", str(path)]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(theirs,))
        os.close(theirs)
        self.close = weakref.finalize(self, _end, self.process, self._pipe, place)
        try:
            self._await_world()
        except BaseException:
            self.close()
            raise

    def require_alive(self) -> None:
        """Raise LinkClosedError when the process has ended."""
        code = self.process.poll()
        if code is not None:
            raise LinkClosedError(f"the world process ended with code {code}; its messages above say why")

    def _await_world(self) -> None:
        deadline_s = time.monotonic() + _OPEN_TIMEOUT_S
        rest = b""
        while time.monotonic() < deadline_s:
            ended = self.process.poll() is not None
            *lines, rest = (rest + self._heard()).split(b"\n")
            if any(_ready(line) for line in lines):
                return
            if ended:
                self.require_alive()
            time.sleep(0.01)
        raise LinkTimeoutError(
            f"the world process has not loaded its world after {_OPEN_TIMEOUT_S:g} s; is the machine busy?"
        )

    def _heard(self) -> bytes:
        try:
            return os.read(self._pipe, 1 << 16)
        except BlockingIOError:
            return b""


class ChildSeat(SocketSeat):
    """A seat of a world process that belongs to this one; notices when that has ended."""

    def __init__(self, child: _WorldChild, spec: SeatSpec, seat: int) -> None:
        self._child = child
        super().__init__(
            SeatRequest(
                endpoint=child.endpoint,
                name=f"chair-{seat}",
                claim=secrets.token_hex(),
                spec=spec,
                seat=seat,
                patience=Patience(reconnect_s=_OPEN_TIMEOUT_S),
            )
        )

    def _pump(self) -> None:
        if not self._socket.poll(0):
            self._child.require_alive()
        super()._pump()

    def _end(self) -> None:
        if self._child.process.poll() is None:
            super()._end()
        else:  # nobody is there to say goodbye
            self._let_go()


class ProcessGroup(SeatGroup):
    """A world process with all its seats; an epoch that begins again is a new process."""

    def __init__(self, order: WorldOrder) -> None:
        """Start the world; raises what opening it in this process would raise."""
        self._order = order
        self._connect(order.seed)

    def close(self) -> None:
        """See `SeatGroup.close`."""
        self.leave()
        self._child.close()
        self.links = ()

    def _renew(self, seed: int) -> None:
        self._child.close()
        self._connect(seed)

    def _connect(self, seed: int) -> None:
        order = self._order
        self._child = _WorldChild(replace(order, seed=seed))
        self.links = [ChildSeat(self._child, order.seat, seat) for seat in range(order.seats)]


def _ready(line: bytes) -> bool:
    """Whether a status line tells of a world; raises the error that one tells of."""
    try:
        return of_line(WorldStatus, line).stage != "loading"
    except ConfigError:
        raise m.error_of(msgspec.json.decode(line, type=m.Failure)) from None


def _end(process: subprocess.Popen[bytes], pipe: int, place: RingFolder) -> None:
    process.terminate()
    try:
        process.wait(_END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    os.close(pipe)
    place.close()

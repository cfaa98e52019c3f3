"""Workers that are nodes of a Ray cluster, as the run sees them: names, pieces that go out, answers that come in."""

from __future__ import annotations

import json
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final

from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, DiskFullError, WorkersError, check_installed
from wcsim.server.workers.cluster_link import LOCAL, LinkSpec, run_link
from wcsim.server.workers.machines import Work, WorkEnd

RAY_LOG, PIECES = "ray.log", "pieces.jsonl"
REACH_S: Final = 5.0
JOIN_S: Final = 90.0
_SILENT_S: Final = 120.0
_CLOSE_S: Final = 30.0
_GIVE_UP_S: Final = 3.0  # for a process that has not joined
_ADDRESS: Final = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):(\d{1,5})")

Say = Callable[[str], object]


class RayWorkers:
    """The CPUs of the nodes of a cluster, each of them a worker.

    Args:
        address: HOST:PORT of its head, or `local` for one that is made here.
        count: Workers of a local one.
        folder: For logs: what Ray says, and a line for each piece.
        say: Told of nodes that come, go, or are refused.
        join_s: So long Ray may take to join, and the first node to answer.

    Raises:
        ConfigError: There is no Ray, or no cluster at that address, or none of its nodes can be used.
    """

    def __init__(self, address: str, count: int, folder: Path, say: Say, join_s: float = JOIN_S) -> None:
        require_address(address)
        folder.mkdir(parents=True, exist_ok=True)
        self._address, self._say, self._folder = address, say, folder
        spec = LinkSpec(address=address, count=count, log=folder / RAY_LOG)
        self._names: tuple[str, ...] = ()
        self._asked = 1  # nodes that have not answered yet
        self._refused: list[str] = []
        self._ended: list[WorkEnd] = []
        self._heard_s = time.monotonic()
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._out: SimpleQueue[bytes | None] = SimpleQueue()
        self._link = context.Process(target=run_link, args=(theirs, spec), name="cluster link", daemon=True)
        self._link.start()
        theirs.close()
        threading.Thread(target=_pass_on, args=(self._out, self._pipe), name="to the cluster link", daemon=True).start()
        try:
            self._join(join_s)
        except BaseException:
            self.close()
            raise

    def names(self) -> tuple[str, ...]:
        """The workers of nodes that may work now. Raises WorkersError when the cluster is lost."""
        return self._names

    def begin(self, worker: str, work: Work) -> None:
        """Give a piece to a node, with what it needs."""
        self._send("begin", (worker, work, work.needs(work.piece)))

    def ended(self, timeout_s: float) -> list[WorkEnd]:
        """What has come back; waits a while for it. Raises WorkersError when the cluster is lost."""
        self._hear(timeout_s)
        found, self._ended = self._ended, []
        for each in found:
            self._note(each)
        return found

    def stop(self, worker: str) -> None:
        """Have the process killed that a worker's piece is in."""
        self._send("stop", worker)

    def close(self) -> None:
        """Leave the cluster; one that was made here ends."""
        self._out.put(None)
        self._pipe.close()
        self._link.join(_CLOSE_S if self._names else _GIVE_UP_S)
        if self._link.is_alive():
            self._link.kill()
            self._link.join()

    def _join(self, join_s: float) -> None:
        """Wait for the first node that may work."""
        until_s = time.monotonic() + join_s
        while not self._names:
            if self._refused and not self._asked:
                raise ConfigError(f"--cluster {self._address}: {'; '.join(self._refused)}")
            if time.monotonic() > until_s:
                raise ConfigError(
                    f"--cluster {self._address}: no node was ready within {join_s:.0f} s; expected a Ray head at "
                    f"that address, a node on this machine and CPUs (`ray start --address={self._address} "
                    f"--num-cpus=N`); Ray's messages are in {self._folder / RAY_LOG}"
                )
            try:
                self._hear(0.2)
            except WorkersError as error:
                raise ConfigError(f"--cluster {self._address}: {error}") from None

    def _hear(self, timeout_s: float) -> None:
        try:
            while self._pipe.poll(timeout_s if not self._ended else 0.0):
                self._heard_s, timeout_s = time.monotonic(), 0.0
                self._take(*self._pipe.recv())
        except (EOFError, OSError):
            if self._ended:  # what has come is kept first
                return
            raise self._lost() from None
        if time.monotonic() - self._heard_s > _SILENT_S:
            raise self._lost()

    def _take(self, word: str, what: Any) -> None:
        if word == "workers":
            self._names, self._asked = what
        elif word == "ended":
            self._ended.append(what)
        elif word == "say":
            self._say(what)
        elif word == "refused node":
            self._refused.append(what)
            self._say(what)
        elif word == "refused":
            raise ConfigError(what)

    def _send(self, word: str, what: Any) -> None:
        """Leave a message to a thread: the link may itself wait for us to read what it sends, and read nothing then."""
        self._out.put(bytes(ForkingPickler.dumps((word, what))))

    def _lost(self) -> WorkersError:
        return WorkersError(
            f"the Ray cluster at {self._address} is lost: start its head again, then continue "
            f"(a training: wcsim resume RUN; a test: --resume); Ray's messages are in {self._folder / RAY_LOG}"
        )

    def _note(self, ended: WorkEnd) -> None:
        """A line for a piece: who was at it, and what came of it. Raises DiskFullError."""
        how = "done" if ended.data is not None else "failed" if ended.error is not None else "lost"
        row = {"key": ended.key, "worker": ended.worker, "how": how, "why": ended.lost, **ended.facts}
        try:
            with (self._folder / PIECES).open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        except OSError as error:
            raise DiskFullError(f"{self._folder / PIECES}: cannot be written ({error.strerror}); make room") from None


def _pass_on(messages: SimpleQueue[bytes | None], pipe: Connection) -> None:
    """Send messages until there is a None, or nobody to hear them: whoever reads the pipe notices that."""
    with suppress(OSError):
        while (message := messages.get()) is not None:
            pipe.send_bytes(message)


def require_address(address: str) -> None:
    """Refuse what is no address of a cluster, or one where nobody answers. Raises ConfigError."""
    found = _ADDRESS.fullmatch(address)
    if address != LOCAL and (found is None or not 0 < int(found[2]) < 1 << 16):
        raise ConfigError(
            f"--cluster {escaped(address, 80)!r}: expected `local`, or HOST:PORT as `ray start --head` prints it, such "
            "as 10.0.0.1:6379"
        )
    check_installed("--cluster needs Ray", "cluster", "ray")
    if found is not None:
        try:
            socket.create_connection((found[1].strip("[]"), int(found[2])), REACH_S).close()
        except OSError as error:
            raise ConfigError(
                f"--cluster {address}: no answer within {REACH_S:g} s ({error.strerror or error}); "
                "start a Ray head there with `ray start --head --port=6379`, and check the firewall"
            ) from None

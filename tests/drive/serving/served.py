"""`wcsim drive` as a process, and a page without a browser."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

Message = dict[str, Any]
PATIENCE_S = 400.0  # on a busy machine; nothing is asserted of how long it takes


def served(town: Path | None, *words: str) -> AbstractContextManager[tuple[str, subprocess.Popen[str]]]:
    """Host and port of a served drive, and its process; without a town the words say what is driven."""
    return serving("drive", *([] if town is None else [str(town), "--seed", "4"]), *words)


@contextmanager
def serving(*words: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Host and port of a page that a command serves, and its process."""
    command = [sys.executable, "-m", "wcsim", *words, "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert process.stdout is not None
        found, line = None, " "
        while found is None and line:
            line = process.stdout.readline()
            found = re.search(r"http://([^/]+)/", line)
        assert found is not None, "it ended without an address"
        yield found[1], process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                process.wait(30)
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


class FakePage:
    """Speaks as the page does: acknowledges pictures, and sends its stick with every line that it reads."""

    def __init__(self, address: str) -> None:
        self._held = ExitStack()
        opened = connect(f"ws://{address}/socket", origin=f"http://{address}")
        self.socket: ClientConnection = self._held.enter_context(opened)
        self.stick, self.overrule, self.away, self.silent = (0.0, 0.0), False, False, False
        self.pictures, self.heard = 0, []  # type: int, list[dict[str, Any]]

    def say(self, say: str, **more: object) -> None:
        self.socket.send(json.dumps({"say": say, **more}))

    def until(self, wanted: Callable[[Message], bool], patience_s: float = PATIENCE_S) -> Message:
        """The first message that is wanted."""
        end_s = time.monotonic() + patience_s
        while time.monotonic() < end_s:
            if not self.silent:
                self.say("stick", x=self.stick[0], y=self.stick[1], overrule=self.overrule, away=self.away)
            with suppress(TimeoutError):
                message = self._read()
                if message is not None and wanted(message):
                    return message
        raise AssertionError(f"did not come; the last were {self.heard[-3:]}")

    def _read(self) -> Message | None:
        data = self.socket.recv(timeout=0.05)
        if isinstance(data, bytes):
            self.pictures += 1
            self.say("shown", number=int.from_bytes(data[:4], "little"))
            return None
        message: Message = json.loads(data)
        self.heard = [*self.heard[-50:], message]
        return message

    def state(self, wanted: Callable[[Message], bool] = lambda _: True) -> Message:
        return self.until(lambda message: message["say"] == "state" and wanted(message))

    def role(self, *, drives: bool) -> Message:
        return self.until(lambda message: message["say"] == "role" and message["drives"] == drives)

    def drive_off(self) -> Message:
        """Hold the stick ahead, once it has been at rest, till the chair drives."""
        self.stick = (0.0, 0.0)
        self.state(lambda state: not state["let_go"])
        self.stick = (0.0, 1.0)
        return self.state(lambda state: state["speed_mps"] > 0.4)

    def close(self) -> None:
        self._held.close()

    def __enter__(self) -> FakePage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

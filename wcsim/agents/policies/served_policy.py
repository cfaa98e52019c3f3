"""A policy that another process serves on a socket, in whatever language: `tcp:PORT` or `tcp:HOST:PORT`.

The test connects once for each chair, and some times more only to say hello. Every message has four bytes with its
length (little endian) and then that many bytes: one line of JSON, a line feed, and the bytes of the arrays that the
line names, one after the other.

    {"kind": "hello", "actions": [[0.0, 0.0], ...], "arrays": []}     answer: {"name": "mine", "version": "3"}
    {"kind": "reset", "arrays": []}                                   answer: {}
    {"kind": "act", "arrays": [["depth", "uint8", [1, 60, 80]], ...]}  answer: {"action": 40, "warning": false}

Arrays are those of an observation, C-ordered and little endian; `warning` may be missing. An example:
`examples/served_policy.py`.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from wcsim.agents.policy_api import ANSWER_S, SERVED, Observation
from wcsim.core.reading import ANSWER, escaped, parse_json
from wcsim.errors import PolicyError

_PATIENCE_S: Final = 10.0  # for a connection


class ServedPolicy:
    """One chair's connection to such a process; `close` ends it. `warning` is whether it warns, as of its last `act`.

    Args:
        address: `tcp:PORT` or `tcp:HOST:PORT`.
        points: (actions, 2) the joystick position of each action.
    """

    def __init__(self, address: str, points: npt.NDArray[Any]) -> None:
        """Raises PolicyError when nobody answers there."""
        self.name, self.warning, self._actions = address, False, len(points)
        host, port = _parts(address)
        try:
            self._socket = socket.create_connection((host, port), _PATIENCE_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise PolicyError(
                f"{escaped(address)}: no policy is served there ({error}); start it first"
            ) from None
        about = self._asked("hello", {}, actions=points.tolist())
        self.version = f"{about.get('name', '')} {about.get('version', '')}"
        if self.version != escaped(
            self.version
        ):  # results are told apart by it, so it must not be cut
            self.close()
            told = "expected a printable name and version of at most 160 letters"
            raise PolicyError(f"{self.name}: is called {escaped(self.version, 60)!r}; {told}")

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def begin(self) -> None:
        """The process is told of episodes alone."""

    def reset(self) -> None:
        """Tell that an episode begins."""
        self.warning = False
        self._asked("reset", {})

    def act(self, observation: Observation) -> int:
        """The action that the process answers with. Raises PolicyError when it is gone, or answers something else."""
        answer = self._asked("act", observation)
        action = answer.get("action")
        if (
            not isinstance(action, int)
            or isinstance(action, bool)
            or not 0 <= action < self._actions
        ):
            told = f"expected an action, a whole number from 0 to {self._actions - 1}"
            raise PolicyError(f"{self.name}: answered {escaped(str(answer), 80)}; {told}")
        self.warning = answer.get("warning") is True
        return action

    def _asked(
        self, kind: str, observation: Mapping[str, npt.NDArray[Any]], **more: object
    ) -> dict[str, Any]:
        arrays = {key: _little(np.asarray(array)) for key, array in observation.items()}
        named = [[key, array.dtype.name, list(array.shape)] for key, array in arrays.items()]
        head = json.dumps({"kind": kind, **more, "arrays": named}).encode() + b"\n"
        text = head + b"".join(array.tobytes() for array in arrays.values())
        ends_s = time.monotonic() + ANSWER_S
        try:
            self._socket.settimeout(ANSWER_S)
            self._socket.sendall(len(text).to_bytes(4, "little") + text)
            length = int.from_bytes(self._read(4, ends_s), "little")
            if length > ANSWER.limit_bytes:
                raise PolicyError(
                    f"{self.name}: an answer of {length} bytes; expected at most {ANSWER.limit_bytes}"
                )
            return parse_json(
                self._read(length, ends_s).decode(), f"{self.name}: its answer to {kind!r}", ANSWER
            )
        except (
            BaseException
        ) as error:  # also by Ctrl-C: what comes late must not be taken for the next answer
            self.close()
            if not isinstance(error, OSError | UnicodeError):
                raise
            late = f" within {ANSWER_S:g} s" if isinstance(error, TimeoutError) else ""
            # The system names one end in three ways: nothing more to read, a reset, a broken pipe.
            cause = (
                "the process has closed the connection"
                if isinstance(error, ConnectionError)
                else error
            )
            told = f"no answer to {kind!r}{late}: {cause}; is the process alive{' and fast enough' * bool(late)}?"
            raise PolicyError(f"{self.name}: {told}") from None

    def _read(self, length: int, ends_s: float) -> bytes:
        found = b""
        while len(found) < length:
            self._socket.settimeout(max(1e-3, ends_s - time.monotonic()))
            more = self._socket.recv(length - len(found))
            if not more:
                raise ConnectionResetError
            found += more
        return found


def _little(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.ascontiguousarray(array, array.dtype.newbyteorder("<"))


def _parts(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix(SERVED).rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise PolicyError(
            f"{escaped(address)!r} is not an address of a policy; expected tcp:PORT or tcp:HOST:PORT"
        )
    return host or "127.0.0.1", int(port)

"""A policy that another process serves on a socket, in any language: `tcp:[HOST:]PORT`.

The test connects once for each chair, and some times more only to say hello. Every message is four
bytes with its length (little endian), then that many bytes: one line of JSON, a line feed, and the
bytes of the arrays that the line names, one after the other.

    {"kind": "hello", "actions": [[0.0, 0.0], ...], "arrays": []}
        answer: {"name": "mine", "version": "3"}
    {"kind": "reset", "arrays": []}
        answer: {}
    {"kind": "act", "arrays": [["depth", "uint8", [1, 60, 80]], ...]}
        answer: {"action": 40, "warning": false}

Arrays are those of an observation, C-ordered and little endian; `warning` may be missing. An
example: `examples/served_policy.py`.
"""

import json
import socket
import time
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from wcsim.agents.policy_api import ANSWER_S, SERVED, Observation
from wcsim.core.reading import ANSWER, JsonObject, escape, parse_json
from wcsim.errors import PolicyError

_CONNECT_TIMEOUT_S: Final = 10.0


class ServedPolicyClient:
    """One chair's connection to such a process; `close` ends it.

    `warning` is whether the policy warned in its last `act`.

    Args:
        address: `tcp:PORT` or `tcp:HOST:PORT`.
        points: (actions, 2) the joystick position of each action.
    """

    def __init__(self, address: str, points: npt.NDArray[Any]) -> None:
        """Connect. Raises PolicyError when no process answers there."""
        self.name = address
        self.warning = False
        self._actions = len(points)
        host, _, port = address.removeprefix(SERVED).rpartition(":")
        if not port.isdecimal() or not 0 < int(port) < 1 << 16:
            raise PolicyError(
                f"{escape(address)!r} is not an address of a policy; expected tcp:PORT or "
                "tcp:HOST:PORT"
            )
        try:
            self._socket = socket.create_connection(
                (host or "127.0.0.1", int(port)), _CONNECT_TIMEOUT_S
            )
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise PolicyError(
                f"{escape(address)}: no policy is served there ({error}); start it first"
            ) from None
        about = self._request("hello", {}, actions=points.tolist())
        self.version = f"{about.get('name', '')} {about.get('version', '')}"
        # Results are distinguished by it, so it must not be cut.
        if self.version != escape(self.version):
            self.close()
            raise PolicyError(
                f"{self.name}: is called {escape(self.version, 60)!r}; expected a printable name "
                "and version of at most 160 letters"
            )

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def begin(self) -> None:
        """Nothing: the process gets episodes alone."""

    def reset(self) -> None:
        """Announce an episode."""
        self.warning = False
        self._request("reset", {})

    def act(self, observation: Observation) -> int:
        """The action in the process's answer.

        Raises PolicyError when the process has ended, or answers something else.
        """
        answer = self._request("act", observation)
        action = answer.get("action")
        if (
            not isinstance(action, int)
            or isinstance(action, bool)
            or not 0 <= action < self._actions
        ):
            raise PolicyError(
                f"{self.name}: answered {escape(str(answer), 80)}; expected an action, a whole "
                f"number from 0 to {self._actions - 1}"
            )
        self.warning = answer.get("warning") is True
        return action

    def _request(self, kind: str, observation: Observation, **more: object) -> JsonObject:
        """Send a message and return the answer; after any error the connection is closed."""
        arrays: dict[str, npt.NDArray[Any]] = {}
        for key, value in observation.items():
            array = np.asarray(value)
            arrays[key] = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
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
                    f"{self.name}: an answer of {length} bytes; expected at most "
                    f"{ANSWER.limit_bytes}"
                )
            return parse_json(
                self._read(length, ends_s).decode(), f"{self.name}: its answer to {kind!r}", ANSWER
            )
        except BaseException as error:
            # Also after Ctrl-C: a late answer must not be taken for the next one.
            self.close()
            if not isinstance(error, OSError | UnicodeError):
                raise
            late = f" within {ANSWER_S:g} s" if isinstance(error, TimeoutError) else ""
            # The system names one end in three ways: nothing more to read, a reset, a broken pipe.
            cause: object = error
            if isinstance(error, ConnectionError):
                cause = "the process has closed the connection"
            raise PolicyError(
                f"{self.name}: no answer to {kind!r}{late}: {cause}; is the process alive"
                f"{' and fast enough' * bool(late)}?"
            ) from None

    def _read(self, length: int, ends_s: float) -> bytes:
        found = b""
        while len(found) < length:
            self._socket.settimeout(max(1e-3, ends_s - time.monotonic()))
            more = self._socket.recv(length - len(found))
            if not more:
                raise ConnectionResetError
            found += more
        return found

"""A policy in a process of its own, without wcsim: it follows the stick and slows down if something is near ahead.

python examples/served_policy.py 5800
wcsim test --suite dev2 tcp:5800 --only
"""

import json
import socketserver
import sys

import numpy as np

NEAR = 120  # codes of depth run from 1 (0.1 m) to 255 (the range), on a logarithmic scale; 0 means not measured


class Chair(socketserver.StreamRequestHandler):
    """One connection: one chair of the test."""

    def handle(self) -> None:
        """Answer message by message until the test is over."""
        while head := self.rfile.read(4):
            line, _, data = self.rfile.read(int.from_bytes(head, "little")).partition(b"\n")
            asked = json.loads(line)
            if asked["kind"] == "hello":
                self.points = np.array(asked["actions"])
                self.say({"name": "careful", "version": "1"})
            elif asked["kind"] == "reset":
                self.say({})
            else:
                self.say(self.decide(arrays_of(asked["arrays"], data)))

    def decide(self, seen: dict[str, np.ndarray]) -> dict[str, object]:
        """An action, and whether to warn."""
        depth = seen["depth"].reshape(seen["depth"].shape[-2:])
        rows, columns = depth.shape
        ahead = depth[rows // 4 : rows // 2, columns // 3 : 2 * columns // 3]
        near = bool(np.mean((ahead > 0) & (ahead < NEAR)) > 0.05)
        wish = seen["joystick"] * (0.3 if near else 1.0)
        return {"action": int(np.argmin(np.hypot(*(self.points - wish).T))), "warning": near}

    def say(self, answer: dict[str, object]) -> None:
        """Send one answer."""
        text = json.dumps(answer).encode()
        self.wfile.write(len(text).to_bytes(4, "little") + text)


def arrays_of(named: list, data: bytes) -> dict[str, np.ndarray]:
    """The arrays of a message, by name."""
    found, at = {}, 0
    for name, dtype, shape in named:
        array = np.frombuffer(data, np.dtype(dtype), int(np.prod(shape)), at)
        found[name], at = array.reshape(shape), at + array.nbytes
    return found


if __name__ == "__main__":
    with socketserver.ThreadingTCPServer(("127.0.0.1", int(sys.argv[1])), Chair) as server:
        server.serve_forever()

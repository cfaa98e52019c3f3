"""What no peer may do to the sockets of a server: run in a child, which ZeroMQ may abort."""

import subprocess
import sys
from pathlib import Path

FLOOD = """
import sys, time, zmq
from wcsim.server.transport.sockets import QUEUE, ServerSockets
with ServerSockets("ipc://" + sys.argv[1] + "/world", "tcp://127.0.0.1:*") as sockets:
    with zmq.Context() as far, far.socket(zmq.DEALER) as peer:
        peer.linger = 2000
        peer.connect(sockets.listening)
        for _ in range(8 * QUEUE):
            peer.send(b"hello")
        time.sleep(0.5)
    time.sleep(1.5)  # the time of a heartbeat
    received, late_s = 0, time.monotonic() + 20.0
    while received < 8 * QUEUE and time.monotonic() < late_s:
        received += len(list(sockets.messages()))
print("lives")
"""


def test_a_flood_of_a_peer_that_is_gone_aborts_nothing(tmp_path: Path) -> None:
    """A peer's messages wait, its connection is over, and a heartbeat would be due."""
    done = subprocess.run([sys.executable, "-c", FLOOD, str(tmp_path)], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "lives\n"), done.stderr

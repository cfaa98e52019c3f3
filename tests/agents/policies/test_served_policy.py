"""A policy in a process of its own: the example, and processes that do wrong."""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tests.support.cluster.ray_nodes import free_port
from wcsim.agents.evaluation.suite.drive import FIRST_SHARE, LATE_S
from wcsim.agents.evaluation.suite.run import _identity_of
from wcsim.agents.policies import served_policy
from wcsim.agents.policies.served_policy import ServedPolicyClient
from wcsim.agents.policy_api import ANSWER_S
from wcsim.errors import PolicyError

EXAMPLE = Path(__file__).parents[3] / "examples" / "served_policy.py"
POINTS = np.array([[0.0, 0.0], [0.0, 0.3], [0.0, 1.0]])


@pytest.fixture(scope="module")
def example() -> Iterator[str]:
    port = free_port()
    with subprocess.Popen([sys.executable, str(EXAMPLE), str(port)]) as process:
        for _ in range(200):
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                break
            except OSError:
                time.sleep(0.05)
        yield f"tcp:{port}"
        process.terminate()


def seen(depth: int) -> dict[str, np.ndarray]:
    return {"depth": np.full((1, 60, 80), depth, np.uint8), "joystick": np.array([0.0, 1.0], np.float32)}


def test_the_example_follows_and_creeps_when_something_is_near(example: str) -> None:
    first, second = (
        ServedPolicyClient(example, POINTS),
        ServedPolicyClient(example, POINTS),
    )  # a connection for each chair
    assert first.version == "careful 1"
    for policy in (first, second):
        policy.begin()
        policy.reset()
        assert (policy.act(seen(250)), policy.warning) == (2, False)
        assert (policy.act(seen(60)), policy.warning) == (1, True)
        policy.reset()
        assert not policy.warning
        policy.close()


def answering(*answers: bytes, late_s: float = 0.0, byte_s: float = 0.0, asked: list[bytes] | None = None) -> str:
    """A process that answers so, one answer a message and each so late, and then closes the connection."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server, server.accept()[0] as there:
            for answer in answers:
                length, message = int.from_bytes(there.recv(4), "little"), b""
                while len(message) < length:
                    message += there.recv(length - len(message))
                if asked is not None:
                    asked.append(message)
                time.sleep(late_s)
                said = len(answer).to_bytes(4, "little") + answer
                with suppress(OSError):
                    for part in [said] if not byte_s else [said[at : at + 1] for at in range(len(said))]:
                        time.sleep(byte_s)
                        there.sendall(part)

    threading.Thread(target=serve, daemon=True).start()
    return f"tcp:127.0.0.1:{server.getsockname()[1]}"


HELLO = json.dumps({"name": "x", "version": "1"}).encode()


def test_a_suite_that_asks_for_the_version_names_the_actions_too():
    """A process may look up the one for the stick at rest when it hears hello."""
    asked: list[bytes] = []
    assert _identity_of(answering(HELLO, asked=asked), "quick") == ["served", "x 1", "quick"]
    points = json.loads(asked[0])["actions"]
    assert len(points) == 81 and [0.0, 0.0] in points


@pytest.mark.parametrize(
    "answer, said",
    [
        (b'{"action": 1.5}', "a whole number"),
        (b'{"action": true}', "a whole number"),
        (b"[1]", "a JSON object"),
        (b"\xff", "no answer to 'act'"),
        (b"[" * 60_000, "is not JSON"),
        (b'{"action": -1}', "from 0 to 2"),
        (b'{"action": 3}', "from 0 to 2"),
        (b'{"action": 1' + 4000 * b"0" + b"}", "expected at most 64"),
        (b'{"action": 1' + 5000 * b"0" + b"}", "is not JSON"),
        (b" " * (1 << 17), "at most 65536"),
        (None, "no answer to 'act': the process has closed the connection; is the process alive?"),
    ],
)
def test_a_wrong_answer_or_none_is_told(answer: bytes | None, said: str) -> None:
    policy = ServedPolicyClient(answering(HELLO, *([] if answer is None else [answer])), POINTS)
    with pytest.raises(PolicyError, match=said):
        policy.act(seen(1))
    policy.close()


def test_nobody_there_and_no_address():
    with pytest.raises(PolicyError, match="no policy is served"):
        ServedPolicyClient(f"tcp:{free_port()}", POINTS)
    for wrong in ("tcp:", "tcp:x", "tcp:70000", "tcp:host:0"):
        with pytest.raises(PolicyError, match="not an address"):
            ServedPolicyClient(wrong, POINTS)


def test_an_answer_may_take_longer_than_a_connection(monkeypatch):
    monkeypatch.setattr("wcsim.agents.policies.served_policy._CONNECT_TIMEOUT_S", 0.3)
    policy = ServedPolicyClient(answering(HELLO, b"{}", late_s=0.6), POINTS)
    policy.reset()
    assert LATE_S * FIRST_SHARE < ANSWER_S
    policy.close()


@pytest.mark.parametrize(
    "hello",
    [
        b"[" * 60_000,
        json.dumps({"name": 50_000 * "x", "version": "1"}).encode(),
        json.dumps({"name": "x\ny", "version": "\x1b[31m"}).encode(),
        json.dumps({"name": "x", "version": "\ud800"}).encode(),
    ],
)
def test_who_says_hello_so_is_refused_in_a_line(hello: bytes) -> None:
    with pytest.raises(PolicyError) as told:
        ServedPolicyClient(answering(hello), POINTS)
    assert str(told.value).isprintable() and len(str(told.value)) < 500


def test_an_answer_that_drips_is_ended_and_no_later_one_is_taken_for_it(monkeypatch):
    act = b'{"action": 1}' + 100 * b" "
    policy = ServedPolicyClient(answering(HELLO, act, act, byte_s=0.01), POINTS)
    monkeypatch.setattr(served_policy, "ANSWER_S", 0.3)
    for said in (r"no answer to 'act' within 0\.3 s", "no answer to 'act': "):
        with pytest.raises(PolicyError, match=said):
            policy.act(seen(1))

import asyncio
import http.client
import logging
import signal
import socket
import subprocess
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from tests.drive.serving.served import FakePage
from wcsim.drive.runner import DriveOrder
from wcsim.drive.serving import server as server_module
from wcsim.drive.serving.server import MOST_PAGES, DriveServer
from wcsim.drive.starting import DriveStart
from wcsim.errors import ConfigError

pytestmark = pytest.mark.timeout(900)  # a busy machine opens a street in minutes
Served = tuple[str, subprocess.Popen[str]]
START = DriveOrder(start=DriveStart())


@pytest.mark.parametrize("host", ["192.0.2.1", "no-such-host.invalid"])
def test_a_host_that_is_not_this_machine_is_named_and_not_the_port(host: str) -> None:
    with pytest.raises(ConfigError, match=f"^{host}:0: cannot be served .*; expected --host with a name or address"):
        asyncio.run(DriveServer(START, host, 0).run())


def test_a_port_that_somebody_has_is_named() -> None:
    refused = pytest.raises(ConfigError, match=r"choose another --port; 0 takes a free one$")
    with socket.create_server(("127.0.0.1", 0)) as taken, refused:
        asyncio.run(DriveServer(START, port=taken.getsockname()[1]).run())


@asynccontextmanager
async def no_process(*_: object) -> AsyncIterator[asyncio.Future[None]]:
    """Stands for the process of a drive, which these tests do without."""
    yield asyncio.Future()


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a server without a drive."""
    monkeypatch.setattr(server_module, "_running", no_process)
    said: list[str] = []
    begun, loop = threading.Event(), asyncio.new_event_loop()
    server = DriveServer(START, port=0, say=lambda told: (said.append(told), begun.set()))
    serving = loop.create_task(server.run())

    def serve() -> None:
        with pytest.raises(asyncio.CancelledError):
            loop.run_until_complete(serving)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert begun.wait(60)
        yield said[0].split("/")[2]
    finally:
        loop.call_soon_threadsafe(serving.cancel)
        thread.join()
        loop.close()


def asked(address: str, *lines: str) -> bytes:
    """The whole answer to requests that come at once."""
    host, _, port = address.partition(":")
    with socket.create_connection((host, int(port)), timeout=60) as line:
        line.sendall(
            "".join(f"{each} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n" for each in lines).encode()
        )
        return b"".join(iter(lambda: line.recv(1 << 16), b""))


def test_whatever_is_asked_is_answered_without_a_traceback(bare: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    for request, status in (("GET //[", 404), ("OPTIONS /", 405), ("POST /socket", 405), ("HEAD /nothing", 404)):
        assert asked(bare, request).startswith(b"HTTP/1.1 %d " % status), request
    got, head = asked(bare, "GET /"), asked(bare, "HEAD /")
    assert head == got[: got.index(b"\r\n\r\n") + 4] and b"Content-Length: " in head
    for request in ("GET /", "GET /\xff"):
        assert b"aiohttp" not in asked(bare, request, request)
    assert "Traceback" not in caplog.text and "\n" not in "".join(record.getMessage() for record in caplog.records)
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], (
        "anybody could fill a terminal"
    )


def test_who_asks_nothing_and_who_reads_nothing_is_gone_after_a_while(
    bare: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ping is answered: who sends many and reads no answer holds what fits into the kernel."""
    monkeypatch.setattr(server_module, "_PING_S", 0.2)
    host, _, port = bare.partition(":")
    key = (
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
        + 22 * "A"
        + "=="
    )
    with socket.create_connection((host, int(port)), timeout=60) as page:
        page.sendall(f"GET /socket HTTP/1.1\r\nHost: {bare}\r\nOrigin: http://{bare}\r\n{key}\r\n\r\n".encode())
        with pytest.raises(ConnectionError):
            while True:
                page.sendall(1000 * (b"\x89\xfd" + bytes(4 + 125)))
    monkeypatch.setattr(server_module, "_END_S", 0.2)
    with socket.create_connection((host, int(port)), timeout=60) as reader, pytest.raises(ConnectionError):
        while True:
            reader.sendall(1000 * f"GET /main.js HTTP/1.1\r\nHost: {bare}\r\n\r\n".encode())
    assert asked(bare) == b""


def test_a_page_that_says_nothing_yields_its_place_and_one_that_speaks_keeps_it(bare: str) -> None:
    with ExitStack() as held:

        def page() -> ClientConnection:
            return held.enter_context(connect(f"ws://{bare}/socket", origin=f"http://{bare}", close_timeout=0.1))

        silent = [page() for _ in range(MOST_PAGES)]
        for number in range(MOST_PAGES):
            own = page()
            assert '"say":"role"' in own.recv(timeout=60)
            own.send('{"say":"help"}')
            with pytest.raises(ConnectionClosed):
                while True:
                    silent[number].recv(timeout=60)
        refused = page()
        with pytest.raises(ConnectionClosed, match="1013"):
            refused.recv(timeout=60)


def read(address: str, path: str, headers: dict[str, str]) -> http.client.HTTPResponse:
    host, _, port = address.partition(":")
    line = http.client.HTTPConnection(host, int(port), timeout=60)
    line.putrequest("GET", path, skip_host=True)
    for name, value in {**headers, "Connection": "close"}.items():
        line.putheader(name, value)
    line.endheaders()
    return line.getresponse()


def test_the_page_is_served_with_its_policy(running: Served) -> None:
    address, _ = running
    for path, kind in (("/", "text/html"), ("/page.css", "text/css"), ("/main.js", "text/javascript")):
        answer = read(address, path, {"Host": address})
        assert (answer.status, answer.headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.read()
    for path in (
        "/nothing.js",
        "/../session.py",
        "/%2e%2e/session.py",
        "/page/index.html",
        "/index.html/",
        "//etc/passwd",
    ):
        assert read(address, path, {"Host": address}).status == 404, path


def test_strangers_are_refused(running: Served) -> None:
    address, _ = running
    assert read(address, "/", {"Host": "evil.example"}).status == 403
    assert read(address, "/", {}).status in (400, 403)
    assert read(address, "/main.js", {"Host": address, "Origin": "http://evil.example"}).status == 403
    for origin in ("http://evil.example", None):
        with pytest.raises(InvalidStatus) as refused, connect(f"ws://{address}/socket", origin=origin):
            pass
        assert refused.value.response.status_code == 403


def test_a_stick_moves_the_chair_and_silence_stops_it(running: Served) -> None:
    with FakePage(running[0]) as page:
        page.say("assist", on=False)
        page.drive_off()
        assert page.pictures > 0
        page.silent = True
        page.state(lambda state: abs(state["speed_mps"]) < 0.02)


def test_help_level_pause_and_pace_are_obeyed(running: Served) -> None:
    with FakePage(running[0]) as page:
        about = page.until(lambda message: message["say"] == "about")
        assert len(about["points"]) == 81 and about["levels"] == [0.0, 2.0] and about["suites"]["dev2"]
        before = page.state()["kpis"]["helps"]
        page.say("help")
        page.state(lambda state: state["kpis"]["helps"] == before + 1)
        page.say("setlevel", level=0.5)
        page.say("assist", on=True)
        page.state(lambda state: state["level"] == 0.5 and state["assisted"])
        page.say("setlevel", level=7.0)
        refusal = page.until(lambda message: message["say"] == "notice" and message["kind"] == "refused")
        assert "expected 0 to 2" in refusal["told"]
        page.overrule = True
        page.state(lambda state: state["overruled"])
        page.overrule = False
        page.say("pause", on=True)
        page.state(lambda state: state["paused"])
        page.say("pause", on=False)
        page.say("pace", times=0)
        page.state(lambda state: state["pace"] == 0.0 and not state["paused"])
        page.say("pace", times=1)
        page.say("open", town="atlantis")
        told = page.until(lambda message: message["say"] == "notice" and "atlantis" in message["told"])
        assert told["kind"] == "refused"
        page.state(lambda state: state["pace"] == 1.0)


def test_a_second_page_looks_on_until_it_takes_over(running: Served) -> None:
    with FakePage(running[0]) as first:
        first.role(drives=True)
        with FakePage(running[0]) as second:
            told = second.role(drives=False)
            assert told["taken"] and "Another page is driving" in told["told"]
            second.say("pause", on=True)
            assert not first.state()["paused"], "who looks on changes nothing"
            second.say("takeover")
            second.role(drives=True)
            first.role(drives=False)
            second.drive_off()
        first.state()
        told = first.until(lambda message: message["say"] == "role" and not message["taken"])
        assert told["told"] == "No page is driving."
        first.say("takeover")
        first.role(drives=True)


def test_from_an_episode_of_a_suite_back_into_a_town(running: Served, corner: Path) -> None:
    """A generated scene has a recorded user, in a file that goes with it."""
    with FakePage(running[0]) as page:
        page.state()
        page.say("open", suite="dev2", block=16, seat=0)
        told = page.until(lambda message: message["say"] == "about" and message["place"].startswith("dev2 16.0"))
        assert told["profile"].startswith("recorded:")
        page.drive_off()
        page.say("open", town=str(corner), seed=4)
        told = page.until(lambda message: message["say"] == "about" and not message["place"].startswith("dev"))
        assert told["profile"] == "competent"
        page.drive_off()


def test_garbage_is_refused_in_a_line_and_ends_the_connection(running: Served) -> None:
    with FakePage(running[0]) as page:
        page.socket.send('{"say":"stick","x":9,"y":0}')
        told = page.until(lambda message: message["say"] == "notice")["told"]
        assert "got a message that this server does not know" in told and "\n" not in told
        with pytest.raises(ConnectionClosed):
            for _ in range(40):
                page.socket.send("garbage")
                page.socket.recv(timeout=60)
            for _ in range(200):
                page.socket.recv(timeout=60)
    with pytest.raises(ConnectionClosed), FakePage(running[0]) as page:
        page.socket.send("x" * 5000)
        for _ in range(200):
            page.socket.recv(timeout=60)
    with FakePage(running[0]) as page:
        page.state()  # the drive goes on


@pytest.mark.proof
def test_ctrl_c_ends_it_with_a_line(running: Served) -> None:
    """The last test: the drive of this file is over then."""
    address, process = running
    with FakePage(address) as page:
        page.state()  # the street is open, so there is a drive to tell of
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "arrivals" in said and "Traceback" not in said

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from tests.cli.towns import tiny_osm
from wcsim.errors import TownError
from wcsim.towns.osm.read import Box, download, read_extract

BOX = Box(24.999, 59.9995, 25.0046, 60.0023)
Answer = Callable[[BaseHTTPRequestHandler], None]


@contextmanager
def server(answer: Answer, asked: list[bytes]) -> Iterator[str]:
    """A stand-in for an Overpass server, on this machine."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked.append(self.rfile.read(int(self.headers["Content-Length"])))
            answer(self)

        def log_message(self, *words: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as made:
        made.daemon_threads = True
        thread = Thread(target=made.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{made.server_port}/api/interpreter"
        made.shutdown()
        thread.join()


def says(body: bytes, status: int = 200) -> Answer:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        handler.end_headers()
        handler.wfile.write(body)

    return answer


def test_the_area_that_was_asked_for_arrives(tmp_path: Path) -> None:
    asked: list[bytes] = []
    with server(says(tiny_osm().encode()), asked) as url:
        path = download(BOX, tmp_path, url)
    assert b'<bbox-query n="60.0023" s="59.9995" w="24.999" e="25.0046"/>' in asked[0]
    assert len(read_extract(path, BOX).root) == 20


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (says(b"", 500), "HTTP Error 500"),
        (says(b"", 404), "HTTP Error 404"),
        (says(b"<html>busy</html>"), "non-OSM content"),
        (lambda handler: time.sleep(20.0), "did not answer within 3 s"),
    ],
)
def test_a_server_that_fails_is_named_in_one_line(tmp_path: Path, answer: Answer, told: str) -> None:
    with server(answer, []) as url, pytest.raises(TownError, match=told) as caught:
        download(BOX, tmp_path, url, wait_s=3.0 if "within" in told else 60.0)
    assert "127.0.0.1" in str(caught.value) and "--osm FILE" in str(caught.value) and "\n" not in str(caught.value)


def test_nobody_there_and_no_address(tmp_path: Path) -> None:
    with pytest.raises(TownError, match=r"no map could be downloaded .*refused"):
        download(BOX, tmp_path, "http://127.0.0.1:9/api")
    for url in ("file:///etc/passwd", "127.0.0.1", "http://"):
        with pytest.raises(TownError, match="is not a server address"):
            download(BOX, tmp_path, url)
    with pytest.raises(TownError, match="at most 12 km"):
        download(Box(24.0, 60.0, 25.0, 60.1), tmp_path)

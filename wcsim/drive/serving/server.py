"""The page's server: static files, one socket a page, and who drives; the drive itself runs in its own process.

One of the pages drives, each takes pictures as fast as it can show them. What waits to be said to a drive that does not
hear yet: of each kind the newest alone, one slow wish at a time.

Of sticks those stay too that say what the newest does not: that the button was pressed, or the stick let go of.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from wcsim.core.closing import Closing
from wcsim.core.reading import escaped
from wcsim.drive import messages as m
from wcsim.drive.playing.play_runner import PlayStart
from wcsim.drive.runner import DONE, JSON, LINE, PICTURES, DriveOrder
from wcsim.drive.serving.access_control import LOOPBACK, AccessControl, content_policy, new_token
from wcsim.drive.stick_watch import rests
from wcsim.errors import ConfigError, ProtocolError, WorkersError
from wcsim.server.launch.stop_signals import unheard_by_children

_MOST_WAITING: Final = 64  # lines to a page; of a page that reads too slowly the oldest are lost
_NUMBER = struct.Struct("<I")
_STATE: Final = b'{"say":"state"'
_TAKEN: Final = "Another page is driving. You are watching."


class PageLine:
    """What is on its way to one page: lines in order, and of states and pictures the newest alone."""

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self.silent = True  # it has said nothing yet, which a page does as soon as it is there
        self._lines = deque[bytes](maxlen=_MOST_WAITING)
        self._state: bytes | None = None
        self._pictures: bytes | None = None
        self._on_the_way: int | None = None  # the number of the pictures that the page has not shown yet
        self._some = asyncio.Event()

    @property
    def free(self) -> bool:
        """Whether the page has shown all that it was sent."""
        return self._on_the_way is None and self._pictures is None

    def put(self, line: bytes) -> None:
        """Send a line."""
        if line.startswith(_STATE):  # as fast as it can, a drive says more of them than a page reads
            self._state = line
        else:
            self._lines.append(line)
        self._some.set()

    def show(self, pictures: bytes) -> None:
        """Send pictures, as soon as the page has shown the ones before."""
        self._pictures = pictures
        self._some.set()

    def seen(self, number: int) -> None:
        """The page has shown these pictures."""
        if number == self._on_the_way:
            self._on_the_way = None
            self._some.set()

    def hang_up(self) -> None:
        """End the connection, without a word."""
        self._connection.transport.abort()

    async def write(self) -> None:
        """Send what there is, for as long as the page is there."""
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._some.wait()
                self._some.clear()
                while self._lines:
                    await self._connection.send(self._lines.popleft().decode())
                if self._state is not None:
                    state, self._state = self._state, None
                    await self._connection.send(state.decode())
                if self._pictures is not None and self._on_the_way is None:
                    pictures, self._pictures = self._pictures, None
                    (self._on_the_way,) = _NUMBER.unpack_from(pictures)
                    await self._connection.send(pictures)


class Audience:
    """All pages; the first drives, and who asks for it."""

    def __init__(self) -> None:
        self.driver: PageLine | None = None
        self._pages: list[PageLine] = []
        self._kept: dict[str, bytes] = {}  # the last lines that a page needs which comes later, by what they say
        self._asked = False

    def __len__(self) -> int:
        return len(self._pages)

    def enter(self, page: PageLine) -> None:
        """A page has come."""
        self._pages.append(page)
        self.driver = self.driver or page
        for line in self._kept.values():
            page.put(line)
        self._tell_roles()
        self._asked = False  # it has no pictures yet

    def leave(self, page: PageLine) -> bool:
        """A page has gone; whether it drove. Nobody drives then, until a page asks for it or comes."""
        self._pages.remove(page)
        drove = page is self.driver
        if drove:
            self.driver = None
        self._tell_roles()
        return drove

    def hang_up_silent(self) -> bool:
        """Let the oldest page that never said anything yield its place; whether there was one."""
        silent = next((page for page in self._pages if page.silent), None)
        if silent is not None:
            silent.silent = False  # it yields once
            silent.hang_up()
        return silent is not None

    def take_over(self, page: PageLine) -> None:
        """This page drives from now on."""
        self.driver = page
        self._tell_roles()

    def tell(self, line: bytes) -> None:
        """A line for all."""
        for name in ("about", "state", "busy", "keeping", "study", "marks"):
            if line.startswith(b'{"say":"%s"' % name.encode()):
                self._kept[name] = line
                if name == "about":
                    self._kept.pop("busy", None)
        for page in self._pages:
            page.put(line)

    def show(self, pictures: bytes) -> None:
        """New pictures for all."""
        self._asked = False
        for page in self._pages:
            page.show(pictures)

    def wants(self) -> bool:
        """Whether new pictures are to be asked for; True once for each time that they come."""
        if self._asked or not any(page.free for page in self._pages):
            return False
        self._asked = True
        return True

    def _tell_roles(self) -> None:
        for page in self._pages:
            drives = page is self.driver
            taken = not drives and self.driver is not None
            told = "" if drives else _TAKEN if taken else "No page is driving."
            page.put(m.spoken("role", {"drives": drives, "taken": taken, "told": told}))


log = logging.getLogger("wcsim.drive")
PAGE: Final = Path(__file__).parents[1] / "page"
_SOCKET: Final = "/socket"
_KINDS: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
MOST_PAGES: Final = 8
_PING_S: Final = 20.0  # a page that is gone without a word; its stick has long been at rest
_MOST_REFUSED: Final = 20  # messages of a page that are no messages
_SOON_S, _END_S = 0.5, 10.0  # for a process that hears, and for one that does not


_MOST: Final = 256  # of steps, which add up
_PLACES: Final = (m.NewPlace, m.Again, m.Open)  # each makes void what was wanted of those up to it


class Words:
    """Messages in order; one that says as much as one before it takes its place, at the end."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting = deque[m.PageMessage](maxlen=_MOST)
        self._busy = False  # with a slow wish

    def put(self, message: m.PageMessage) -> None:
        """Say this too."""
        with self._lock:
            for before in [each for each in self._waiting if _says_as_much(message, each)]:
                self._waiting.remove(before)
            self._waiting.append(message)

    def take(self) -> list[m.PageMessage]:
        """All that waits; while a slow wish is being done, what comes before the next one."""
        said = list[m.PageMessage]()
        with self._lock:
            while self._waiting and not (self._busy and self._waiting[0].slow):
                said.append(self._waiting.popleft())
                self._busy = self._busy or said[-1].slow
        return said

    def done(self) -> None:
        """The slow wish is done."""
        with self._lock:
            self._busy = False


def _says_as_much(message: m.PageMessage, before: m.PageMessage) -> bool:
    """Whether the one before need not be heard any more: a page that is gone leaves nothing to do behind it."""
    if isinstance(message, m.End | m.Gone):
        return isinstance(message, m.End) or not isinstance(before, m.Ready | m.End)
    if isinstance(message, m.Stick) and isinstance(before, m.Stick):
        still_pressed = message.overrule or not before.overrule
        return still_pressed and (rests(message.x, message.y) or not rests(before.x, before.y))
    if isinstance(message, _PLACES) and isinstance(before, _PLACES):
        return _PLACES.index(type(before)) <= _PLACES.index(type(message))
    return type(message) is type(before) and not isinstance(message, m.StepBy)


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOrder:
    """Where the page is served, and what is behind it."""

    start: DriveOrder | PlayStart
    host: str = "127.0.0.1"
    port: int = 8080  # 0 for a free one
    say: Callable[[str], object] = log.info  # hears of the address, and how each drive ended


class _Process(Closing):
    """The drive's process, a thread that listens to it, and one that speaks to it.

    It hears nothing while it opens a street, and a pipe holds little: so nobody waits for it here, see `Words`.
    """

    def __init__(self, order: ServeOrder, hear: Callable[[bytes], object], ended: Callable[[], object]) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        name = f"wcsim-{order.start.word}"  # no daemon: a player starts the process that makes its film
        self._process = context.Process(target=order.start.run, args=(theirs,), name=name)
        with unheard_by_children():  # Ctrl-C is for this process, which ends that one
            self._process.start()
        theirs.close()
        self._words, self._some = Words(), threading.Event()
        self._over = False
        self._threads = (
            threading.Thread(target=_listen, args=(self._pipe, hear, ended), daemon=True),
            threading.Thread(target=self._speak, daemon=True),
        )
        for thread in self._threads:
            thread.start()

    def send(self, message: m.PageMessage) -> None:
        """Say something to the drive, as soon as it hears; nothing happens when it has ended."""
        self._words.put(message)
        self._some.set()

    def done(self) -> None:
        """It has done a slow wish, and may hear the next one."""
        self._words.done()
        self._some.set()

    def close(self) -> None:
        """End the drive; one that does not hear of it is told by a signal.

        It closes its end of the pipe when all else is closed; the seconds that it takes then are of use to nobody.
        """
        self.send(m.End())
        listening = self._threads[0]
        listening.join(_SOON_S)
        if listening.is_alive():
            self._process.terminate()
            listening.join(_END_S)
        self._process.kill()
        self._process.join()
        self._over = True
        self._some.set()
        for thread in self._threads:
            thread.join(_END_S)
        self._pipe.close()

    def _speak(self) -> None:
        with contextlib.suppress(OSError):
            while not self._over:
                self._some.wait()
                self._some.clear()
                for message in self._words.take():
                    self._pipe.send(message)


def _listen(pipe: Connection, hear: Callable[[bytes], object], ended: Callable[[], object]) -> None:
    try:
        while True:
            hear(pipe.recv_bytes())
    except (EOFError, OSError):
        ended()


class DriveServer:
    """Serves one drive to pages; `run` ends when it is cancelled, or the drive's process has ended."""

    def __init__(self, order: ServeOrder) -> None:
        self._order = order
        token = "" if order.host in LOOPBACK else new_token()
        self._access = AccessControl(host=order.host, token=token)
        self._audience = Audience()
        self._process: _Process | None = None
        self._over = asyncio.Event()
        self._died = False

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            ConfigError: The address is taken, or not this machine's.
            WorkersError: The process that is served has died.
        """
        loop = asyncio.get_running_loop()
        try:
            server = await serve(
                self._meet,
                self._order.host,
                self._order.port,
                process_request=self._read,
                max_size=m.MOST_BYTES,
                max_queue=64,
                ping_interval=_PING_S,
                ping_timeout=_PING_S,
                compression=None,
                server_header=None,
                logger=_logger(),
            )
        except OSError as error:
            raise _not_served(self._order, error) from None
        try:
            self._order.say(f"{self._order.start.word} at {self._address(server)}  (Ctrl-C to stop)")
            self._order.say(self._order.start.begins)
            self._process = _Process(
                self._order,
                lambda data: loop.call_soon_threadsafe(self._told, data),
                lambda: loop.call_soon_threadsafe(self._ended),
            )
            await self._over.wait()
        finally:
            server.close()
            await asyncio.to_thread(self._close)
        if self._died:
            what = f"the {self._order.start.word}'s process"
            raise WorkersError(f"{what} has ended; the messages above say why: start it again")

    def _close(self) -> None:
        if self._process is not None:
            self._process.close()

    def _address(self, server: Server) -> str:
        port = server.sockets[0].getsockname()[1]
        host = f"[{self._order.host}]" if ":" in self._order.host else self._order.host
        token = f"?token={self._access.token}" if self._access.token else ""
        return f"http://{host}:{port}/{token}"

    # --- what a browser reads ---

    def _read(self, connection: ServerConnection, request: Request) -> Response | None:
        """Hand out a file of the page, or let a socket through."""
        if request.method not in ("GET", "HEAD"):
            response = connection.respond(HTTPStatus.METHOD_NOT_ALLOWED, "expected GET or HEAD\n")
            response.headers["Allow"] = "GET, HEAD"
            return response
        try:
            answer = self._answer(connection, request)
        except ValueError:  # of a path that is no address, such as //[
            answer = connection.respond(HTTPStatus.BAD_REQUEST, "this is not the address of a page\n")
        if answer is not None and request.method == "HEAD":
            answer.body = b""
        return answer

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        path, headers = urlsplit(request.path).path, request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        wants_socket = path == _SOCKET
        twice = len(hosts) != 1 or len(origins) > 1
        why = self._access.refusal(
            None if twice else hosts[0], origins[0] if origins else None, request.path, socket=wants_socket
        )
        if why:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
        if wants_socket:
            return None
        name = self._order.start.page if path == "/" else path.removeprefix("/")
        file = next((each for each in PAGE.iterdir() if each.name == name and each.suffix in _KINDS), None)
        if file is None:
            return connection.respond(HTTPStatus.NOT_FOUND, "there is no such page\n")
        return _file(file.read_bytes(), _KINDS[file.suffix], hosts[0])

    # --- what a page says ---

    async def _meet(self, connection: ServerConnection) -> None:
        """One page, from its coming to its going."""
        if len(self._audience) >= MOST_PAGES and not self._audience.hang_up_silent():
            await connection.close(1013, "too many pages")
            return
        line = PageLine(connection)
        writing = asyncio.create_task(line.write())
        self._audience.enter(line)
        self._ask_for_pictures()
        try:
            await self._hear(line, connection)
        except ConnectionClosed:
            log.debug("a page has gone")
        finally:
            if self._audience.leave(line):
                self._send(m.Gone())
            writing.cancel()

    async def _hear(self, line: PageLine, connection: ServerConnection) -> None:
        refused = 0
        async for data in connection:
            line.silent = False
            try:
                message = m.of_page(data)
            except ProtocolError as error:
                refused += 1
                line.put(m.spoken("notice", {"kind": "refused", "told": str(error)}))
                if refused >= _MOST_REFUSED:
                    await connection.close(1008, "not a page of wcsim")
                    return
                continue
            self._obey(line, message)

    def _obey(self, line: PageLine, message: m.PageMessage) -> None:
        if isinstance(message, m.Shown):
            line.seen(message.number)
            self._ask_for_pictures()
        elif isinstance(message, m.TakeOver):
            self._send(m.Gone())
            self._audience.take_over(line)
        elif line is self._audience.driver:
            self._send(message)

    # --- what the drive says ---

    def _told(self, data: bytes) -> None:
        kind, body = data[:1], data[1:]
        if kind == PICTURES:
            self._audience.show(body)
            self._ask_for_pictures()
        elif kind == JSON:
            self._audience.tell(body)
        elif kind == LINE:
            self._order.say(body.decode())
        elif kind == DONE and self._process is not None:
            self._process.done()

    def _ended(self) -> None:
        if not self._over.is_set():
            self._died = True
            told = m.spoken("notice", {"kind": "bad", "told": self._order.start.over})
            self._audience.tell(told)
            asyncio.get_running_loop().call_later(0.5, self._over.set)

    def _ask_for_pictures(self) -> None:
        """Ask for pictures where a page takes them and none are on the way."""
        if self._audience.wants():
            self._send(m.Ready())

    def _send(self, message: m.PageMessage) -> None:
        if self._process is not None:
            self._process.send(message)


def _not_served(order: ServeOrder, error: OSError) -> ConfigError:
    """What is wrong with an address: the host is no name or address of this machine, or the port cannot be had."""
    of_host = isinstance(error, socket.gaierror) or error.errno in (None, errno.EADDRNOTAVAIL)  # None: tried several
    cure = (
        "expected --host with a name or address of this machine, or 0.0.0.0 for all of them"
        if of_host
        else "choose another --port; 0 takes a free one"
    )
    return ConfigError(f"{order.host}:{order.port}: cannot be served ({error.strerror or error}); {cure}")


def _file(data: bytes, kind: str, host: str) -> Response:
    headers = Headers(
        {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(data)),
            "Content-Security-Policy": content_policy(host),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cache-Control": "no-store",
            "Connection": "close",
        }
    )
    return Response(HTTPStatus.OK.value, HTTPStatus.OK.phrase, headers, data)


def _logger() -> logging.Logger:
    """Of websockets: what a request breaks there is a line, as whoever finds the address could fill a terminal."""
    logger = logging.getLogger("wcsim.drive.websockets")
    logger.addFilter(_in_a_line)
    return logger


def _in_a_line(record: logging.LogRecord) -> bool:
    if record.exc_info and record.exc_info[1] is not None:
        record.msg, record.args = escaped(f"{record.getMessage()}: {record.exc_info[1]!r}"), ()
        record.exc_info = None
    return True


def serve_drive(order: ServeOrder) -> None:
    """Serve until Ctrl-C. Raises ConfigError, see `DriveServer.run`; KeyboardInterrupt goes on to the caller."""
    asyncio.run(DriveServer(order).run())

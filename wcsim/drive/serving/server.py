"""The page's server: static files, one socket per page, and who drives. A process runs the drive.

One page drives; each page gets pictures as fast as it can show them. While the drive's process is
busy, only the newest message of each kind waits for it, and slow ones are sent one at a time. An
older stick also waits if it says more than the newest: a press of the button, or a stick at rest.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import struct
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from aiohttp import WSCloseCode, WSMsgType, web
from aiohttp.http import HttpProcessingError
from aiohttp.typedefs import Handler

from wcsim.core.processes import start_piped_process
from wcsim.core.reading import escape
from wcsim.drive import messages as m
from wcsim.drive.playing.play_runner import PlayStart
from wcsim.drive.runner import DONE, FILE, JSON, LINE, PICTURES, DriveOrder
from wcsim.drive.serving.access_control import LOOPBACK, AccessControl, content_policy, new_token
from wcsim.drive.stick_watch import rests
from wcsim.errors import ConfigError, ProtocolError, WorkersError

log = logging.getLogger("wcsim.drive")
PAGE: Final = Path(__file__).parents[1] / "page"
MOST_PAGES: Final = 8
_KINDS: Final = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_MOST_REFUSED: Final = 20  # messages of a page that cannot be read
_MOST: Final = 256  # messages that wait for the drive; steps of a film add up
_PLACES: Final = (m.NewPlace, m.Again, m.Open)  # each replaces itself and those before it
_MOST_WAITING: Final = 64  # lines to a page; a page that reads too slowly loses the oldest
# Between pings. A page has half of it to answer; its stick has been at rest for long by then.
_PING_S: Final = 20.0
_SOON_S, _END_S = 0.5, 10.0  # for a page or process that answers, and for one that does not
_NUMBER = struct.Struct("<I")
_STATE: Final = b'{"say":"state"'
_TAKEN: Final = "Another page is driving. You are watching."


class DriveServer:
    """Serves one drive or film to pages, until it is cancelled or the drive's process has ended.

    Args:
        start: What is behind the page.
        host: Where it is served.
        port: 0 for a free one.
        say: Gets the address, and how each drive ended.
    """

    def __init__(
        self,
        start: DriveOrder | PlayStart,
        host: str = "127.0.0.1",
        port: int = 8080,
        say: Callable[[str], object] = log.info,
    ) -> None:
        self._start, self._host, self._port, self._say = start, host, port, say
        self._access = AccessControl(host=host, token="" if host in LOOPBACK else new_token())
        self._audience = _Audience()
        self._words = _Words()
        self._files: dict[str, bytes] = {}  # of the street around the chair, by name

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            ConfigError: The address is taken, or not this machine's.
            WorkersError: The process that is served has died.
        """
        app = web.Application(middlewares=[self._guarded])
        app.router.add_get("/socket", self._meet, allow_head=False)
        app.router.add_get("/street/{name}", self._street)
        app.router.add_get("/{name:.*}", self._page)
        app.on_shutdown.append(self._audience.close)
        # An error of a request is one line: whoever finds the address could fill a terminal.
        logger = logging.getLogger("wcsim.drive.aiohttp")
        logger.addFilter(_in_a_line)
        runner = web.AppRunner(
            app,
            access_log=None,
            logger=logger,
            keepalive_timeout=_END_S,  # also ends a connection that never asks for anything
            shutdown_timeout=_SOON_S,
            auto_decompress=False,  # nobody reads bodies
        )
        await runner.setup()
        if runner.server is not None:
            runner.server.request_factory = partial(app._make_request, _cls=_Request)
        try:
            await _listen_at(runner, self._host, self._port)
            host = f"[{self._host}]" if ":" in self._host else self._host
            token = f"?token={self._access.token}" if self._access.token else ""
            address = f"http://{host}:{runner.addresses[0][1]}/{token}"
            self._say(f"{self._start.word} at {address}  (Ctrl-C to stop)")
            self._say(self._start.begins)
            async with _running(self._start, self._words, self._told) as listening:
                await asyncio.wait([listening])
                self._audience.tell(m.spoken("notice", {"kind": "bad", "told": self._start.over}))
                await asyncio.sleep(_SOON_S)
        finally:
            await runner.cleanup()
        what = f"the {self._start.word}'s process"
        raise WorkersError(f"{what} has ended; the messages above say why: start it again")

    # --- what a browser reads ---

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Let a request through unless access control refuses it."""
        hosts, origins = request.headers.getall("Host", []), request.headers.getall("Origin", [])
        host = None if len(hosts) != 1 or len(origins) > 1 else hosts[0]
        socket = request.match_info.handler == self._meet  # whatever the path
        why = self._access.refusal(
            host, origins[0] if origins else None, request.path_qs, socket=socket
        )
        if socket and not why:
            return await handler(request)
        if request.transport is not None:
            # One answer per connection, and an end for a client that does not read it.
            asyncio.get_running_loop().call_later(_END_S, request.transport.abort)
        try:
            if why:
                raise web.HTTPForbidden(text=f"{why}\n")
            answer = await handler(request)
        except web.HTTPException as refused:
            refused.force_close()
            raise
        answer.force_close()
        return answer

    async def _page(self, request: web.Request) -> web.Response:
        """Hand out a file of the page."""
        name = request.match_info["name"] or self._start.page
        file = next(
            (each for each in PAGE.iterdir() if each.name == name and each.suffix in _KINDS), None
        )
        if file is None:
            raise web.HTTPNotFound(text="there is no such page\n")
        headers = {**_HEADERS, "Content-Security-Policy": content_policy(request.headers["Host"])}
        body, kind = file.read_bytes(), _KINDS[file.suffix]
        answer = web.Response(body=body, content_type=kind, charset="utf-8", headers=headers)
        answer.enable_compression()
        return answer

    async def _street(self, request: web.Request) -> web.Response:
        """Hand out a part of the street."""
        file = self._files.get(request.match_info["name"])
        if file is None:
            raise web.HTTPNotFound(text="this part of the street is not near any more\n")
        answer = web.Response(body=file, content_type="application/octet-stream", headers=_HEADERS)
        answer.enable_compression()
        return answer

    # --- what a page says ---

    async def _meet(self, request: web.Request) -> web.WebSocketResponse:
        """Serve one page, from its connection to its end."""
        socket = web.WebSocketResponse(
            timeout=_SOON_S,
            heartbeat=_PING_S,
            compress=False,
            max_msg_size=m.MOST_BYTES + 1,  # the shortest that is too long
            writer_limit=0,  # a write waits for a page that reads too slowly
        )
        await socket.prepare(request)
        if len(self._audience) >= MOST_PAGES and not self._audience.hang_up_silent():
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages")
            return socket
        line = _PageLine(socket, request.transport)
        writing = asyncio.create_task(line.write())
        self._audience.enter(line)
        self._ask_for_pictures()
        try:
            await self._hear(line, socket)
        finally:
            if self._audience.leave(line):
                self._words.put(m.Gone())
            writing.cancel()
            line.hang_up()  # drops what a page that reads too slowly has not read
        return socket

    async def _hear(self, line: _PageLine, socket: web.WebSocketResponse) -> None:
        refused = 0
        async for said in socket:
            if said.type not in (WSMsgType.TEXT, WSMsgType.BINARY):
                # It is too long, or the connection is lost.
                return
            line.silent = False
            try:
                message = m.of_page(said.data)
            except ProtocolError as error:
                refused += 1
                line.put(m.spoken("notice", {"kind": "refused", "told": str(error)}))
                if refused >= _MOST_REFUSED:
                    await socket.close(
                        code=WSCloseCode.POLICY_VIOLATION, message=b"not a page of wcsim"
                    )
                    return
                continue
            if isinstance(message, m.Shown):
                line.seen(message.number)
                self._ask_for_pictures()
            elif isinstance(message, m.TakeOver):
                self._words.put(m.Gone())
                self._audience.take_over(line)
            elif line is self._audience.driver:
                self._words.put(message)
            await asyncio.sleep(0)  # a page that sends much at once keeps nobody waiting

    # --- what the drive says ---

    def _told(self, data: bytes) -> None:
        kind, body = data[:1], data[1:]
        if kind == PICTURES:
            self._audience.show(body)
            self._ask_for_pictures()
        elif kind == JSON:
            self._audience.tell(body)
        elif kind == LINE:
            self._say(body.decode())
        elif kind == FILE:
            name, _, file = body.partition(b"\0")
            if name.startswith(b"models-"):  # the first file of another street
                self._files.clear()
            self._files[name.decode()] = file
        elif kind == DONE:
            self._words.done()

    def _ask_for_pictures(self) -> None:
        """Ask for pictures if a page takes them and none are on the way."""
        if self._audience.wants():
            self._words.put(m.Ready())


class _PageLine:
    """What is on its way to one page: lines in order, and only the newest state and pictures."""

    def __init__(
        self, socket: web.WebSocketResponse, transport: asyncio.Transport | None = None
    ) -> None:
        self._socket, self._transport = socket, transport
        self.silent = True  # it has sent nothing yet; a real page does so at once
        self._lines = deque[bytes](maxlen=_MOST_WAITING)
        self._state: bytes | None = None
        self._pictures: bytes | None = None
        # The number of the pictures that the page has not shown yet.
        self._on_the_way: int | None = None
        self._some = asyncio.Event()

    @property
    def free(self) -> bool:
        """Whether the page has shown all that it was sent."""
        return self._on_the_way is None and self._pictures is None

    def put(self, line: bytes) -> None:
        """Send a line."""
        if line.startswith(_STATE):
            # At full speed, a drive sends more of them than a page reads.
            self._state = line
        else:
            self._lines.append(line)
        self._some.set()

    def show(self, pictures: bytes) -> None:
        """Send pictures as soon as the page has shown the ones before."""
        self._pictures = pictures
        self._some.set()

    def seen(self, number: int) -> None:
        """The page has shown these pictures."""
        if number == self._on_the_way:
            self._on_the_way = None
            self._some.set()

    def hang_up(self) -> None:
        """End the connection at once."""
        if self._transport is not None:
            self._transport.abort()

    async def write(self) -> None:
        """Send what waits, as long as the page is there.

        The connection of a page that takes nothing for long is aborted: an orderly close could wait
        for it forever.
        """
        with suppress(ConnectionResetError, TimeoutError):
            while not self._socket.closed:
                with suppress(TimeoutError):
                    async with asyncio.timeout(_PING_S):
                        await self._some.wait()
                self._some.clear()
                async with asyncio.timeout(_PING_S):
                    await self._send()
        self.hang_up()

    async def _send(self) -> None:
        while self._lines:
            await self._socket.send_frame(self._lines.popleft(), WSMsgType.TEXT)
        if self._state is not None:
            state, self._state = self._state, None
            await self._socket.send_frame(state, WSMsgType.TEXT)
        if self._pictures is not None and self._on_the_way is None:
            pictures, self._pictures = self._pictures, None
            (self._on_the_way,) = _NUMBER.unpack_from(pictures)
            await self._socket.send_frame(pictures, WSMsgType.BINARY)


class _Audience:
    """All pages; the first one drives, then any page that asks for it."""

    def __init__(self) -> None:
        self.driver: _PageLine | None = None
        self._pages: list[_PageLine] = []
        # The last lines that a later page needs, by their `say`.
        self._kept: dict[str, bytes] = {}
        self._asked = False

    def __len__(self) -> int:
        return len(self._pages)

    def enter(self, page: _PageLine) -> None:
        """A page has come."""
        self._pages.append(page)
        self.driver = self.driver or page
        for line in self._kept.values():
            page.put(line)
        self._tell_roles()
        self._asked = False  # it has no pictures yet

    async def close(self, _: object = None) -> None:
        """The server ends."""
        for page in self._pages:
            page.hang_up()

    def leave(self, page: _PageLine) -> bool:
        """A page has gone; returns whether it drove. Then none drives until one asks or comes."""
        self._pages.remove(page)
        drove = page is self.driver
        if drove:
            self.driver = None
        self._tell_roles()
        return drove

    def hang_up_silent(self) -> bool:
        """Hang up the oldest page that never sent anything; returns whether there was one."""
        silent = next((page for page in self._pages if page.silent), None)
        if silent is not None:
            silent.silent = False  # it is hung up only once
            silent.hang_up()
        return silent is not None

    def take_over(self, page: _PageLine) -> None:
        """This page drives from now on."""
        self.driver = page
        self._tell_roles()

    def tell(self, line: bytes) -> None:
        """Send a line to all pages."""
        for name in ("about", "state", "busy", "keeping", "study", "marks", "street", "way"):
            if line.startswith(b'{"say":"%s"' % name.encode()):
                self._kept[name] = line
                if name == "about":
                    self._kept.pop("busy", None)
        for page in self._pages:
            page.put(line)

    def show(self, pictures: bytes) -> None:
        """Send new pictures to all pages."""
        self._asked = False
        for page in self._pages:
            page.show(pictures)

    def wants(self) -> bool:
        """Whether to ask for new pictures; True only once until they come."""
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


class _Words:
    """Messages to the drive in order; a new one removes those before it that it makes void."""

    def __init__(self) -> None:
        self._waiting = deque[m.PageMessage](maxlen=_MOST)
        self._busy = False  # with a slow message
        self.some = asyncio.Event()

    def put(self, message: m.PageMessage) -> None:
        """Add a message."""
        for before in [each for each in self._waiting if _says_as_much(message, each)]:
            self._waiting.remove(before)
        self._waiting.append(message)
        self.some.set()

    def take(self) -> list[m.PageMessage]:
        """Take all that waits; while a slow message is being done, only up to the next slow one."""
        said = list[m.PageMessage]()
        while self._waiting and not (self._busy and self._waiting[0].slow):
            said.append(self._waiting.popleft())
            self._busy = self._busy or said[-1].slow
        return said

    def done(self) -> None:
        """The slow message is done."""
        self._busy = False
        self.some.set()


def _says_as_much(message: m.PageMessage, before: m.PageMessage) -> bool:
    """Whether `message` makes `before` void."""
    if isinstance(message, m.End | m.Gone):
        # A page that is gone leaves nothing to do.
        return isinstance(message, m.End) or not isinstance(before, m.Ready | m.End)
    if isinstance(message, m.Stick) and isinstance(before, m.Stick):
        still_pressed = message.overrule or not before.overrule
        return still_pressed and (rests(message.x, message.y) or not rests(before.x, before.y))
    if isinstance(message, _PLACES) and isinstance(before, _PLACES):
        return _PLACES.index(type(before)) <= _PLACES.index(type(message))
    return type(message) is type(before) and not isinstance(message, m.StepBy)


@asynccontextmanager
async def _running(
    start: DriveOrder | PlayStart, words: _Words, hear: Callable[[bytes], object]
) -> AsyncIterator[asyncio.Task[None]]:
    """Run the drive's process; yields the task that reads from it until it ends.

    Another task writes the words to it. The process reads nothing while it opens a street, and a
    pipe holds little, so threads wait for it; see `_Words`. At the end it closes its end of the
    pipe last; nobody waits for its exit after that. A process that does not hear of the end gets a
    signal.
    """
    # It is no daemon: a player starts the process that makes its film.
    pipe, process = start_piped_process(start.run, name=f"wcsim-{start.word}")
    listening = asyncio.create_task(_listen(pipe, hear))
    speaking = asyncio.create_task(_speak(pipe, words))
    try:
        try:
            yield listening
        finally:
            words.put(m.End())
            await asyncio.wait([listening], timeout=_SOON_S)
            if not listening.done():
                process.terminate()
                await asyncio.wait([listening], timeout=_END_S)
    finally:  # also if the wait is cancelled
        process.kill()
        process.join()
        words.put(m.End())  # sending fails, as nobody reads, which ends `_speak`
        await asyncio.wait([listening, speaking], timeout=_END_S)
        pipe.close()


async def _listen(pipe: Connection, hear: Callable[[bytes], object]) -> None:
    # An error in `hear` does not end the listening.
    soon = asyncio.get_running_loop().call_soon
    with suppress(EOFError, OSError):
        while True:
            soon(hear, await asyncio.to_thread(pipe.recv_bytes))


async def _speak(pipe: Connection, words: _Words) -> None:
    with suppress(OSError):
        while True:
            await words.some.wait()
            words.some.clear()
            for message in words.take():
                await asyncio.to_thread(pipe.send, message)


async def _listen_at(runner: web.AppRunner, host: str, port: int) -> None:
    """Listen there. Raises ConfigError: the host is not this machine's, or the port is taken."""
    try:
        await web.TCPSite(runner, host, port).start()
    except OSError as error:
        # No error number: several addresses failed.
        of_host = isinstance(error, socket.gaierror) or error.errno in (None, errno.EADDRNOTAVAIL)
        cure = (
            "expected --host with a name or address of this machine, or 0.0.0.0 for all of them"
            if of_host
            else "choose another --port; 0 takes a free one"
        )
        raise ConfigError(
            f"{host}:{port}: cannot be served ({error.strerror or error}); {cure}"
        ) from None


class _Request(web.Request):
    """A request whose answer does not name aiohttp's version, even if the request is malformed."""

    async def _prepare_hook(self, response: web.StreamResponse) -> None:
        response.headers.popall("Server", None)


def _in_a_line(record: logging.LogRecord) -> bool:
    if record.exc_info and isinstance(record.exc_info[1], HttpProcessingError):
        return False  # malformed requests, which anybody may send as often as they like
    if record.exc_info and record.exc_info[1] is not None:
        record.msg, record.args = escape(f"{record.getMessage()}: {record.exc_info[1]!r}"), ()
        record.exc_info = None
    return True

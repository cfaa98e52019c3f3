"""The pages that look at a drive: one of them drives, each takes pictures as fast as it can show them."""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections import deque
from typing import Final

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from wcsim.drive import messages as m

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
            page.put(m.spoken(m.PageRole(drives=drives, taken=taken, told=told)))

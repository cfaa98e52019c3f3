"""The process behind a page, of a drive or of a film: it keeps time, hears what the page wants, and draws for it."""

from __future__ import annotations

import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Final

from wcsim.drive import messages as m
from wcsim.drive.pictures import Moment, PageLooks, StreetPictures, clamped
from wcsim.errors import WcsimError

JSON, PICTURES, LINE, DONE = b"J", b"P", b"L", b"D"  # what a message to the server is; the last: a slow wish is done
Does = dict[type, Callable[[Any], object]]
"""What is done about a message of the page, by its kind; it may raise WcsimError, of which the page is told."""
_LONGEST_S: Final = 1.0  # between two pictures, for the camera that comes after the chair


class PageRunner(ABC):
    """Runs until the pipe to the server ends, or it is told to end.

    Args:
        pipe: To the server.
        clock: Monotonic seconds.
    """

    def __init__(self, pipe: Connection, clock: Callable[[], float] = time.monotonic) -> None:
        self._pipe, self._now_s = pipe, clock
        self._pictures: StreetPictures | None = None
        self._looks = PageLooks()
        self._ready, self._stale = False, True  # the page takes pictures; those that it has are old
        self._over = False
        self._drawn_s = 0.0
        self._does: Does = {m.SetView: self._view, m.Ready: self._take_ready, m.End: self._end}

    def run(self) -> None:
        """Run until the server ends."""
        with suppress(EOFError, BrokenPipeError, ConnectionResetError):
            try:
                self._begin()
                while not self._over:
                    self._turn()
            finally:
                self.close()

    def leave(self, *_: object) -> None:
        """Of SIGTERM: leave at once what takes long; an end that is under way goes on."""
        if not self._over:
            self._over = True
            raise SystemExit

    @abstractmethod
    def close(self) -> None:
        """End what is shown."""

    @abstractmethod
    def _begin(self) -> None:
        """Open what is shown first."""

    @abstractmethod
    def _turn(self) -> None:
        """One turn of the loop."""

    @abstractmethod
    def _heard(self) -> None:
        """The page has said something that may show."""

    def _hear(self) -> None:
        """Do all that the page wants by now."""
        while self._pipe.poll():
            message = self._pipe.recv()
            try:
                self._does.get(type(message), _nothing)(message)
            except WcsimError as error:
                self._say(m.Notice(kind="refused", told=str(error)))
            if message.slow:
                self._pipe.send_bytes(DONE)
            if not isinstance(message, m.Stick | m.Ready | m.End):
                self._stale = True
                self._heard()

    def _draw(self, moment: Moment, pictures: StreetPictures, pace: float) -> None:
        """Send pictures of a moment; `pace` is that of time, 0 while it stands."""
        now_s = self._now_s()
        dt_s = min(_LONGEST_S, now_s - self._drawn_s) * pace
        self._pipe.send_bytes(PICTURES + pictures.draw(moment, self._looks, dt_s))
        self._ready = self._stale = False
        self._drawn_s = now_s

    def _say(self, message: m.Shows) -> None:
        self._pipe.send_bytes(JSON + m.spoken(message))

    def _log(self, told: str) -> None:
        self._pipe.send_bytes(LINE + told.encode())

    def _view(self, said: m.SetView) -> None:
        orbit = clamped(said.turn_rad, said.tilt_rad, said.distance_m)
        size = {"width_px": said.width_px, "height_px": said.height_px}
        self._looks = PageLooks(orbit=orbit, camera=said.camera, chart=said.chart, **size)

    def _take_ready(self, _: m.Ready) -> None:
        self._ready = True

    def _end(self, _: m.End) -> None:
        self._over = True


def _nothing(_: m.PageMessage) -> None:
    """Of a message that pages of the other kind say."""


def run_page(runner: PageRunner, pipe: Connection) -> None:
    """Run in a process of its own."""
    signal.signal(signal.SIGTERM, runner.leave)
    with pipe:
        runner.run()

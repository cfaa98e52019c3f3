"""What a server serves: which page, what its messages are, and the process behind it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Final

from wcsim.drive import messages as m
from wcsim.drive.playing.play_messages import of_play_page
from wcsim.drive.playing.play_runner import run_play
from wcsim.drive.runner import run_drive


@dataclass(frozen=True, slots=True, kw_only=True)
class PageKind:
    """A page, and who is behind it."""

    word: str  # for it in messages
    page: str  # its file
    of_page: Callable[[str | bytes], m.PageMessage]  # raises ProtocolError for what is no message of it
    run: Callable[[Connection, Any], None]  # what its process does, with what it begins with
    begins: str  # what is done once the address is known, for whoever started it
    ended: str  # what a page says when that process has ended


DRIVE: Final = PageKind(
    word="drive",
    page="index.html",
    of_page=m.of_page,
    run=run_drive,
    begins="starting the simulator, then the street; the page shows the progress",
    ended="The drive has ended. Start wcsim drive again.",
)
PLAY: Final = PageKind(
    word="film",
    page="play.html",
    of_page=of_play_page,
    run=run_play,
    begins="starting the player, then loading the recording",
    ended="The player has ended. Start the command again.",
)

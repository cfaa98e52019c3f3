"""Serves a page: a film for `wcsim watch`, `log play` and `replay`, a drive for `wcsim drive`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated

from wcsim.cli.shared.common import Bounds

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.drive.playing.play_runner import PlayStart
    from wcsim.drive.runner import DriveOrder

Seat = Annotated[int | None, Bounds(0, 1 << 30)]
"""The number of a chair; None for the first."""


@dataclass(kw_only=True)
class PageOptions:
    """Where a page is served."""

    port: Annotated[int, Bounds(0, 65535)] = 8080
    """Port of the page; 0 takes a free one."""
    host: str = "127.0.0.1"
    """Address to serve at; any but the loopback needs the token in the printed address."""


def serve_page(start: DriveOrder | PlayStart, page: PageOptions) -> int:
    """Serve the page until Ctrl-C."""
    import asyncio

    from wcsim.drive.serving.server import DriveServer

    try:
        asyncio.run(DriveServer(start, page.host, page.port, partial(print, flush=True)).run())
    except KeyboardInterrupt:
        print("the page is closed")
    return 0

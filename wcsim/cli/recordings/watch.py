"""`wcsim watch RUN`: the world of a running training, live on a page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from wcsim.agents.runs.run_folder import read_json
from wcsim.cli.recordings.film_page import PageOptions, Seat, serve_page
from wcsim.cli.shared.common import parse
from wcsim.core.reading import escaped, is_file, is_folder
from wcsim.errors import ConfigError

_MANIFEST: Final = "manifest.json"


@dataclass(kw_only=True)
class Options(PageOptions):
    """Watch a run live in your browser: its street, chairs, joysticks and KPIs.

    For runs with a journal: `wcsim train-clients`, `wcsim serve --run`. Does not change the run. docs/watching.md
    """

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run folder; the run may start later."""
    seat: Seat = None
    """The chair to follow first."""
    hook: str = ""
    """Your own step hook, module:Class, that the run was started with; its code runs only when you name it."""


def run(words: list[str]) -> int:
    """Serve the page until Ctrl-C."""
    options = parse(Options, words, "watch")
    if not is_folder(options.run):
        raise ConfigError(f"{escaped(options.run)}: is not there; expected the folder of a wcsim train-clients run")
    from wcsim.bridge.replay.replayed import worlds_of
    from wcsim.log.reader import part_files, read_header
    from wcsim.log.writer import JOURNAL

    if part_files(options.run / JOURNAL):  # what cannot be watched is refused before a page is served for it
        worlds_of(read_header(options.run / JOURNAL), options.hook)
    # One of several clients that has only not begun yet is waited for.
    elif is_file(options.run / _MANIFEST) and "clients" not in read_json(options.run, _MANIFEST):
        raise ConfigError(
            f"{escaped(options.run)}: this run has no journal and cannot be watched; expected a run of wcsim "
            "train-clients NETWORK (one client is enough), or of wcsim serve --run"
        )
    from wcsim.drive.playing.play_runner import PlayStart  # the simulators are loaded here, not for --help
    from wcsim.drive.playing.sources.source_process import FilmSource

    source = FilmSource(kind="run", path=options.run.absolute(), hook=options.hook, gives_way=True)
    seat = -1 if options.seat is None else options.seat
    return serve_page(PlayStart(source=source, seat=seat), options)

"""`wcsim replay RESULT`: an episode of a test, driven again; `wcsim watch RUN`: a run, live."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.agents.runs.run_folder import MANIFEST, read_run_json
from wcsim.cli.shared.common import Bounds, Seat, WebPageOptions, parse_options, serve_page
from wcsim.cli.shared.run_config import require_usable_policy
from wcsim.core.reading import escape, is_file, is_folder
from wcsim.errors import ConfigError

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.drive.playing.play_runner import PlayStart
    from wcsim.view.report.failures import FailedEpisode

RESULT: Final = "result.json"
_MOST_FAILED: Final = 200


@dataclass(kw_only=True)
class _Options(WebPageOptions):
    """Drive an episode of a suite's test again, in your browser: at first the worst failure.

    `wcsim log play` plays recordings. docs/watching.md
    """

    result: Annotated[Path, Positional, arg(metavar="RESULT")]
    """The folder of a finished test, or its result.json."""
    policy: str = ""
    """Policy of the test; by default that of the worst failure. Your own code runs only when you name it."""  # noqa: E501
    network: str = ""
    """Your own network as module:Class, where the policy is a run that was trained with it."""
    block: Annotated[int | None, Bounds(0, 1 << 30)] = None
    """Block of the test."""
    seat: Seat = None
    """Chair to follow."""


def run(words: list[str]) -> int:
    """Serve the page until Ctrl-C."""
    options = parse_options(_Options, words, "replay")
    return serve_page(_episode_start(options), options)


def _episode_start(options: _Options) -> PlayStart:
    """Where a player starts. Raises ConfigError without a result, or for a damaged one."""
    folder = options.result.parent if options.result.name == RESULT else options.result
    if not is_file(folder / RESULT):
        raise ConfigError(
            f"{escape(options.result)}: is no finished test; expected the folder of a wcsim test "
            "--suite: play a recording with wcsim log play"
        )
    from wcsim.agents.evaluation.suite.result_files import read_result
    from wcsim.cli.recordings.episode_film import send_block_film
    from wcsim.drive.playing.play_runner import FailedLine, PlayStart
    from wcsim.drive.playing.sources.source_process import FilmSource
    from wcsim.view.report.failures import failures_of

    failed = tuple(
        FailedLine(policy=one.policy, block=one.key[0], seat=one.key[1], told=_failure_text(one))
        for one in failures_of(read_result(folder), folder)[:_MOST_FAILED]
    )
    policy, seat = options.policy, options.seat
    block = -1 if options.block is None else options.block
    # What the options leave open is that of the first failure which fits them, the worst.
    for one in failed:
        if policy in ("", one.policy) and block in (-1, one.block):
            policy, block = one.policy, one.block
            seat = one.seat if seat is None else seat
            break
    # A class that is not named is not imported.
    if policy and parse_policy_name(policy).kind != "class":
        require_usable_policy(policy, options.network)
    own = tuple(name for name in (options.policy, options.network) if name)
    path = folder.absolute()
    source = FilmSource(
        kind="episode", path=path, policy=policy, block=block, own=own, drive=send_block_film
    )
    return PlayStart(source=source, seat=seat, failed=failed)


def _failure_text(failure: FailedEpisode) -> str:
    record = failure.record
    partner = f"with {record.partner}" if record.partner else ""
    words = filter(None, (failure.reason, partner, failure.whose))
    return f"{' '.join(words)}, {record.town}"


@dataclass(kw_only=True)
class _WatchOptions(WebPageOptions):
    """Watch a run live in your browser: its street, chairs, joysticks and KPIs.

    For runs with a journal: `wcsim train-clients`, `wcsim serve --run`. Does not change the run. docs/watching.md
    """  # noqa: E501

    run: Annotated[Path, Positional, arg(metavar="RUN")]
    """The run folder; the run may start later."""
    seat: Seat = None
    """The chair to follow first."""
    hook: str = ""
    """Your own step hook, module:Class, that the run was started with; its code runs only when you name it."""  # noqa: E501


def run_watch(words: list[str]) -> int:
    """Serve the page until Ctrl-C."""
    options = parse_options(_WatchOptions, words, "watch")
    if not is_folder(options.run):
        raise ConfigError(
            f"{escape(options.run)}: is not there; expected the folder of a wcsim train-clients run"
        )
    from wcsim.bridge.replay.replayed import worlds_of
    from wcsim.log.reader import list_log_parts, read_header
    from wcsim.log.writer import JOURNAL

    # What cannot be watched is refused before a page is served. A run of several clients that has
    # not started yet has no journal: the page waits for it.
    if list_log_parts(options.run / JOURNAL):
        worlds_of(read_header(options.run / JOURNAL), options.hook)
    elif is_file(options.run / MANIFEST) and "clients" not in read_run_json(options.run, MANIFEST):
        raise ConfigError(
            f"{escape(options.run)}: this run has no journal and cannot be watched; expected a "
            "run of wcsim train-clients NETWORK (one client is enough), or of wcsim serve --run"
        )
    from wcsim.drive.playing.play_runner import PlayStart  # loads the simulators
    from wcsim.drive.playing.sources.source_process import FilmSource

    source = FilmSource(kind="run", path=options.run.absolute(), hook=options.hook, gives_way=True)
    return serve_page(PlayStart(source=source, seat=options.seat), options)

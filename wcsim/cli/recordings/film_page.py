"""`wcsim replay X --page`: a journal, a trace, a drive, or an episode of a test, played on a page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from wcsim.agents.evaluation.suite.named_policy import is_own_class
from wcsim.cli.shared.named_policies import require_policy
from wcsim.core.reading import escaped, is_file, is_folder
from wcsim.errors import ConfigError

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.drive.playing.play_runner import PlayStart
    from wcsim.drive.playing.sources.source_process import SourceKind
    from wcsim.view.report.failures import FailedEpisode

RESULT: Final = "result.json"
_MOST_FAILED: Final = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmOrder:
    """What to play, as it was typed."""

    path: Path
    kind: SourceKind
    epoch: int | None
    hook: str
    town: str
    policy: str
    network: str
    block: int | None
    seat: int | None


def result_folder(path: Path) -> Path | None:
    """The folder of a finished test, where a path is one or its result.json; None for anything else."""
    if path.name == RESULT and is_file(path):
        return path.parent
    return path if is_folder(path) and is_file(path / RESULT) else None


def play_start(order: FilmOrder) -> PlayStart:
    """What a player begins with.

    Raises:
        ConfigError: Options that do not belong together, or a damaged result.
        JournalError: It is no journal, trace or drive of this version.
    """
    from wcsim.drive.playing.play_messages import FailedLine
    from wcsim.drive.playing.play_runner import PlayStart
    from wcsim.drive.playing.sources.source_process import FilmSource

    _check(order)
    failed: tuple[FailedLine, ...] = ()
    policy, block, seat = order.policy, -1 if order.block is None else order.block, order.seat
    if order.kind == "episode":
        from wcsim.drive.playing.sources.episode_source import failed_episodes

        found = failed_episodes(order.path)
        failed = tuple(
            FailedLine(policy=one.policy, block=one.key[0], seat=one.key[1], told=_told(one))
            for one in found[:_MOST_FAILED]
        )
        worst = next((one for one in failed if policy in ("", one.policy) and block in (-1, one.block)), None)
        if worst is not None:
            policy = policy or worst.policy
            block = worst.block if block < 0 else block
            seat = worst.seat if seat is None else seat
        if policy and not is_own_class(policy):  # a class that is not named is not imported
            require_policy(policy, order.network)
    source = FilmSource(
        kind=order.kind,
        path=order.path.absolute(),
        epoch=order.epoch,
        hook=order.hook,
        town=order.town,
        policy=policy,
        block=block,
        own=tuple(name for name in (order.policy, order.network) if name),
    )
    return PlayStart(source=source, seat=-1 if seat is None else seat, failed=failed)


def _told(failure: FailedEpisode) -> str:
    record = failure.record
    words = (failure.reason, f"with {record.partner}" if record.partner else "", failure.whose)
    return f"{' '.join(word for word in words if word)}, {record.town}"


def serve_film(start: PlayStart, host: str, port: int) -> int:
    """Serve the page until Ctrl-C."""
    from wcsim.drive.serving.server import PLAY, ServeOrder, serve_drive

    order = ServeOrder(start=start, kind=PLAY, host=host, port=port, say=lambda told: print(told, flush=True))
    try:
        serve_drive(order)
    except KeyboardInterrupt:
        print("the page is closed")
    return 0


def _check(order: FilmOrder) -> None:
    """Refuse what cannot be played here, before a page is served for it."""
    where = escaped(order.path)
    if order.kind != "episode" and (order.block is not None or order.policy or order.network):
        raise ConfigError(f"--policy, --network and --block are for a test; {where} is a {order.kind}: leave them out")
    if order.kind == "episode" and order.epoch is not None:
        raise ConfigError(f"--epoch is for journals and traces; {where} is a test: use --block and --seat")
    if order.kind == "episode" and order.hook:
        raise ConfigError(f"--hook is for journals; {where} is a test: leave it out")
    if order.town and order.kind != "trace":
        raise ConfigError(f"--town is for traces; {where} is a {order.kind}, which holds its town: leave it out")
    if order.kind == "journal":
        from wcsim.log.reader import read_header
        from wcsim.server.replay import journal_worlds

        journal_worlds(read_header(order.path), order.hook)
    elif order.kind == "trace":
        from wcsim.log.reader import read_states

        read_states(order.path)
    elif order.kind == "drive":
        from wcsim.log.drive import read_drive

        read_drive(order.path)

"""A block of a suite as a film: driven again by its policy, which also says what it holds for unsafe."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec

from wcsim.agents.envs.episode_view import EpisodeStep
from wcsim.agents.evaluation.suite.named_policy import config_for
from wcsim.agents.evaluation.suite.playback import require_same
from wcsim.agents.evaluation.suite.result_files import TestResult, read_result
from wcsim.agents.evaluation.suite.run import Piece, drive_piece, piece_of, town_addresses
from wcsim.agents.policy_api import UNAIDED, Policy, TellsUnsafe, Warns
from wcsim.agents.runs.policy_name import policy_name
from wcsim.bridge.world import World
from wcsim.config.suite import BlockFile
from wcsim.drive.playing.film_states import FilmAbout, FilmFrame, FilmLine, FilmNames, FilmStep, Flag, Said
from wcsim.drive.playing.sources.frame_maker import FrameMaker, TickSays, intervening, stick_of
from wcsim.errors import ConfigError
from wcsim.view.report.failures import FailedEpisode, failures_of, fate, order_of

NOT_IN_EPISODES: Final = ("Sensor errors of the camera: its picture is drawn without them.",)


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeChoice:
    """Which block of a result to drive again."""

    folder: Path
    policy: str  # "" for that of the worst failure
    block: int  # -1 for the same
    own: tuple[str, ...]  # code of the user's own that was named again


def episode_film(choice: EpisodeChoice, say: Callable[[Said], object]) -> None:
    """Drive a block to its end, and compare what is kept of it.

    Raises:
        ConfigError: The folder holds no result, or has no such block or policy.
        PolicyError, TownError: The policy or a town cannot be used.
    """
    result = read_result(choice.folder)
    policy, index = _found(result, choice)
    order = order_of(result, choice.folder, choice.own)
    piece = piece_of(order, index, policy, town_addresses(order), judged=False)
    config = config_for(piece.policy, piece.preset, piece.settings, in_list=True)
    watch = _BlockWatch(piece, say, result.suite, config.cameras[0].model_dump_json(), config.env.actions)
    records = drive_piece(piece, watch)
    watch.flush()
    kept = {(one.block, one.seat): one for one in result.episodes[policy]}
    told = [f"chair {record.seat}: {fate(record)}" for record in records]
    for record in records:
        twin = kept.get((record.block, record.seat))
        if twin is None:
            continue
        try:
            require_same(record, twin)
        except ConfigError as error:
            say(FilmLine(kind="bad", told=str(error)))
    say(FilmLine(kind="end", told="; ".join(told)))


def failed_episodes(folder: Path) -> tuple[FailedEpisode, ...]:
    """The failures of a result, worst first. Raises ConfigError when the folder holds none."""
    return failures_of(read_result(folder), folder)


def _found(result: TestResult, choice: EpisodeChoice) -> tuple[str, int]:
    """Policy and block. Raises ConfigError."""
    failures = failures_of(result, choice.folder)
    worst = next((one for one in failures if choice.policy in ("", one.policy)), None)
    first = worst.policy if worst is not None else next(iter(result.episodes))
    policy = choice.policy or first
    if policy not in result.episodes:
        raise ConfigError(f"--policy {policy!r}: not in this result; expected one of: {', '.join(result.episodes)}")
    if policy_name(policy).kind == "class" and policy not in choice.own:
        raise ConfigError(
            f"{policy} is your own code, which runs only when you name it: --policy {shlex.quote(policy)}"
        )
    block = choice.block if choice.block >= 0 else (worst.key[0] if worst is not None else 0)
    blocks = sorted({episode.block for episode in result.episodes[policy]})
    if block not in blocks:
        raise ConfigError(f"--block {block}: not in this result; expected {blocks[0]} to {blocks[-1]}")
    return policy, block


@dataclass(slots=True)
class _BlockWatch:
    """Says a step for each tick, once all seats of it were seen."""

    piece: Piece
    say: Callable[[Said], object]
    suite: str
    camera: str
    actions: str
    _maker: FrameMaker = field(default_factory=FrameMaker)
    _waiting: FilmStep | None = None
    _said: dict[int, TickSays] = field(default_factory=dict)
    _steps: dict[int, int] = field(default_factory=dict)

    @property
    def seats(self) -> frozenset[int]:
        """All of the block."""
        return frozenset(range(len(self.piece.block.episodes)))

    def see(self, seat: int, step: EpisodeStep, world: World, policy: Policy) -> None:
        """A seat has done its step."""
        if self._waiting is None or self._waiting.frame.tick != world.snapshot.tick:
            if not self._steps:
                self._begin(world, policy)
            self.flush()
            self._waiting = self._maker.step_of(world, {})
        self._steps[seat] = self._steps.get(seat, 0) + 1
        alone = self._steps[seat] <= self.piece.block.episodes[seat].handover_step
        asked, given = step.info["asked"], step.info["given"]
        flags = Flag.ALONE if alone else intervening(asked, given)
        if self.piece.policy == UNAIDED:
            flags |= Flag.UNAIDED
        if isinstance(policy, Warns) and policy.warning and not alone:
            flags |= Flag.WARNING
        unsafe = None
        if isinstance(policy, TellsUnsafe):
            unsafe = () if alone else tuple(policy.unsafe.nonzero()[0].tolist())
        self._said[seat] = TickSays(stick=asked, commanded=given, flags=flags, unsafe=unsafe)

    def ended(self, seat: int, world: World) -> None:
        """Its chair leaves the street; it was in the frame of this tick."""

    def flush(self) -> None:
        """Say the tick that waits."""
        if self._waiting is not None:
            frame = _with(self._waiting.frame, self._said)
            self.say(msgspec.structs.replace(self._waiting, frame=frame))
        self._waiting, self._said = None, {}

    def _begin(self, world: World, policy: Policy) -> None:
        block, piece = self.piece.block, self.piece
        self.say(
            FilmAbout(
                title=f"{self.suite} block {piece.index}, {block.part}, {block.town}: {piece.policy}",
                town=world.town.address,
                tick_s=world.config.world.tick_s,
                camera=self.camera,
                actions=self.actions,
                unknown=list(NOT_IN_EPISODES),
                tells_unsafe=isinstance(policy, TellsUnsafe),
                warns=isinstance(policy, Warns),
                tells_who=True,
            )
        )
        self.say(FilmNames(names=_names(block)))


def _names(block: BlockFile) -> dict[int, str]:
    return {seat: f"{seat}: {Path(episode.profile).stem}" for seat, episode in enumerate(block.episodes)}


def _with(frame: FilmFrame, said: dict[int, TickSays]) -> FilmFrame:
    """A frame with what was asked, given and thought in it."""
    chairs = []
    for chair in frame.chairs:
        one = said.get(chair.seat, TickSays())
        chairs.append(
            msgspec.structs.replace(
                chair,
                stick=stick_of(one.stick),
                commanded=stick_of(one.commanded),
                flags=int(Flag(chair.flags) | one.flags),
                unsafe=None if one.unsafe is None else list(one.unsafe),
            )
        )
    return msgspec.structs.replace(frame, chairs=chairs)

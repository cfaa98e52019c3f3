"""A block of a suite as a film: its policy drives it again, and shows its unsafe actions."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Final

from wcsim.agents.envs.episode_view import OBJECTS, EnvStepResult
from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.evaluation.suite.playback import require_same
from wcsim.agents.evaluation.suite.result_files import TestResult, read_result
from wcsim.agents.evaluation.suite.run import drive_piece, piece_of, town_addresses
from wcsim.agents.opening.named_policy import resolve_policy_config
from wcsim.agents.policy_api import UNAIDED, Policy, TellsUnsafe, Warns
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.drive.driven import is_intervention, xy_of
from wcsim.drive.playing.film_states import (
    FilmAbout,
    FilmLine,
    FilmNames,
    FrameMaker,
    Said,
    TickSays,
)
from wcsim.drive.playing.sources.source_process import FilmSource
from wcsim.errors import ConfigError
from wcsim.types import Snapshot
from wcsim.view.report.failures import failures_of, fate, order_of

NOT_IN_EPISODES: Final = ("Sensor errors of the camera: its picture is drawn without them.",)


def send_block_film(source: FilmSource, send: Callable[[Said], object]) -> None:
    """Drive a block to its end, and compare it with its saved episodes.

    Args:
        source: Where no block or policy is named, it is that of the worst failure.
        send: Called with each part of the film.

    Raises:
        ConfigError: The folder holds no result, or has no such block or policy.
        PolicyError, TownError: The policy or a town cannot be used.
    """
    result = read_result(source.path)
    policy, index = _chosen_block(result, source)
    order = order_of(result, source.path, source.own)
    piece = piece_of(order, index, policy, town_addresses(order), judged=False)
    config = resolve_policy_config(piece.policy, piece.preset, piece.settings, in_list=True)
    records = drive_piece(piece, _BlockWatch(result.suite, piece, config, send))
    saved = {(one.block, one.seat): one for one in result.episodes[policy]}
    for record in records:
        if (record.block, record.seat) in saved:
            try:
                require_same(record, saved[record.block, record.seat])
            except ConfigError as error:
                send(FilmLine(kind="bad", told=str(error)))
    fates = "; ".join(f"chair {record.seat}: {fate(record)}" for record in records)
    send(FilmLine(kind="end", told=fates))


def _chosen_block(result: TestResult, source: FilmSource) -> tuple[str, int]:
    """Policy and block. Raises ConfigError."""
    # The first failure is the worst.
    failures = [
        one for one in failures_of(result, source.path) if source.policy in ("", one.policy)
    ]
    policy = source.policy
    if not policy:
        policy = failures[0].policy if failures else next(iter(result.episodes))
    if policy not in result.episodes:
        raise ConfigError(
            f"--policy {policy!r}: not in this result; expected one of: "
            f"{', '.join(result.episodes)}"
        )
    if parse_policy_name(policy).kind == "class" and policy not in source.own:
        raise ConfigError(
            f"{policy} is your own code, which runs only when you name it: --policy "
            f"{shlex.quote(policy)}"
        )
    block = source.block
    if block < 0:
        block = failures[0].key[0] if failures else 0
    blocks = sorted({episode.block for episode in result.episodes[policy]})
    if block not in blocks:
        raise ConfigError(
            f"--block {block}: not in this result; expected {blocks[0]} to {blocks[-1]}"
        )
    return policy, block


class _BlockWatch:
    """Sends a frame for each tick, once all of its seats were seen.

    Args:
        suite: Its name.
        piece: What is driven.
        config: Of the policy.
        send: Called with each part of the film.
    """

    def __init__(
        self, suite: str, piece: Piece, config: RunConfig, send: Callable[[Said], object]
    ) -> None:
        self._suite, self._piece, self._config, self._send = suite, piece, config, send
        self._maker = FrameMaker()
        self._now: Snapshot | None = None
        self._seats: dict[int, TickSays] = {}

    @property
    def seats(self) -> frozenset[int]:
        """All of the block."""
        return frozenset(range(len(self._piece.block.episodes)))

    def see(self, seat: int, step: EnvStepResult, world: World, policy: Policy) -> None:
        """Take the step of a seat."""
        if self._now is None:
            self._send_head(world, policy)
        if not self._seats:
            # Before a chair leaves: one whose episode ends was in the street at the tick's end.
            self._maker.look(world)
            self._now = world.snapshot
        alone = step.info[OBJECTS].events.step <= self._piece.block.episodes[seat].handover_step
        user, given = step.info[OBJECTS].asked, step.info[OBJECTS].given
        unsafe: list[int] | None = None
        if isinstance(policy, TellsUnsafe):
            unsafe = [] if alone else policy.unsafe.nonzero()[0].tolist()
        self._seats[seat] = TickSays(
            stick=xy_of(user),
            commanded=xy_of(given),
            unsafe=unsafe,
            warning=isinstance(policy, Warns) and policy.warning and not alone,
            intervening=not alone and is_intervention(user, given),
            alone=alone,
            unaided=self._piece.policy == UNAIDED,
        )
        if self._now is not None and seat == self._now.clients[-1].seat:
            self._send(self._maker.frame(self._now, self._seats))
            self._seats = {}

    def ended(self, seat: int, world: World) -> None:
        """Its chair leaves the street; it was in the frame of this tick."""

    def _send_head(self, world: World, policy: Policy) -> None:
        block, piece = self._piece.block, self._piece
        place = f"block {piece.index}, {block.part}, {block.town}"
        self._send(
            FilmAbout(
                title=f"{self._suite} {place}: {piece.policy}",
                town=world.town.address,
                tick_s=world.config.world.tick_s,
                camera=self._config.cameras[0].model_dump_json(),
                actions=self._config.env.actions,
                unknown=list(NOT_IN_EPISODES),
                tells_unsafe=isinstance(policy, TellsUnsafe),
                warns=isinstance(policy, Warns),
                tells_who=True,
            )
        )
        names = {
            seat: f"{seat}: {Path(episode.profile).stem}"
            for seat, episode in enumerate(block.episodes)
        }
        self._send(FilmNames(names=names))

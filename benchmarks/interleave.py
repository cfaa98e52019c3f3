"""Worlds beside each other in one measurement: each in a process of its own, taking turns, so that all meet one load.

libsumo holds one simulation a process, so what is compared must live apart; and a machine's speed changes from minute
to minute, so that figures of different runs cannot be compared at all.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Protocol

from wcsim.errors import SumoError, WcsimError

_ANSWER_S = 300.0


class Runner(Protocol):
    """What takes turns; it is made in its own process."""

    def tick(self) -> tuple[float, ...]:
        """One tick; the numbers that were measured in it."""

    def close(self) -> None:
        """End it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contestant:
    """Who takes part: `make` must be picklable, and so must what it is given."""

    make: Callable[..., Runner]
    given: tuple[object, ...]
    ticks: int = 1  # in a turn: what ticks in a row keeps its data in the caches, as it does when it is alone


def in_turns(
    contestants: Sequence[Contestant], rounds: int, progress: Callable[[int], object]
) -> tuple[list[tuple[float, ...]], ...]:
    """Let all of them take `rounds` turns; what each tick of each of them gave.

    Raises:
        SumoError: One of the processes died or hangs.
        WcsimError: What a contestant raised when it was made, or in a tick.
    """
    context = multiprocessing.get_context("spawn")
    rows: tuple[list[tuple[float, ...]], ...] = tuple([] for _ in contestants)
    with ExitStack() as held:
        ends = []
        for contestant in contestants:
            mine, theirs = context.Pipe()
            child = context.Process(target=_serve, args=(theirs, contestant.make, contestant.given), daemon=True)
            child.start()
            theirs.close()
            held.callback(child.join, 10.0)
            held.callback(child.terminate)
            ends.append(held.enter_context(mine))
        for end in ends:
            _answer(end)
        for number in range(rounds):
            for contestant, end, found in zip(contestants, ends, rows, strict=True):
                _ask(end, contestant.ticks)
                found += _answer(end)
            progress(number + 1)
    return rows


def _ask(end: Connection, ticks: int) -> None:
    """Have a contestant take its turn. Raises SumoError when it is gone."""
    try:
        end.send(ticks)
    except OSError:  # a broken pipe of ours is nobody who has read enough of the output
        raise _gone() from None


def _answer(end: Connection) -> list[tuple[float, ...]]:
    """What a contestant has measured. Raises what it raised, SumoError when it died or hangs."""
    try:
        told: list[tuple[float, ...]] | WcsimError | None = end.recv() if end.poll(_ANSWER_S) else None
    except (EOFError, OSError):
        told = None
    if told is None:
        raise _gone()
    if isinstance(told, WcsimError):
        raise told
    return told


def _gone() -> SumoError:
    return SumoError("a world of the comparison died or hangs; run `wcsim doctor`, then try again")


def _serve(end: Connection, make: Callable[..., Runner], given: tuple[object, ...]) -> None:
    """One contestant; an error of wcsim's own is told in place of an answer."""
    try:
        _take_turns(end, make, given)
    except WcsimError as error:
        with suppress(OSError):
            end.send(error)


def _take_turns(end: Connection, make: Callable[..., Runner], given: tuple[object, ...]) -> None:
    """So many ticks for each message, their numbers as the answer."""
    runner = make(*given)
    try:
        end.send([])
        while True:
            try:
                ticks = end.recv()
            except EOFError:
                return
            end.send([runner.tick() for _ in range(ticks)])
    finally:
        runner.close()

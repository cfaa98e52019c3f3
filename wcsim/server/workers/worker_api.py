"""A piece of work, what it needs, what becomes of it, and the one interface of those that do it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

At = Callable[[str], str]
"""Where that which the machine that sends calls by this address lies on the machine that works."""

Call = Callable[[Any, At], bytes]
"""A function of a module: does a piece of work; what comes back is one compressed piece of bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parcel:
    """Files below a folder that a piece of work reads; they travel to machines that have no disk in common."""

    address: str  # what the piece calls it
    folder: Path
    names: tuple[str, ...]  # of files in it
    inner: str = ""  # what the address means in it: "" is the folder
    kept: bool = False  # it is wanted again, as a town is: a machine keeps it in its cache, by its hash


Needs = Callable[[Any], tuple[Parcel, ...]]


def _nothing_needed(_piece: Any) -> tuple[Parcel, ...]:
    """What a piece needs that is made of words alone."""
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """One piece, under a key that says what it is wherever it is done, and however often."""

    key: str
    call: Call
    piece: Any  # what is sent
    needs: Needs = _nothing_needed


Facts = Mapping[str, str | int | float]


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkEnd:
    """What a worker has come to with a piece: `data`, or an `error` that is final, or neither: the piece is lost."""

    worker: str
    key: str
    data: bytes | None = None
    error: BaseException | None = None
    lost: str = ""  # why
    counts: bool = True  # whether the piece may have killed the worker, rather than its machine have gone
    facts: Facts = field(default_factory=dict)  # for the log


class Workers(Protocol):
    """Those who do the work, one piece at a time each; who they are may change at any time."""

    def names(self) -> tuple[str, ...]:
        """Who there is now, busy or not. Raises WorkersError when it can no longer be known."""

    def begin(self, worker: str, work: Work) -> None:
        """Give a piece to a worker that has none."""

    def ended(self, timeout_s: float) -> list[WorkEnd]:
        """What has come back; waits a while for it. Raises WorkersError as `names`."""

    def stop(self, worker: str) -> None:
        """End what a worker is at; it is heard of as lost."""

    def close(self) -> None:
        """End all at once."""

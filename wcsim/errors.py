"""Every error that wcsim raises on purpose.

    WcsimError                      exit code 2 at the command line, one or two lines, no traceback
    ├── FileError                   a file cannot be read, or is invalid
    │   ├── ConfigError             ... or an option has an invalid value
    │   ├── TownError               ... a town, net or scene is missing, broken or refused
    │   ├── JournalError            ... a journal, a ledger or a recording of a world is damaged
    │   └── PolicyError             ... a policy, a checkpoint or a run folder cannot be loaded
    ├── SumoError                   SUMO or one of its tools failed
    ├── HookError                   a user's own step hook cannot be used, or failed
    ├── PhysicsError                the physics engine refused a body or left the finite numbers
    ├── DiskFullError               a record could not be written; earlier records are intact
    │   └── UnwritableError         ... because its place takes no files, however much room there is
    ├── ReplayMismatchError         what was recomputed from a journal differs from the journal
    ├── WorldInUseError             this process already has a world
    ├── WorkersError                all workers of a run are gone, or die repeatedly
    ├── LinkError                   the world at the other end of a link
    │   ├── LinkTimeoutError        ... did not answer in time
    │   │   └── TickTimeoutError    ... because another client did not act; names it
    │   ├── LinkClosedError         ... is gone
    │   │   └── ServerGoneError     ... and did not come back in time
    │   ├── AccessError             ... refuses this client's key, or shows a wrong key
    │   ├── WorldRestartedError     ... started a new epoch; the episode was cut
    │   ├── MembershipError         the seat is not this client's
    │   │   ├── SeatTakenError      ... but another client's, or does not exist
    │   │   ├── WorldFullError      ... and no other is free
    │   │   ├── EvictedError        ... any more: the server dropped the client
    │   │   ├── StaleSessionError   ... as far as this server knows
    │   │   └── NotMasterError      ... or may not restart the world
    │   └── ProtocolError           a message does not fit the state of the link
    │       ├── VersionMismatchError, ConfigMismatchError
    │       ├── StaleTickError, FutureTickError
    │       ├── BadActionError      not an action or joystick position, or a second one for a tick
    │       ├── OverloadedError     more or larger messages than the server accepts
    │       └── PicturesError       shared memory exists, but has no pictures of this version
    └── InterruptedRunError         the user stopped the run; what was done is saved

A message says what was wrong, what was got, what was expected, and what to do.
"""

from __future__ import annotations

import contextlib
import difflib
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class WcsimError(Exception):
    """Base of all errors that wcsim raises on purpose."""


class FileError(WcsimError):
    """Base of the errors for unreadable and invalid files; one class per kind of file."""


class ConfigError(FileError):
    """Raised when a configuration file or option holds an unknown key or a value out of bounds."""


class TownError(FileError):
    """Raised when a town, net or scene is missing, broken, or refused for this use."""


class JournalError(FileError):
    """Raised when a journal, a ledger or a recording of a world cannot be read, or is damaged."""


class SumoError(WcsimError):
    """Raised when SUMO or one of its tools failed."""


class HookError(WcsimError):
    """Raised when a user's own step hook cannot be created, or failed in a step."""


class PhysicsError(WcsimError):
    """Raised when the physics engine refused a body, or its state is not finite any more."""


class DiskFullError(WcsimError):
    """Raised when a disk is full; the file ends with the last whole record."""


class UnwritableError(DiskFullError):
    """Raised when a place takes no files: it is missing, read-only, or another user's."""


class ReplayMismatchError(WcsimError):
    """Raised when a world recomputed from its journal differs from that journal."""


class WorldInUseError(WcsimError):
    """Raised when a process that has a world requests a second one; use the process link."""


class WorkersError(WcsimError):
    """Raised when all workers of a run are gone, or die repeatedly at the same piece."""


class LinkError(WcsimError):
    """Base of a client's errors when the world at the other end of its link fails."""


class LinkTimeoutError(LinkError):
    """Raised when the world did not answer before the deadline."""


class LinkClosedError(LinkError):
    """Raised when the world at the other end has ended."""


class TickTimeoutError(LinkTimeoutError):
    """Raised when a tick did not come because other clients did not act; names them."""


class ServerGoneError(LinkClosedError):
    """Raised when the server is silent and cannot be reached again."""


class AccessError(LinkError):
    """Raised when a server refuses a client's key, or is not the expected server."""


class WorldRestartedError(LinkError):
    """Raised when the world started a new epoch; the link has the new episode's first frame."""


class MembershipError(LinkError):
    """Base of a client's errors when it may not do what it requests."""


class SeatTakenError(MembershipError):
    """Raised when a client claims a seat that belongs to another one or does not exist."""


class WorldFullError(MembershipError):
    """Raised when a client requests any seat and none is free."""


class EvictedError(MembershipError):
    """Raised when the server dropped a client that hung or ended; join again for a new episode."""


class StaleSessionError(MembershipError):
    """Raised for a message of a session that the server does not know."""


class NotMasterError(MembershipError):
    """Raised when a client that is not the master requests a new world."""


class ProtocolError(LinkError):
    """Raised when a message does not fit the state of the link."""


class VersionMismatchError(ProtocolError):
    """Raised when client and server have different versions of the protocol; names both."""


class ConfigMismatchError(ProtocolError):
    """Raised when a client expects a world of another configuration; names both hashes."""


class StaleTickError(ProtocolError):
    """Raised for an action of a tick that is over."""


class FutureTickError(ProtocolError):
    """Raised for an action of a future tick."""


class BadActionError(ProtocolError):
    """Raised for an invalid action, or a different second one for the same tick."""


class OverloadedError(ProtocolError):
    """Raised when a client sends more or larger messages than the server accepts."""


class PicturesError(ProtocolError):
    """Raised when the shared memory of a seat has no pictures of this version."""


class PolicyError(FileError):
    """Raised when a policy or a run folder cannot be loaded."""


class InterruptedRunError(WcsimError):
    """Raised when the user stopped a run; everything done so far is saved and usable."""


def check_installed(
    need: str, extra: str, *modules: str, error: type[WcsimError] = ConfigError
) -> None:
    """Raise `error` where one of these modules, which an extra brings, is not installed.

    Args:
        need: What needs what, as "--cluster needs Ray".
        extra: The extra of wcsim.
        modules: Top-level names.
        error: The class of the error.
    """
    for name in modules:
        # A finder may refuse a module, too.
        with contextlib.suppress(ImportError):
            if find_spec(name) is not None:
                continue
        raise error(f"{need}, which is not installed: pip install 'wcsim[{extra}]'") from None


def meant(word: str, known: Iterable[str]) -> str:
    """A question for the end of an error: the nearest known word, "" where none is near.

    >>> meant("folow", ["follow", "stop"]), meant("xyz", ["follow"])
    ("; did you mean 'follow'?", '')
    """
    near = nearest(word, known)
    return f"; did you mean {near!r}?" if near else ""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that is nearest to one that was typed, "" where none is near."""
    found = difflib.get_close_matches(word[:80].lower(), list(known), n=1, cutoff=0.7)
    return found[0] if found else ""

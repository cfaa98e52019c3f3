"""Every error that wcsim raises on purpose.

    WcsimError                      exit code 2 at the command line, one or two lines, no traceback
    ├── FileError                   a file cannot be read, or is not what it should be
    │   ├── ConfigError             ... or an option holds something that cannot be used
    │   ├── TownError               ... a town, net or scene is missing, broken or refused
    │   ├── JournalError            ... a journal, a ledger or a recording of a world is damaged
    │   └── PolicyError             ... a policy, a checkpoint or a run folder cannot be loaded
    ├── SumoError                   SUMO or one of its tools failed
    ├── HookError                   a user's own step hook cannot be used, or failed
    ├── PhysicsError                the physics engine refused a body or left the finite numbers
    ├── DiskFullError               a record could not be written; what was written before is whole
    ├── ReplayMismatchError         what was recomputed from a journal is not what the journal says
    ├── WorldInUseError             this process holds a world already
    ├── WorkersError                those who drive for a run are gone, or die at it again and again
    ├── LinkError                   the world at the other end of a link
    │   ├── LinkTimeoutError        ... did not answer in time
    │   │   └── TickTimeoutError    ... because somebody else did not act; names who
    │   ├── LinkClosedError         ... is gone
    │   │   └── ServerGoneError     ... and did not come back within the time for reconnecting
    │   ├── AccessError             ... refuses this client's key, or shows another than it should
    │   ├── WorldRestartedError     ... began a new epoch; the episode was cut, go on with its first frame
    │   ├── MembershipError         the seat is not this client's
    │   │   ├── SeatTakenError      ... but another client's, or not there
    │   │   ├── WorldFullError      ... and no other is free
    │   │   ├── EvictedError        ... any more: the server gave the client up
    │   │   ├── StaleSessionError   ... as far as this server knows
    │   │   ├── NotMasterError      ... or has no right to tick or to rebuild
    │   │   └── StaleTermError      ... or had that right once
    │   └── ProtocolError           a message does not fit the state of the link
    │       ├── VersionMismatchError, ConfigMismatchError
    │       ├── StaleTickError, FutureTickError
    │       ├── BarrierNotFullError a tick was asked for before everybody acted
    │       ├── BadActionError      no action of the set or joystick position, or a second one for a tick
    │       ├── OverloadedError     more, or larger, messages than the server takes
    │       └── PicturesError       shared memory is there, and holds no pictures of this version
    └── InterruptedRunError         the user stopped the run; what was done is saved

A message says what was wrong, what was got, what was expected, and what to do.
"""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class WcsimError(Exception):
    """Base of all errors that wcsim raises on purpose."""


class FileError(WcsimError):
    """Base of what is raised for a file that cannot be read or is not what it should be; one class a kind of file."""


class ConfigError(FileError):
    """Raised when a configuration file or option holds an unknown key or a value out of bounds."""


class TownError(FileError):
    """Raised when a town, net or scene is missing, broken, or refused for this use."""


class JournalError(FileError):
    """Raised when a journal, a ledger or a recording of a world cannot be read, or is damaged."""


class SumoError(WcsimError):
    """Raised when SUMO or one of its tools failed."""


class HookError(WcsimError):
    """Raised when a user's own step hook cannot be made, or failed in a step."""


class PhysicsError(WcsimError):
    """Raised when the physics engine refused a body, or its state left the finite numbers."""


class DiskFullError(WcsimError):
    """Raised when a record could not be written, as on a full disk; the file ends with the last whole one."""


class ReplayMismatchError(WcsimError):
    """Raised when a world that was made again from its journal is not the one that the journal tells of."""


class WorldInUseError(WcsimError):
    """Raised when a second world is asked for in a process that holds one; use the process link."""


class WorkersError(WcsimError):
    """Raised when processes or machines that work for a run are all gone, or die at the same piece again and again."""


class LinkError(WcsimError):
    """Base of what a client sees when the world at the other end of its link fails."""


class LinkTimeoutError(LinkError):
    """Raised when the world did not answer before the deadline."""


class LinkClosedError(LinkError):
    """Raised when the world at the other end has ended."""


class TickTimeoutError(LinkTimeoutError):
    """Raised when a tick did not come because others did not act; the message names them."""


class ServerGoneError(LinkClosedError):
    """Raised when the server is silent and could not be reached again."""


class AccessError(LinkError):
    """Raised when a server does not let a client in that has no key it knows, or is not the server it should be."""


class WorldRestartedError(LinkError):
    """Raised when the world began a new epoch: the client's episode was cut; its link holds the new first frame."""


class MembershipError(LinkError):
    """Base of what a client sees that has no right to what it asks for."""


class SeatTakenError(MembershipError):
    """Raised when a client claims a seat that another one has, or that the world does not have."""


class WorldFullError(MembershipError):
    """Raised when a client asks for any seat and none is free."""


class EvictedError(MembershipError):
    """Raised when the server gave this client up, as one that hung; join again to go on in another episode."""


class StaleSessionError(MembershipError):
    """Raised for a message of a session that the server does not know (any more)."""


class NotMasterError(MembershipError):
    """Raised when a client that is not the master asks for a tick or for a new world."""


class StaleTermError(MembershipError):
    """Raised when a former master asks for a tick."""


class ProtocolError(LinkError):
    """Raised when a message does not fit the state of the link."""


class VersionMismatchError(ProtocolError):
    """Raised when client and server speak different versions of the protocol; names both."""


class ConfigMismatchError(ProtocolError):
    """Raised when a client expects a world of another configuration; names both hashes."""


class StaleTickError(ProtocolError):
    """Raised for an action of a tick that is long over."""


class FutureTickError(ProtocolError):
    """Raised for an action of a tick that has not come."""


class BarrierNotFullError(ProtocolError):
    """Raised when a tick is asked for while somebody has not acted."""


class BadActionError(ProtocolError):
    """Raised for what is no action or joystick position, or differs from what was given before for the same tick."""


class OverloadedError(ProtocolError):
    """Raised when a client sends more, or larger, messages than the server takes."""


class PicturesError(ProtocolError):
    """Raised when the shared memory of a seat is no ring of pictures as this version makes them."""


class PolicyError(FileError):
    """Raised when a policy or a run folder cannot be loaded."""


class InterruptedRunError(WcsimError):
    """Raised when the user stopped a run; everything done so far is saved and usable."""


def meant(word: str, known: Iterable[str]) -> str:
    """For the end of an error: a question with the known word that is nearest, "" where none is near.

    >>> meant("folow", ["follow", "stop"]), meant("xyz", ["follow"])
    ("; did you mean 'follow'?", '')
    """
    near = nearest(word, known)
    return f"; did you mean {near!r}?" if near else ""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that is nearest to one that was typed, "" where none is near."""
    found = difflib.get_close_matches(word[:80].lower(), list(known), n=1, cutoff=0.7)
    return found[0] if found else ""

"""How commands end: the one table of exit codes, and which error ends with which."""

from enum import IntEnum

from wcsim import errors

_ON_THE_WAY = (
    *(
        errors.DiskFullError,
        errors.LinkClosedError,
        errors.LinkTimeoutError,
        errors.EvictedError,
        errors.StaleSessionError,
        errors.PhysicsError,
    ),
    errors.WorkersError,
)


class ExitCode(IntEnum):
    """The codes; 130, 141 and 143 are those that a shell gives to the signals."""

    DONE = 0  # all that was asked for
    FAILED = 1  # something broke on the way, as a disk that is full; what was saved before is kept
    REFUSED = 2  # what was asked for cannot be used; something has to be changed first
    STOPPED = 3  # ended when asked; the work is kept, and wcsim resume RUN goes on with it
    INTERRUPTED = 130  # ended by Ctrl-C with nothing to keep
    BROKEN_PIPE = 141  # whoever read the output has seen enough
    TERMINATED = 143  # ended by SIGTERM with nothing to keep


class NothingSavedInterrupt(KeyboardInterrupt):
    """Raised when a command was stopped before there was anything to keep."""


def exit_code_from_error(error: errors.WcsimError) -> ExitCode:
    """How a command ends that met this error."""
    if isinstance(error, errors.InterruptedRunError):
        return ExitCode.STOPPED
    failed = isinstance(error, _ON_THE_WAY) and not isinstance(error, errors.UnwritableError)
    return ExitCode.FAILED if failed else ExitCode.REFUSED

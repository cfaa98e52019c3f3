"""Every error that wcsim raises on purpose.

    WcsimError                      exit code 2 at the command line, one or two lines, no traceback
    ├── ConfigError                 a file or option holds something that cannot be used
    ├── TownError                   a town, net or scene is missing, broken or refused
    ├── SumoError                   SUMO or one of its tools failed
    ├── HookError                   a user's own step hook cannot be used, or failed
    ├── PhysicsError                the physics engine refused a body or left the finite numbers
    ├── WorldInUseError             this process holds a world already
    ├── LinkError                   the world at the other end of a link
    │   ├── LinkTimeoutError        ... did not answer in time
    │   ├── LinkClosedError         ... is gone
    │   └── ProtocolError           ... answered something that was not asked for
    ├── PolicyError                 a policy or run folder cannot be loaded
    └── InterruptedRunError         the user stopped the run; what was done is saved

A message says what was wrong, what was got, what was expected, and what to do.
"""


class WcsimError(Exception):
    """Base of all errors that wcsim raises on purpose."""


class ConfigError(WcsimError):
    """Raised when a configuration file or option holds an unknown key or a value out of bounds."""


class TownError(WcsimError):
    """Raised when a town, net or scene is missing, broken, or refused for this use."""


class SumoError(WcsimError):
    """Raised when SUMO or one of its tools failed."""


class HookError(WcsimError):
    """Raised when a user's own step hook cannot be made, or failed in a step."""


class PhysicsError(WcsimError):
    """Raised when the physics engine refused a body, or its state left the finite numbers."""


class WorldInUseError(WcsimError):
    """Raised when a second world is asked for in a process that holds one; use the process link."""


class LinkError(WcsimError):
    """Base of what a client sees when the world at the other end of its link fails."""


class LinkTimeoutError(LinkError):
    """Raised when the world did not answer before the deadline."""


class LinkClosedError(LinkError):
    """Raised when the world at the other end has ended."""


class ProtocolError(LinkError):
    """Raised when a message does not fit the state of the link."""


class PolicyError(WcsimError):
    """Raised when a policy or a run folder cannot be loaded."""


class InterruptedRunError(WcsimError):
    """Raised when the user stopped a run; everything done so far is saved and usable."""

"""The former home of `wcsim.server.specs`; its names still work, with a DeprecationWarning."""

from __future__ import annotations

import warnings

from wcsim.server import specs

_NEW = {"JoinOrder": "SeatRequest", "ServerOrder": "WorldSpec"}


def __getattr__(name: str) -> object:
    """The class of that name, from where it is now; raises AttributeError for what never was here."""
    if name not in _NEW:
        raise AttributeError(f"module 'wcsim.server.orders' has no attribute {name!r}")
    now = f"wcsim.server.specs.{_NEW[name]}"
    warnings.warn(f"wcsim.server.orders.{name} is {now} now", DeprecationWarning, stacklevel=2)
    return getattr(specs, _NEW[name])

"""Network bodies by name, and the Q network made of them.

A new network is a file here, a line in `names.py` and one in `registry.py`.
"""

from __future__ import annotations

import warnings


def __getattr__(name: str) -> object:
    """`ObservationEncoder`, which lived here before; raises AttributeError for anything else."""
    if name != "ObservationEncoder":
        raise AttributeError(f"module 'wcsim.agents.networks' has no attribute {name!r}")
    from wcsim.agents.networks.encoder import ObservationEncoder

    new = "wcsim.agents.networks.encoder.ObservationEncoder"
    warnings.warn(f"wcsim.agents.networks.ObservationEncoder is {new} now", DeprecationWarning, stacklevel=2)
    return ObservationEncoder

"""Where the outputs of a world go.

What a world and those who order one both know, without a simulator.
"""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlace:
    """Where the outputs of a world go, and what else its user asks of SUMO."""

    folder: Path | None = (
        None  # a run folder; without one everything SUMO writes goes when the world closes
    )
    outputs: tuple[str, ...] = ()  # more outputs than the scenario's own: "fcd", "tripinfo", ...
    hook: str = ""  # a user's own module:Class, see `bridge/sumo/step_hook.py`

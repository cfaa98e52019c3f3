"""Where the outputs of a world go; a world and those who order one know it without a simulator."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPlace:
    """Where the outputs of a world go, and what else its user requests of SUMO."""

    # A run folder; without one everything SUMO writes is removed when the world closes.
    folder: Path | None = None
    outputs: tuple[str, ...] = ()  # more outputs than the scenario's own: "fcd", "tripinfo", ...
    hook: str = ""  # a user's own module:Class, see `bridge/sumo/step_hook.py`

"""A scenario's first steps, in a process that may die.

`python -m wcsim.bridge.sumo.first_steps SUMOCFG STEP_S STEPS WORD [WARMUP_S DIGEST SCALE]`

It prints WORD when it has run them once; then it starts anew. With a warm-up, they are the first
after it, and the traffic begins from a saved state.
"""

import sys
from pathlib import Path

from wcsim.bridge.sumo.session import SumoOptions, SumoSession
from wcsim.config import WorldConfig
from wcsim.errors import WcsimError
from wcsim.towns.scenario.overrides import Settings


def main() -> int:
    """Run the scenario that the command line names."""
    settings = Settings(world=WorldConfig(tick_s=float(sys.argv[2])), seed=1)
    warmup_s, digest, scale = sys.argv[5:] or ("0", "", "1")
    options = SumoOptions(
        sumocfg=Path(sys.argv[1]),
        origin_m=(0.0, 0.0),
        settings=settings,
        author_scale=float(scale),
        warmup_s=float(warmup_s),
        digest=digest,
    )
    try:
        with SumoSession(options) as session:
            _steps(session, int(sys.argv[3]))
            sys.stdout.write(f"{sys.argv[4]}\n")
            sys.stdout.flush()
            # A world does so too, and what SUMO holds of the first time may kill it.
            session.rebuild(seed=2)
            _steps(session, int(sys.argv[3]) // 10)
    # SUMO's own words alone: the parent knows of which scenario.
    except WcsimError as error:
        sys.stderr.write(f"Error: {error.__context__ or error}\n")
        return 1
    return 0


def _steps(session: SumoSession, count: int) -> None:
    for _ in range(count):
        session.step()


if __name__ == "__main__":
    raise SystemExit(main())

"""`python -m wcsim.scenes.process FOLDER TRACE`: runs one scene and writes its facts as a line of JSON."""

from __future__ import annotations

import sys
from pathlib import Path

from wcsim.errors import WcsimError
from wcsim.scenes.facts import facts_line
from wcsim.scenes.run import BAD_SCENE, run_scene


def main() -> int:
    """Run the scene that the command line names."""
    try:
        facts = run_scene(Path(sys.argv[1]), Path(sys.argv[2]))
    except WcsimError as error:
        sys.stderr.write(f"{error}\n")
        return BAD_SCENE
    sys.stdout.write(facts_line(facts) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

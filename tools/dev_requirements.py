"""Print the packages of the group `dev` in pyproject.toml, for pip releases without dependency groups."""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
print(" ".join(f"{item!s}" for item in [*project["dependency-groups"]["dev"], "editables"]))

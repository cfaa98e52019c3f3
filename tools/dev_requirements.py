"""Print the development tools of pyproject.toml's group `dev`, for pip releases that do not know groups yet."""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
print(" ".join(f"{item!s}" for item in [*project["dependency-groups"]["dev"], "editables"]))

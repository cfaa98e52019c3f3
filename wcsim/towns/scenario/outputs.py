"""Names for the files that a scenario writes: each in one folder, none twice, none that leads anywhere else."""

from __future__ import annotations

import os
import re
from pathlib import Path

from wcsim.errors import TownError

NOWHERE = ("", "NUL", "nul", "/dev/null")  # "NULL" is a file of that name to SUMO
_UNSAFE = re.compile(r"[^A-Za-z0-9_.-]+")
_MAX_LENGTH = 120
_SUMO_SPLITS_AT = ",:;$%"  # lists, sockets and substitutions in SUMO's file names


class OutputNames:
    """The files that a scenario writes into one folder; equal places of the author's are the same file here too."""

    def __init__(self, folder: Path) -> None:
        """Raises TownError for a folder whose name SUMO does not take for one."""
        strange = sorted(set(str(folder)) & set(_SUMO_SPLITS_AT))
        if strange:
            raise TownError(f"{folder}: SUMO cannot write to a path with {' '.join(strange)} in it; choose another")
        self.folder = folder
        self._of_author: dict[str, Path] = {}
        self._taken: set[str] = set()

    @property
    def paths(self) -> tuple[Path, ...]:
        """All of them, sorted."""
        return tuple(sorted(self._of_author.values()))

    def place(self, author: str, base: Path, instead: str) -> Path:
        """Where the file goes that the author named `author` in a file of the folder `base`.

        Args:
            author: As it is written; a path, a socket, or a name for the console.
            base: The folder that relative names are taken from.
            instead: The name to use when the author's has none that can be used.
        """
        key = os.path.normpath(base / author)
        if key not in self._of_author:
            name = _UNSAFE.sub("_", Path(author).name).strip("_.-")[-_MAX_LENGTH:].lstrip("_.-")
            if author in ("stdout", "stderr", "-") or not name:
                name = instead
            self._of_author[key] = self.folder / self.unique(name)
        return self._of_author[key]

    def unique(self, name: str) -> str:
        """The name, with a number in it when it is taken; it is taken from now on."""
        stem, dot, endings = name.partition(".")
        number, found = 1, name
        while found.lower() in self._taken:
            number += 1
            found = f"{stem}-{number}{dot}{endings}"
        self._taken.add(found.lower())
        return found

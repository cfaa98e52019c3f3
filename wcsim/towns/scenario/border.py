"""How far a scenario may reach: files that lie outside of its folder are neither opened nor copied unasked."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path

from wcsim.core.reading import is_file, shown
from wcsim.errors import TownError

_ALLOW = "--allow-outside"


def require_inside(path: Path, border: Path | None, named_by: Path) -> None:
    """Return when a file lies in the folder `border`, links followed; None is no border.

    Raises:
        TownError: It lies elsewhere, whether it exists or not; or no system could hold such a file.
    """
    try:
        real = Path(os.path.realpath(path))
        if border is None or real.is_relative_to(os.path.realpath(border)):
            return
    except ValueError as error:  # NUL in the path
        raise TownError(f"{shown(named_by)}: names {shown(path)} ({error}); correct the name") from None
    raise TownError(
        f"{shown(named_by)}: names {shown(path)}, which is outside of its folder {shown(border)}; move it there and "
        f"correct the name, or permit files elsewhere: {_trust(named_by)}"
    )


def _trust(named_by: Path) -> str:
    """How a scenario is trusted; a copy of it is for every command."""
    some = f"{_ALLOW} of wcsim town run and pave"
    if named_by.suffix != ".sumocfg":
        return f"{some}, and of wcsim town import, which makes a copy for all others"
    path, name = named_by.absolute(), re.sub(r"[^A-Za-z0-9_-]", "_", named_by.absolute().parent.name)[:64] or "town"
    return (
        f"{some}, or a copy for all commands: wcsim town import --sumocfg {shlex.quote(shown(path, 4096))} "
        f"--name {name} {_ALLOW}"
    )


def require_file(path: Path, border: Path | None, named_by: Path) -> None:
    """Return when a file lies in the folder `border` and is a regular one. Raises TownError."""
    require_inside(path, border, named_by)
    if not is_file(path):
        raise TownError(
            f"{shown(named_by)}: names a file that does not exist: {shown(path)}; restore it or correct "
            f"{shown(named_by.name)}"
        )
    if "," in str(path):
        raise TownError(f"{shown(path)}: SUMO splits file names at commas; rename the file or its folder")

"""SUMO's command line tools as children, with limits on time and memory."""

import importlib.util
import os
import re
import resource
import signal
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

from wcsim.core.processes import run_command
from wcsim.errors import SumoError

UTF_8 = "C.UTF-8"  # the locale in which file names have any letters
_NOT_FOUND: Final = re.compile(r"\b(lib[\w.+-]+?\.so[.\d]*): cannot open shared object file")
_NOT_STARTED = 127  # what the loader ends with where a library is not there
SYSTEM_PACKAGES: Final = "libgl1 libxext6 libxrender1 libatomic1"
"""Of Debian and Ubuntu.

What SUMO's wheels leave to the system, and a machine without a screen may not have.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a child may use before it is ended."""

    wall_s: float = 300.0
    cpu_s: int = 240
    memory_bytes: int = 4 << 30
    file_bytes: int = 1 << 30


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolRun:
    """How a tool ended; a negative return code is the signal that killed it, as in `subprocess`."""

    name: str
    returncode: int
    output: str  # the end of stdout and stderr together

    @property
    def died(self) -> bool:
        """True when a signal ended it, which for these tools means a native crash or a limit."""
        return self.returncode < 0

    def reason(self) -> str:
        """One line that says why it failed: the signal, or the first error in its output."""
        if self.died:
            return f"{self.name} was ended by {signal.Signals(-self.returncode).name}"
        errors = [line for line in self.output.splitlines() if line.startswith("Error")]
        lines = errors or self.output.strip().splitlines()[-1:] or ["no message"]
        return f"{self.name} failed with code {self.returncode}: {lines[0][:300]}"


def sumo_home() -> Path:
    """Folder of the eclipse-sumo wheel. Raises SumoError when it is not installed."""
    spec = importlib.util.find_spec("sumo")
    places = list(spec.submodule_search_locations or ()) if spec is not None else []
    if not places or not (Path(places[0]) / "bin").is_dir():
        raise SumoError(
            "the eclipse-sumo wheel is not installed; install it: "
            "pip install 'eclipse-sumo>=1.28,<1.29'"
        )
    return Path(places[0])


def run_tool(
    name: str, arguments: Sequence[str], folder: Path, limits: Limits | None = None
) -> ToolRun:
    """Run a tool of the eclipse-sumo wheel in `folder`.

    Raises SumoError when it cannot start or takes too long.
    """
    home = sumo_home()
    projections = str(home / "data" / "proj")  # without it netconvert says "Cannot find proj.db"
    environment = os.environ | {
        "SUMO_HOME": str(home),
        "PROJ_LIB": projections,
        "PROJ_DATA": projections,
    }
    run = run_child(
        name, [str(home / "bin" / name), *arguments], folder, environment, limits or Limits()
    )
    if run.returncode == _NOT_STARTED and (cure := missing_library(run.output)):
        raise SumoError(f"{name} cannot be started: {cure}")
    return run


def by_file(lists: Mapping[str, Sequence[str]], config: Path) -> list[str]:
    """Words that give a tool lists of names by option, in the new file `config`."""
    # A word has room for 128 KiB only.
    options = (
        f"<{option} value={quoteattr(','.join(names))}/>"
        for option, names in lists.items()
        if names
    )
    config.write_text(f"<configuration>{''.join(options)}</configuration>", encoding="utf-8")
    return ["-c", config.name]


def run_child(
    name: str, command: Sequence[str], folder: Path, env: Mapping[str, str], limits: Limits
) -> ToolRun:
    """Run a command under limits, `name` being what messages call it.

    Raises SumoError as `run_tool` does.
    """
    try:
        run = run_command(
            command,
            limits.wall_s,
            folder=folder,
            env={**env, "LC_ALL": UTF_8},
            together=True,
            on_start=partial(_limit, limits=limits),
        )
    except ChildProcessError as error:
        raise SumoError(
            f"{name} cannot be started ({error}); install the eclipse-sumo wheel again"
        ) from None
    except subprocess.TimeoutExpired:
        raise SumoError(
            f"{name} took longer than {limits.wall_s:.0f} s; try a smaller area"
        ) from None
    return ToolRun(name=name, returncode=run.returncode, output=run.stdout)


def _limit(child: subprocess.Popen[bytes], limits: Limits) -> None:
    """Set limits from outside: code between fork and exec is not safe in a process with threads."""
    for kind, value in (
        (resource.RLIMIT_AS, limits.memory_bytes),
        (resource.RLIMIT_CPU, limits.cpu_s),
        (resource.RLIMIT_FSIZE, limits.file_bytes),
        (resource.RLIMIT_CORE, 0),
    ):
        try:
            resource.prlimit(child.pid, kind, (value, value))
        # Ended already, or a tighter limit holds.
        except (ProcessLookupError, PermissionError, ValueError):
            continue


def missing_library(output: str) -> str:
    """What to do where the loader reports that a library of the system is not there; else "".

    >>> missing_library("ImportError: libXrender.so.1: cannot open shared object file: No")[:35]
    'the library libXrender.so.1 is miss'
    >>> missing_library("cannot open shared object file")
    ''
    """
    found = _NOT_FOUND.search(output)
    if found is None:
        return ""
    return (
        f"the library {found[1]} is missing; SUMO needs some libraries of the system. "
        f"On Debian or Ubuntu: sudo apt install {SYSTEM_PACKAGES}"
    )

"""`python -m tools.results [PART ...] [--out FOLDER]`: run the named parts, or all, and print their tables.

Finished steps are skipped, and an interrupted part continues. `--list` names the parts.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # of this checkout, wherever it is called from

from tools.results.parts import Part, Step, parts
from tools.results.tables import page

STOPPED = 130  # by Ctrl-C, as shells say it


def main(words: Sequence[str]) -> int:
    """Run parts; returns the exit code of the first command that failed, 0 if all are done."""
    parser = argparse.ArgumentParser(prog="python -m tools.results", description=__doc__)
    parser.add_argument("part", nargs="*", help="names of parts, or how they begin; without one all parts run")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for runs, results and tables")
    parser.add_argument("--list", action="store_true", help="list the parts, and which of them are done")
    asked = parser.parse_args(words)
    known = parts(asked.out)
    chosen = [part for part in known if not asked.part or any(part.name.startswith(name) for name in asked.part)]
    unknown = [name for name in asked.part if not any(part.name.startswith(name) for part in known)]
    if unknown:
        print(f"part {unknown[0]!r} is unknown; expected one of {', '.join(part.name for part in known)}")
        return 2
    if asked.list:
        for part in chosen:
            print(f"{part.name:28s} {'done' if is_done(part) else 'to do':6s} {part.says}")
        return 0
    (asked.out / "tables").mkdir(parents=True, exist_ok=True)
    for part in chosen:
        code = run(part)
        if code:
            return code
    print(page(asked.out))
    return 0


def is_done(part: Part) -> bool:
    """Whether every output of a part exists."""
    return all(step.is_made for step in part.steps)


def command_of(step: Step) -> list[str]:
    """The command for a step; if its folder exists, the one that continues it."""
    words = step.again if step.folder.exists() else step.words
    return [str(Path(sys.executable).parent / "wcsim"), *words]


def code_of(command: Sequence[str]) -> int:
    """The exit code of a command. After Ctrl-C this waits until the command has saved its work."""
    stopped = False
    with subprocess.Popen(command) as process:
        while True:
            try:
                return process.wait() or (STOPPED if stopped else 0)
            except KeyboardInterrupt:
                stopped = True


def run(part: Part) -> int:
    """Run the unfinished steps of a part; returns the exit code of the first command that failed."""
    began_s = time.monotonic()
    for step in part.steps:
        if step.is_made:
            continue
        command = command_of(step)
        print("$ wcsim", *command[1:], flush=True)
        code = code_of(command)
        if code:
            return code
    print(f"part {part.name}: done in {time.monotonic() - began_s:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

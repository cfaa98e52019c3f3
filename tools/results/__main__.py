"""`python -m tools.results [PART ...] [--out FOLDER]`: run parts, or all, and print their tables.

What a part has made is not made again; a part that was stopped goes on. `--list` says which parts there are.
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
    """Run parts; the exit code of the first command that failed, 0 when all are done."""
    parser = argparse.ArgumentParser(prog="python -m tools.results", description=__doc__)
    parser.add_argument("part", nargs="*", help="names of parts, or beginnings of them; none for all")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder of all that is made")
    parser.add_argument("--list", action="store_true", help="say which parts there are, and which are done")
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
    """Whether all that a part makes is there."""
    return all(step.is_made for step in part.steps)


def command_of(step: Step) -> list[str]:
    """What is typed for a step now: in a folder that is there it goes on."""
    words = step.again if step.folder.exists() else step.words
    return [str(Path(sys.executable).parent / "wcsim"), *words]


def code_of(command: Sequence[str]) -> int:
    """The exit code of a command; one that Ctrl-C stops, too, is waited for until it has saved its work."""
    stopped = False
    with subprocess.Popen(command) as process:
        while True:
            try:
                return process.wait() or (STOPPED if stopped else 0)
            except KeyboardInterrupt:
                stopped = True


def run(part: Part) -> int:
    """Run what is not done of a part; the exit code of the first command that failed."""
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

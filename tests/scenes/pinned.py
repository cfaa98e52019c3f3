"""Scenes one after the other, each in a fork of one process with the pinned C library: what all load is loaded once.

`python -m tests.scenes.pinned` reads lines of JSON, a folder and a trace, and answers each with the scene's facts.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.joystick import shaped_rows
from wcsim.scenes.facts import Facts
from wcsim.scenes.run import _PINNED_LIBM, _run_scene

RunScene = Callable[[Path, Path], Facts]


@contextmanager
def pinned_scenes() -> Iterator[RunScene]:
    """Runs scenes as `run_in_child` does, in half its time."""
    command, pipe = [sys.executable, "-m", "tests.scenes.pinned"], subprocess.PIPE
    env = {**os.environ, "GLIBC_TUNABLES": _PINNED_LIBM}
    with subprocess.Popen(command, env=env, stdin=pipe, stdout=pipe, text=True) as host:
        assert host.stdin is not None and host.stdout is not None

        def run(folder: Path, trace: Path) -> Facts:
            host.stdin.write(json.dumps([str(folder), str(trace)]) + "\n")
            host.stdin.flush()
            facts: Facts | None = json.loads(host.stdout.readline())
            assert facts is not None, "what its process died of stands in its error output"
            return facts

        yield run


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    shaped_rows(np.zeros((1, 2)), ChairConfig())  # the first kernel loads most of the compiler
    for line in sys.stdin:
        child = os.fork()
        if not child:
            try:
                _say(json.dumps(_run_scene(*map(Path, json.loads(line)))))
                os._exit(0)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(1)
        if os.waitpid(child, 0)[1]:
            _say("null")


if __name__ == "__main__":
    main()

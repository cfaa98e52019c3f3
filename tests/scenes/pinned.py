"""Scenes one after the other, each in a fork of one process with the pinned C library: what all load is loaded once.

`python -m tests.scenes.pinned` reads lines of JSON, a folder and a trace, and answers each with both and the facts.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.joystick import shape_joysticks
from wcsim.scenes.meter import Facts
from wcsim.scenes.run import _PINNED_LIBM, _run_scene


def pinned_scenes() -> Iterator[Callable[[Path, Path], Facts]]:
    """A fixture that runs scenes as `run_in_child` does, in half its time."""
    command, pipe = [sys.executable, "-m", "tests.scenes.pinned"], subprocess.PIPE
    env = {**os.environ, "GLIBC_TUNABLES": _PINNED_LIBM}
    with subprocess.Popen(command, env=env, stdin=pipe, stdout=pipe) as host:
        assert host.stdin is not None and host.stdout is not None

        def run(folder: Path, trace: Path) -> Facts:
            asked = [str(folder), str(trace)]
            os.write(host.stdin.fileno(), json.dumps(asked).encode() + b"\n")
            answers = map(json.loads, host.stdout)  # the first may be to a test that did not wait for it
            facts: Facts | None = next((facts for of, facts in answers if of == asked), None)
            assert facts is not None, "what its process died of stands in its error output"
            return facts

        yield run


def main() -> None:
    shape_joysticks(np.zeros((1, 2)), ChairConfig())  # the first kernel loads most of the compiler
    for line in sys.stdin:
        asked, child = json.loads(line), os.fork()
        answer = json.dumps([asked, None if child else _run_scene(*map(Path, asked))])
        if not child or os.waitpid(child, 0)[1]:
            os.write(1, answer.encode() + b"\n")
        if not child:
            os._exit(0)


if __name__ == "__main__":
    main()

"""A world and a client for tests of the launcher: they keep time and say so, and fail as they are told.

Run as `launch_stubs.py world ORDER_FILE` and `launch_stubs.py client FOLDER WORDS... [--resume] --status-fd N`; what
they shall do is a list of words such as `die=20` (at step 20, by SIGKILL, in each life) or `die=20x2` (in two lives).
"""

import importlib.util
import json
import os
import signal
import sys
import time
from pathlib import Path

PARENT = Path(__file__).parents[3] / "wcsim" / "core" / "processes.py"
TICK_S = 0.004
FOREVER_S = 600.0


def die_with_parent() -> None:
    """That of wcsim, without the package around it: these processes start by the dozen."""
    spec = importlib.util.spec_from_file_location("parent", PARENT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.die_with_parent()


class Asked(Exception):
    """SIGTERM came."""


class Waits:
    """A client that sits and waits for its world: SIGTERM ends it when it is back, SIGUSR1 now, two SIGTERM tear it."""

    def __init__(self) -> None:
        self.asked = False
        signal.signal(signal.SIGTERM, self._ask)
        signal.signal(signal.SIGUSR1, _ask)

    def _ask(self, number: int, frame: object) -> None:
        if self.asked:
            os._exit(9)
        self.asked = True


def lives(folder: Path) -> int:
    """How often this was begun, this time included."""
    counter = folder / "lives"
    with counter.open("a") as file:
        file.write("x")
    return counter.stat().st_size


def told(words: list[str], word: str, life: int) -> int | None:
    """The number behind `word=`, in the lives that it is for."""
    for item in words:
        key, _, value = item.partition("=")
        number, _, most = value.partition("x")
        if key == word and life <= int(most or 1 << 30):
            return int(number)
    return None


def misbehave(words: list[str], at: int, life: int, stop: bool) -> None:
    """Do what is to be done at this step."""
    if told(words, "die", life) == at:
        os.kill(os.getpid(), signal.SIGKILL)
    if told(words, "held", life) == at:
        os.kill(os.getpid(), signal.SIGSTOP)
    if told(words, "hang", life) == at:
        if not stop:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(FOREVER_S)
    for code in range(1, 8):
        if told(words, f"exit{code}", life) == at:
            sys.stderr.write(f"some chatter\nwcsim: a fault of kind {code}\n")
            raise SystemExit(code)


def say(fd: int, line: bytes) -> None:
    """Write a line to the launcher; when it is gone, SIGTERM stays blocked: it may not cut the saving short."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    os.write(fd, line)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})


def evicts(run: Path, words: list[str]) -> bool:
    """Whether the first client has come so far in its first life that the world shall give it up."""
    at = told(words, "evict", 1)
    step = run / "a" / "step"
    if at is None or not step.is_file():
        return False
    return (run / "a" / "lives").stat().st_size == 1 and int(step.read_text() or 0) >= at


def world(order_file: str) -> int:
    order = json.loads(Path(order_file).read_text())
    words, members, life = order["hook"].split(), order["name"].split(), lives(Path(order["run"]))
    status = {"stage": "loading", "epoch": life - 1, "tick": 0, "ticks": 0, "members": []}
    listening = order["listen"].replace("*", str(5000 + life))  # as a port that is free
    try:
        tick = 0
        while True:
            misbehave(words, tick, life, stop=True)
            status["members"] = [] if tick == 0 or evicts(Path(order["run"]), words) else members
            say(order["status_fd"], json.dumps(status).encode() + b"\nnoise\n")
            if tick == 2:
                Path(order["run"], "ticks").touch()
            tick += 1
            status |= {"stage": "collect", "tick": tick, "ticks": tick, "listening": listening}
            if "idle" in words:
                status |= {"stage": "empty", "tick": 0, "ticks": 0}
            time.sleep(TICK_S)
    except (Asked, BrokenPipeError):
        Path(order["run"], "ended").touch()
        return 0


def client(words: list[str]) -> int:
    folder, fd = Path(words[0]), int(words[words.index("--status-fd") + 1])
    folder.mkdir(parents=True, exist_ok=True)
    kept, life = folder / "step", lives(folder)
    step = int(kept.read_text()) if "--resume" in words and kept.is_file() else 0
    total = told(words, "steps", life) or 50
    try:
        for word, awaited in (("patient", "a/step"), ("seated", "ticks")):
            while word in words and not (folder.parent / awaited).is_file():
                time.sleep(TICK_S)
        if "waits" in words:
            Waits()
            say(fd, json.dumps({"name": folder.name, "step": step, "total_steps": total}).encode() + b"\n")
            time.sleep(FOREVER_S)
        while step < total:
            step += 1
            misbehave(words, step, life, stop="deaf" not in words)
            status = {"name": folder.name, "step": step, "total_steps": total}
            say(fd, json.dumps(status).encode() + b"\n")
            if "forgets" not in words:
                kept.write_text(str(step))
            time.sleep(TICK_S)
    except (Asked, BrokenPipeError):
        (folder / "saved").write_text(str(step))
        return 3
    return 0


def _ask(number: int, frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise Asked


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, _ask)
    die_with_parent()
    raise SystemExit(world(sys.argv[2]) if sys.argv[1] == "world" else client(sys.argv[2:]))

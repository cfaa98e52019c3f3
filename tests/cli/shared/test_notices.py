"""What is said without being asked for: once, in a line, and where it is read."""

import os
import pty
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.cli.conftest import QUICK, files_in
from wcsim.cli import serve
from wcsim.cli.main import main
from wcsim.server.transport.keys import create_missing_keys

SMALL = ("--set", "learn.total_steps=8", "--set", "learn.phase1_steps=4", *QUICK)


def test_what_is_overridden_is_one_line_and_a_table_when_it_is_asked_for(wcsim, corner):
    words = ("test", "follow", "--only", "--town", corner, "--episodes", "1", "--max-steps", "2", *QUICK)
    short, long = wcsim(*words), wcsim(*words, "--verbose")
    line = " ".join(short.out[: short.out.index("drives with a crash")].split())
    assert "of SUMO's options are not as in pedestrian-crossing's scenario (" in line
    assert "seed" in line and "xml-validation" in line and "--verbose says why" in line
    assert "what this run overrides of pedestrian-crossing's scenario" in long.out
    assert "one seed for all random" in long.out and "one seed for all" not in short.out


def test_a_scenario_of_longer_steps_is_told_what_that_does_without_being_asked(wcsim, corner, tmp_path):
    for file in corner.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    (config,) = tmp_path.glob("*.sumocfg")
    text = config.read_text()
    config.write_text(re.sub(r"<step-length [^>]*>", '<step-length value="1"/>', text))
    told = wcsim("town", "run", config, "--seconds", "1", "--chairs", "0", "--out", "run")
    assert told.code == 0
    line = " ".join(told.out[told.out.index("step-length is") :].split())
    assert line.startswith("step-length is 0.1: one tick is one step of SUMO") and "faster" in line[:200]


def test_progress_of_a_short_run_is_said_once_for_each_tenth(wcsim, corner):
    told = wcsim("town", "run", corner, "--seconds", "2", "--chairs", "0", "--out", "run")
    shown = re.findall(r"^([\d.]+) of 2 s$", told.err, flags=re.MULTILINE)
    assert shown == ["0.2", "0.4", "0.6", "0.8", "1", "1.2", "1.4", "1.6", "1.8", "2"]


def all_of(terminal: int) -> bytes:
    """What is written at its other end, until that is closed."""
    seen = b""
    try:
        while part := os.read(terminal, 4096):
            seen += part
    except OSError:  # nobody has the other end open any more
        pass
    return seen


def test_on_a_terminal_the_bar_and_what_is_said_beside_it_have_lines_of_their_own(folder, corner, monkeypatch):
    ours, theirs = pty.openpty()
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setenv("TERM", "xterm")
    with ThreadPoolExecutor() as pool, monkeypatch.context() as typed:
        seen = pool.submit(all_of, ours)
        with os.fdopen(theirs, "w", encoding="utf-8") as terminal:
            typed.setattr(sys, "stdout", terminal)
            typed.setattr(sys, "stderr", terminal)
            code = main(["train-q", "--town", str(corner), "--out", "run", *SMALL])
        seen = seen.result(60.0)
    os.close(ours)
    assert code == 0, seen
    (line,) = [line for line in seen.decode().split("\n") if "of SUMO's options" in line]
    before = line[: line.index("of SUMO's options")].rpartition("\x1b[2K")[2]
    assert re.fullmatch(r"(\x1b\[[\d;?]*[a-zA-Z]|\r)*\d+ ", before), line
    assert "run folder: run" in seen.decode()


def test_an_address_that_listens_everywhere_is_told_by_the_name_of_the_machine(tmp_path, monkeypatch):
    keys = tmp_path / "the keys"
    create_missing_keys(keys, ("ben", "ann"))
    monkeypatch.setattr(serve.socket, "gethostname", lambda: "lab3")
    options = serve._Options(listen="tcp://0.0.0.0:5599", keys=keys)
    lines = serve._how_to_join("ipc:///dev/shm/w", "tcp://0.0.0.0:5599", options).splitlines()
    assert lines[1:] == [
        f"over the network: wcsim join tcp://lab3:5599 --keys '{keys}' --name {name} --network patch --steps 1000"
        for name in ("ann", "ben")
    ]
    here = serve._how_to_join("ipc:///dev/shm/w", "tcp://127.0.0.1:5", serve._Options(listen="tcp://127.0.0.1:5"))
    assert "wcsim join tcp://127.0.0.1:5 --network patch" in here


def test_a_folder_that_is_made_for_a_result_is_named(wcsim, folder, corner):
    words = ("snapshot", corner, "--seconds", "0", "--width", "64", "--out")
    assert wcsim(*words, "a/b/x.png").err == "note: made the folder a\n"
    assert wcsim(*words, "a/y.png").err == wcsim(*words, "z.png").err == ""
    assert files_in(folder) == {"a", "a/b", "a/b/x.png", "a/y.png", "z.png"}
    assert wcsim("scene", "list").err == "" and not Path("new").exists()

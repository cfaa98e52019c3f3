"""Help and refusals come before anything dear is loaded: for each command that there is, found by walking the help."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import re
import subprocess
import sys
from functools import cache
from importlib.util import find_spec

import pytest

from wcsim.cli.main import SUBCOMMANDS, main
from wcsim.cli.shared.exit_codes import Exit

HEAVY = (
    *("torch", "stable_baselines3", "pettingzoo", "gymnasium"),
    *("libsumo", "traci", "sumolib", "pybullet", "numba", "cv2"),
    *("matplotlib", "shapely", "networkx", "rasterio", "osmium", "timezonefinder", "scipy", "ray"),
)
PROBE = f"""
import contextlib, json, os, sys
import tyro, wcsim.config, wcsim.cli.shared.common, wcsim.cli.shared.run_config
from wcsim.cli.main import main
found = os.fdopen(os.dup(1), "w")
for lines in json.load(sys.stdin):
    found.flush()
    if os.fork():
        os.wait()
        continue
    with open(os.devnull, "w") as nothing, contextlib.redirect_stdout(nothing), contextlib.redirect_stderr(nothing):
        for words in lines:
            code = int(main(words))
            json.dump([words, code, [name for name in {HEAVY} if name in sys.modules]], found)
            print(file=found)
    found.flush()
    os._exit(0)
"""
"""The command lines of each command in a process of their own, so that none has loaded what another needs.

What nearly all of them read their settings by is loaded once, before: what is dear in it shows in each of them.
"""

NOWHERE = (
    "train --town atlantis",
    "serve --town atlantis",
    "test --town atlantis",
    "demo --train-town atlantis",
    "snapshot atlantis",
    "video atlantis",
    "drive atlantis",
    "town check atlantis",
    "town run atlantis",
    "town pave atlantis --out x",
    "town import --name x --osm atlantis.osm",
    "town make x --size 1",
    "users record atlantis --out x.drive",
    "users fit atlantis --out x.toml",
    "scene run atlantis",
    "scene bless atlantis",
    "replay atlantis",
    "log verify atlantis",
)
WRONG = (
    "train --set learn.nope=3",
    "test --set learn.nope=3",
    "serve --set learn.nope=3",
    "demo --set learn.nope=3",
    "join ipc://x --set learn.nope=3",
    "town run helsinki --set learn.nope=3",
    "train --set learn.gamma=x",
    "train --set learn.gamma=7",
    "train --preset nope",
    "train-q --network nope",
    "train --config nope.toml",
    "test --profile nope",
    "users record helsinki --out x --profile nope",
    "test --profile nope.toml",
    "join nowhere",
    "test nowhere",
)


NESTED = ("town", "scene", "chair", "users", "log")


@cache
def told(words: tuple[str, ...]) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main([*words, "--help"]) == Exit.DONE
    return out.getvalue()


@cache
def commands() -> tuple[tuple[str, ...], ...]:
    """Every command line that has options of its own."""
    found: list[tuple[str, ...]] = []
    for item in SUBCOMMANDS:
        inner = re.match(rf"usage: wcsim {item.name} ([a-z|]+) \[options\]", told((item.name,)))
        found += [(item.name, word) for word in inner[1].split("|")] if inner else [(item.name,)]
    return tuple(found)


def helps() -> set[tuple[str, ...]]:
    groups = {words[:1] for words in commands() if len(words) > 1}
    return {("--help",), ("--version",), *((*words, "--help") for words in (*groups, *commands()))}


def words_of(lines: tuple[str, ...]) -> set[tuple[str, ...]]:
    return {tuple(line.split()) for line in lines}


def mistakes() -> set[tuple[str, ...]]:
    found = {("trian",), ("train", "--no-such-option", "3")}
    found |= {(*words[:1], "nope") for words in commands() if len(words) > 1}
    for words in commands():
        first = re.search(r"(--[\w-]+) (?:INT|FLOAT)", told(words))  # all are read before a command begins
        found.add((*words, first[1], "x") if first else (*words, "--no-such-option", "3"))
    return found


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, ...], tuple[int, list[str]]]:
    """The exit code of each line, and what was loaded after it."""
    folder = tmp_path_factory.mktemp("empty")
    lines = sorted({*helps(), *mistakes(), *words_of(NOWHERE), *words_of(WRONG)})
    groups = [list(group) for _, group in itertools.groupby(lines, lambda words: words[: 1 + (words[0] in NESTED)])]
    run = subprocess.run(
        [sys.executable, "-c", PROBE], input=json.dumps(groups), capture_output=True, text=True, check=True, cwd=folder
    )
    found = [json.loads(line) for line in run.stdout.splitlines()]
    assert list(folder.iterdir()) == []
    assert [tuple(words) for words, _, _ in found] == lines
    return {tuple(words): (code, loaded) for words, code, loaded in found}


def test_the_walk_finds_commands_of_commands_and_their_numbers():
    assert {words[0] for words in commands() if len(words) > 1} == set(NESTED)
    assert {("train",), ("town", "import"), ("chair", "check"), ("scene", "new"), ("doctor",)} <= set(commands())
    assert len(commands()) >= len(SUBCOMMANDS) + 10
    assert ("chair", "check", "--hz", "x") in mistakes()


def test_no_help_loads_what_only_work_needs(outcome):
    assert {words: outcome[words] for words in helps() if outcome[words] != (Exit.DONE, [])} == {}


@pytest.mark.parametrize(
    "lines",
    [mistakes, lambda: words_of(NOWHERE), lambda: words_of(WRONG)],
    ids=["mistyped", "a town that is not there", "a setting that cannot be"],
)
def test_no_refusal_loads_it(outcome, lines):
    assert {words: outcome[words] for words in lines() if outcome[words] != (Exit.REFUSED, [])} == {}


def test_what_must_not_be_loaded_is_what_work_loads():
    """Otherwise the list above would hold names that nothing loads."""
    work = "wcsim.bridge.world, wcsim.agents.learning.train, wcsim.agents.envs.parallel_env, wcsim.towns.street"
    code = f"import json, sys, {work}; print(json.dumps([name for name in {HEAVY} if name not in sys.modules]))"
    late = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    single = {"rasterio", "osmium", "timezonefinder", "matplotlib", "scipy", "ray"}  # for single pieces of work
    assert set(json.loads(late)) <= single
    assert all(find_spec(name) for name in HEAVY)

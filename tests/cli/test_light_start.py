"""Help and refusals come before anything dear is loaded: for each command that there is, found by walking the help."""

import contextlib
import io
import itertools
import json
import re
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec

import pytest

from tests.support.typed import python_says
from wcsim.cli.main import SUBCOMMANDS, main
from wcsim.cli.shared.exit_codes import ExitCode

HEAVY = (
    *("torch", "stable_baselines3", "pettingzoo", "gymnasium"),
    *("libsumo", "traci", "sumolib", "pybullet", "numba", "cv2"),
    *("matplotlib", "shapely", "networkx", "rasterio", "osmium", "timezonefinder", "scipy", "ray"),
)
PROBE = f"""
import contextlib, io, json, os, sys
import tyro, wcsim.config, wcsim.cli.shared.common, wcsim.cli.shared.run_config
from wcsim.cli.main import main
found = os.fdopen(os.dup(1), "w")
for lines in json.load(sys.stdin):
    found.flush()
    if os.fork():
        os.wait()
        continue
    with open(os.devnull, "w") as nothing, contextlib.redirect_stdout(nothing):
        for words in lines:
            with contextlib.redirect_stderr(io.StringIO()) as told:
                code = int(main(words))
            json.dump([words, code, [name for name in {HEAVY} if name in sys.modules], told.getvalue()], found)
            print(file=found)
    found.flush()
    os._exit(0)
"""
"""The command lines of each command in a process of their own, so that none has loaded what another needs.

What nearly all of them read their settings by is loaded once, before: what is dear in it shows in each of them.
"""

WRONG = (
    "serve --town atlantis",
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
    "test --set learn.nope=3",
    "serve --set learn.nope=3",
    "demo --set learn.nope=3",
    "join ipc://x --set learn.nope=3",
    "town run helsinki --set learn.nope=3",
    "train --set learn.gamma=x",
    "train --set learn.gamma=7",
    "train --config nope.toml",
    "users record helsinki --out x --profile nope",
    "test --profile nope.toml",
    "join nowhere",
)

EARLY = {
    "train-q --network huge": "unknown network 'huge'",
    "train-q --network patc": "did you mean 'patch'?",
    "train-q --network nowhere:Net": "network module 'nowhere' was not found",
    "train-q --reward nowhere:Term": "reward term module 'nowhere' was not found",
    "train-q --hook nowhere:Hook": "step hook module 'nowhere' was not found",
    "train-q --town atlantis": "unknown town 'atlantis'",
    "train --town atlantis": "unknown town 'atlantis'",
    "train --cluster x": "--cluster",
    "train --town monaco": "monaco is a test town",
    "train --set learn.speed=3": "unknown key 'learn.speed'",
    "train --set env.profile=saint": "unknown user profile 'saint'",
    "train-q --steps 0": "--steps 0: expected 1 or more",
    "train --out file/run": "is not a folder that can be written",
    "resume nothing": "nothing is not a run",
    "test folow": "did you mean 'follow'?",
    "test runs/none": "runs/none is not a run",
    "test follow:early": "module 'follow' was not found",
    "test --episodes 0": "--episodes 0",
    "test --profile saint": "unknown user profile 'saint'",
    "test --town atlantis": "unknown town 'atlantis'",
    "test --town helsinki": "helsinki is a training town",
    "test --network nowhere:Net": "network module 'nowhere' was not found",
    "test --hook nowhere:Hook": "step hook module 'nowhere' was not found",
    "town check helsinky": "did you mean 'helsinki'?",
    "tran": "did you mean 'train'?",
    "town improt": "did you mean 'import'?",
    "train --preset laptob": "did you mean 'laptop'?",
    "test --profile tremour": "did you mean 'tremor'?",
    "video --policy shiped": "did you mean 'shipped'?",
    "drive --policy nobody": "shipped, module:Class of your own, or a baseline: follow, random",
    "drive --set chair.plant=mine.toml": "expected --policy RUN, a run that was trained with your settings",
    "look --tow helsinki": "--tow is not an option of look; give TOWN without a name: wcsim look TOWN",
    "test --policy dwa": "--policy is not an option of test; give POLICY without a name: wcsim test POLICY",
    "export --policy shipped": "give POLICY without a name: wcsim export POLICY",
    "look --out file/look": "is not a folder that can be written to; choose another with --out",
    "train --set cameras.0.noise=typicall": "expected typical, none, or a table of depth, classes, rgb, objects; did",
    "log verify none.drive": "none.drive: is not there; expected a run folder, a trace, a journal or a",
    "log verify file": "file: is not a log, or was truncated in its first record",
    "export shipped --onnx x --ride none.drive": "--ride none.drive: not found; expected a recorded drive",
    "join udp://there": "expected ipc://FILE or tcp://HOST:PORT",
    "join ipc://there --network huge": "unknown network 'huge'",
}

NESTED = ("town", "scene", "chair", "users", "log")


@cache
def told(words: tuple[str, ...]) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main([*words, "--help"]) == ExitCode.DONE
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


def words_of(lines: Iterable[str]) -> set[tuple[str, ...]]:
    return {tuple(line.split()) for line in lines}


def mistakes() -> set[tuple[str, ...]]:
    found = {("trian",), ("train", "--no-such-option", "3")}
    found |= {(*words[:1], "nope") for words in commands() if len(words) > 1}
    for words in commands():
        first = re.search(r"(--[\w-]+) (?:INT|FLOAT)", told(words))  # all are read before a command begins
        found.add((*words, first[1], "x") if first else (*words, "--no-such-option", "3"))
    return found


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, ...], tuple[int, list[str], str]]:
    """The exit code of each line, what was loaded after it, and what was said."""
    folder = tmp_path_factory.mktemp("almost_empty")
    (folder / "file").write_text("a file, not a folder")
    lines = sorted({*helps(), *mistakes(), *words_of(WRONG), *words_of(EARLY)})
    groups = [list(group) for _, group in itertools.groupby(lines, lambda words: words[: 1 + (words[0] in NESTED)])]
    run = subprocess.run(
        [sys.executable, "-c", PROBE], input=json.dumps(groups), capture_output=True, text=True, check=True, cwd=folder
    )
    found = [json.loads(line) for line in run.stdout.splitlines()]
    assert [path.name for path in folder.iterdir()] == ["file"]
    assert [tuple(words) for words, *_ in found] == lines
    return {tuple(words): (code, loaded, message) for words, code, loaded, message in found}


def test_the_walk_finds_commands_of_commands_and_their_numbers():
    assert {words[0] for words in commands() if len(words) > 1} == set(NESTED)
    assert {("train",), ("town", "import"), ("chair", "check"), ("scene", "new"), ("doctor",)} <= set(commands())
    assert len(commands()) >= len(SUBCOMMANDS) + 10
    assert ("chair", "check", "--hz", "x") in mistakes()


def test_no_help_loads_what_only_work_needs(outcome):
    assert {words: outcome[words] for words in helps() if outcome[words][:2] != (ExitCode.DONE, [])} == {}


@pytest.mark.parametrize(
    "lines",
    [mistakes, lambda: words_of(WRONG), lambda: words_of(EARLY)],
    ids=["mistyped", "a town or setting that is not there", "what is none of those there are"],
)
def test_no_refusal_loads_it(outcome, lines):
    assert {words: outcome[words] for words in lines() if outcome[words][:2] != (ExitCode.REFUSED, [])} == {}


def test_a_refusal_says_what_is_wrong(outcome):
    for line, wanted in EARLY.items():
        assert wanted in outcome[tuple(line.split())][2], line


def test_what_must_not_be_loaded_is_what_work_loads():
    """Otherwise the list above would hold names that nothing loads."""
    work = "wcsim.bridge.world, wcsim.agents.learning.train, wcsim.agents.envs.parallel_env, wcsim.towns.street"
    code = f"import json, sys, {work}; print(json.dumps([name for name in {HEAVY} if name not in sys.modules]))"
    single = {"rasterio", "osmium", "timezonefinder", "matplotlib", "scipy", "ray"}  # for single pieces of work
    assert set(json.loads(python_says(code))) <= single
    assert all(find_spec(name) for name in HEAVY)

"""What the commands say of themselves."""

from __future__ import annotations

import re
import tomllib

import pytest

from tests.support.tracked import ROOT
from wcsim.cli.main import SUBCOMMANDS

NESTED = {
    "town": ("import", "make", "list", "check", "pave", "run"),
    "scene": ("run", "list", "bless", "new", "make"),
    "users": ("record", "fit"),
    "chair": ("check", "fit"),
    "log": ("play", "verify", "compare", "convert"),
}
PLAIN = [item.name for item in SUBCOMMANDS if item.name not in NESTED]
COMMANDS = [(name,) for name in PLAIN] + [(name, word) for name, words in NESTED.items() for word in words]


def test_help_lists_exactly_the_commands_that_exist(wcsim):
    told = wcsim("--help")
    assert told.code == 0
    listed = re.findall(r"^(?:\w+ | )  *([a-z-]+)  +\w", told.out, flags=re.MULTILINE)
    assert listed == [item.name for item in SUBCOMMANDS]
    homes = {f"wcsim.cli.{item.module.partition(':')[0]}" for item in SUBCOMMANDS}
    beside_main = {f"wcsim.cli.{path.stem}" for path in (ROOT / "wcsim" / "cli").glob("*.py")}
    assert beside_main - {"wcsim.cli.__init__", "wcsim.cli.main"} <= homes
    assert all((ROOT / f"{home.replace('.', '/')}.py").is_file() for home in homes)
    assert max(len(line) for line in told.out.splitlines()) <= 80 and len(told.out.splitlines()) <= 28
    assert wcsim().out == wcsim("help").out == told.out


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_explains_itself(wcsim, words):
    told = wcsim(*words, "--help")
    assert (told.code, told.err) == (0, "")
    assert f"usage: wcsim {' '.join(words)}" in told.out
    assert "{None}" not in told.out


@pytest.mark.parametrize("name", sorted(NESTED))
def test_commands_with_commands_of_their_own_list_them(wcsim, name):
    told = wcsim(name, "--help")
    assert told.code == 0
    assert tuple(re.findall(r"^  (\w+) +\w", told.out, flags=re.MULTILINE)) == NESTED[name]


def test_chance_has_a_seed_and_results_have_a_file(wcsim):
    for words in COMMANDS:
        told = wcsim(*words, "--help").out
        has_chance = words not in {("town", "list"), ("town", "check"), ("town", "pave"), ("replay",), ("cache",)}
        has_chance &= words[0] != "log"
        has_chance &= words not in {("chair", "check"), ("chair", "fit"), ("report",), ("networks",), ("export",)}
        has_chance &= words not in {("users", "fit"), ("watch",), ("resume",)}
        has_chance &= words[0] != "scene" or words[1] == "make"
        assert ("--seed INT" in told) == has_chance
        has_result = words in {
            ("train",),
            ("train-q",),
            ("train-clients",),
            ("resume",),
            ("test",),
            ("doctor",),
            ("town", "check"),
            ("town", "run"),
            ("scene", "run"),
        }
        has_result |= words in {("town", "import"), ("town", "pave"), ("cache",)} or (
            words[0] == "log" and words[1] != "play"
        )
        has_result |= words[0] == "users"
        has_result |= words in {("town", "make"), ("collect",), ("networks",), ("export",)}
        assert ("--json FILE" in told) == (has_result or words[0] == "chair"), words


def test_version(wcsim):
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert wcsim("--version").out.strip() == version


def test_whatever_takes_a_town_says_that_a_scenario_will_do(wcsim):
    takes = {("town", "check"), ("town", "pave"), ("town", "run"), ("users", "record")}
    takes |= {(name,) for name in ("look", "snapshot", "video", "drive", "test", "train", "collect", "demo", "serve")}
    takes |= {("export",), ("doctor",), ("log", "play"), ("train-q",), ("train-clients",)}
    for words in COMMANDS:
        told = re.sub(r"[\s│]+", " ", wcsim(*words, "--help").out)
        assert bool(re.search(r"name, its folder, or a \.sumocfg file", told)) == (words in takes), words

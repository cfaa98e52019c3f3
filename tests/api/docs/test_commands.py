"""Every command that a page shows is one that wcsim takes, with the options and settings that it has."""

import re
import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import tyro

from benchmarks.__main__ import PROGRAM
from benchmarks.__main__ import main as measure
from tests.support.tracked import ROOT, tracked
from wcsim.cli.main import main
from wcsim.config import resolve
from wcsim.errors import ConfigError

PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "AGENTS.md", *tracked("docs", ".md")])
SHELL = ("", "bash", "sh", "console")


class Understood(BaseException):
    """Raised in place of doing what a command says."""


def blocks(text: str) -> list[str]:
    """Code blocks of a page in no language or a shell's: between fences, or indented."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    rest = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"((?:^ {4}.*\n)+)", rest, re.MULTILINE)
    plain = [re.sub("(?m)^    ", "", code) for code in indented]
    return [*(code for language, code in fenced if language in SHELL), *plain]


def commands(text: str) -> list[list[str]]:
    """Words of each command in the blocks of a page, without "wcsim"; a benchmark has that word before them."""
    found = []
    for block in blocks(text):
        for line in block.replace("\\\n", " ").split("\n"):
            if not re.match(rf"(\$ )?\w*=?\S* ?(wcsim|{PROGRAM}) ", line):
                continue
            for part in re.split(r"&&|\|(?= )|;", line.partition(" #")[0]):
                words = shlex.split(part.replace("$ ", "", 1).replace(PROGRAM, "wcsim benchmark"))
                if words[:1] == ["wcsim"]:
                    found.append(words[1:])
    return found


SHOWN = [(path, words) for path in PAGES for words in commands(path.read_text())]


def run(words: list[str]) -> int:
    """Do what a command says."""
    return measure(words[1:]) if words[0] == "benchmark" else main(words)


def name_of(case: object) -> str:
    return str(case.relative_to(ROOT)) if isinstance(case, Path) else " ".join(case)  # type: ignore[arg-type]


def test_commands_are_found() -> None:
    fenced = "```\nwcsim look && wcsim train \\\n  --seed 1\n```\n```python\nwcsim x\n```\n"
    page = f"a\n\n    $ wcsim doctor   # b\n    {PROGRAM} soak\n\n{fenced}"
    assert commands(page) == [["look"], ["train", "--seed", "1"], ["doctor"], ["benchmark", "soak"]]
    assert len(SHOWN) > 50


@pytest.fixture
def understood(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Commands end where their words have been understood."""
    real = tyro.cli

    def parsed(*given: Any, **named: Any) -> None:
        real(*given, **named)
        raise Understood

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tyro, "cli", parsed)


@pytest.mark.usefixtures("understood")
@pytest.mark.parametrize("page, words", SHOWN, ids=name_of)
def test_a_command_of_a_page_is_understood(page: Path, words: list[str]) -> None:
    del page
    with pytest.raises(Understood):
        run(words)


@pytest.mark.usefixtures("understood")
@pytest.mark.parametrize("words", [["train", "--sed", "1"], ["town", "improt"], ["tran"], ["test", "--jobs", "two"]])
def test_a_command_that_there_is_not_is_noticed(words: list[str]) -> None:
    assert main(words) == 2


SETTINGS = sorted({value for _, words in SHOWN for option, value in pairwise(words) if option == "--set"})


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_setting_of_a_page_is_one(setting: str) -> None:
    resolve("dqn" if setting.startswith("learn.") else "quick", setting)


def test_a_setting_that_there_is_not_is_noticed() -> None:
    with pytest.raises(ConfigError):
        resolve("quick", "world.strete=careless")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_page_installs_extras_of_the_wheel_for_no_index_has_wcsim(page: Path) -> None:
    assert not re.findall(r"pip install '?wcsim\b(?!-)", page.read_text())


OPTION = re.compile(r"--[a-z][a-z-]+")
TOLD = re.compile(rf"`((?:wcsim|{PROGRAM}) [a-z][^`]*--[^`]*)`")
INLINE = {found for page in PAGES for found in TOLD.findall(page.read_text())}
A_MISTAKE = "wcsim test --polcy x"  # of `docs/results.md`, which says what a refusal costs


@pytest.mark.parametrize("told", sorted(INLINE - {A_MISTAKE}))
def test_options_that_a_sentence_names_are_there(told: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands within a sentence leave things out, so only their options are looked up."""
    words = told.replace(PROGRAM, "wcsim benchmark").split()[1:]
    first = [word for word in words if word in ("--suite", "--make-suite")]
    second = words[1:2] if words[0] in ("town", "scene", "chair", "benchmark", "users", "log") else []
    assert run([words[0], *second, *(each for word in first[:1] for each in (word, "x")), "--help"]) == 0
    known = set(OPTION.findall(capsys.readouterr().out))
    assert set(OPTION.findall(told)) <= known

"""What pyproject.toml asks for is what the code imports: nothing more, and nothing that is there by chance."""

import ast
import sys
import tomllib
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, metadata, packages_distributions

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from tests.support.tracked import ROOT, parsed

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
OWN = {"wcsim", "benchmarks", "tests", "tools", "examples"}
STARTED = {"ruff", "mypy", "import-linter", "pytest", "pytest-timeout", "pytest-xdist", "build", "hatchling"}
STARTED |= {"mkdocs-material", "mkdocstrings-python"}
"""Tools of developers that commands start and nothing imports."""
distributions = cache(packages_distributions)
LOOKUPS = ("find_spec", "import_module", "check_installed")
FOREIGN = {"minari"}
"""What an example converts data for; its test is skipped where it is not installed."""


def named(rows: list[str]) -> set[str]:
    """Distributions of a list of requirements, those that this Python wants."""
    wanted = (Requirement(row) for row in rows)
    return {each.name.lower().replace("_", "-") for each in wanted if each.marker is None or each.marker.evaluate()}


def top_names(tree: ast.Module) -> set[str]:
    """Top-level modules that a file imports, anywhere in it, or looks up by name."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
        elif isinstance(node, ast.Call) and called(node).endswith(LOOKUPS):
            found |= {str(word.value) for word in node.args if isinstance(word, ast.Constant)}
    return {name.partition(".")[0] for name in found if name}


def called(node: ast.Call) -> str:
    """The last part of a name, without what it stands behind."""
    return str(getattr(node.func, "attr", getattr(node.func, "id", "")))


def imported(folder: str) -> set[str]:
    """Distributions of what the files of a folder import."""
    names = {name for tree in parsed(folder).values() for name in top_names(tree)}
    homes = distributions()  # whose files are looked through once
    names = {name for name in names - set(sys.stdlib_module_names) - OWN if name in homes}
    return {homes[name][0].lower().replace("_", "-") for name in names}


EXTRAS = named([row for rows in PROJECT["project"]["optional-dependencies"].values() for row in rows])


def test_declared_is_imported() -> None:
    declared, dev = named(PROJECT["project"]["dependencies"]) | EXTRAS, named(PROJECT["dependency-groups"]["dev"])
    product = imported("wcsim")
    assert dev >= EXTRAS  # whoever works on wcsim has them, so that they are tested
    assert product == declared
    proof = imported("tests") | imported("tools") | imported("examples") - FOREIGN | imported("benchmarks")
    assert proof - declared - dev == set()
    assert dev - proof - product == STARTED - proof


def test_constraints_pin_all_that_is_declared() -> None:
    pinned = named((ROOT / "constraints.txt").read_text().split())
    assert named(PROJECT["project"]["dependencies"]) | named(PROJECT["dependency-groups"]["dev"]) <= pinned
    assert pinned >= EXTRAS


def test_the_oldest_python_that_is_asked_for_can_install_all_that_is_pinned() -> None:
    """Debian 12 has Python 3.11.2: one package that asks for a newer 3.11 and `make setup` ends there."""
    oldest = PROJECT["project"]["requires-python"].partition(",")[0].removeprefix(">=") + ".0"
    asked = {}
    for name in named((ROOT / "constraints.txt").read_text().split()):
        with suppress(PackageNotFoundError):  # what only other machines need
            asked[name] = SpecifierSet(str(metadata(name).json.get("requires_python", "")))
    assert len(asked) > 100
    assert {name: str(python) for name, python in asked.items() if oldest not in python} == {}


def test_late_imports_and_names_in_strings_are_found() -> None:
    text = "def f():\n    import late.deep\n    importlib.util.find_spec('sumo')\n"
    assert top_names(ast.parse(text)) == {"late", "sumo"}

"""The contracts of pyproject.toml cover every file that is there, and every one that comes."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import wcsim
from tests.support.tracked import ROOT

PACKAGE = Path(wcsim.__file__).parent
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
FORBIDDEN = [
    contract
    for contract in CONTRACTS
    if contract["type"] == "forbidden"
    and contract["source_modules"] != ["wcsim.cli"]
    and not all(room.startswith("wcsim.") for room in contract["forbidden_modules"])
]
LIBRARIES = sorted({library for contract in FORBIDDEN for library in contract["forbidden_modules"]})


def allowed() -> set[tuple[str, str]]:
    """(module or folder, library) of all exceptions."""
    pairs = (rule.split(" -> ") for contract in FORBIDDEN for rule in contract["ignore_imports"])
    return {(importer.removesuffix(".**"), library) for importer, library in pairs if importer.endswith(".**")}


def lint(folder: Path) -> str:
    code = "from importlinter.cli import lint_imports_command as lint; lint()"
    run = subprocess.run([sys.executable, "-c", code, "--no-cache"], cwd=folder, capture_output=True, text=True)
    assert run.returncode in (0, 1), run.stderr
    return run.stdout


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    shutil.copytree(PACKAGE, tmp_path / "wcsim", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_a_file_planted_in_any_folder_is_seen(copy: Path) -> None:
    """It imports everything that has an owner; each import must be broken where it is no exception."""
    folders = sorted({path.parent for path in copy.rglob("*.py")})
    for folder in folders:
        (folder / "planted.py").write_text("".join(f"import {library}\n" for library in LIBRARIES))
    deep = copy / "wcsim" / "bridge" / "deep"
    deep.mkdir()
    (deep / "__init__.py").write_text("")
    (deep / "planted.py").write_text("import pybullet\nimport libsumo\n")
    told = " ".join(lint(copy).split())
    owners = allowed()
    for folder in folders:
        module = ".".join(folder.relative_to(copy).parts)
        for library in LIBRARIES:
            owned = any(library == what and f"{module}.".startswith(f"{who}.") for who, what in owners)
            assert (f"{module}.planted -> {library} (l." in told) != owned, (module, library)
    assert "wcsim.bridge.deep.planted -> pybullet (l.1)" in told
    assert "wcsim.bridge.deep.planted -> libsumo (l.2)" in told
    assert told.partition("not listed as layers: - ")[2].startswith("wcsim.planted "), "a module in no layer"


def test_a_step_up_is_seen_and_so_is_an_exception_that_nothing_needs(copy: Path) -> None:
    (copy / "wcsim" / "towns" / "planted.py").write_text("def f():\n    import wcsim.view.map\n")
    assert "wcsim.towns is not allowed to import wcsim.view" in lint(copy)
    project = copy / "pyproject.toml"
    text = project.read_text()
    rule = '"wcsim.physics.bullet -> pybullet"'
    assert rule in text
    project.write_text(text.replace(rule, f'{rule}, "wcsim.view.map -> pybullet"'))
    assert "wcsim.view.map -> pybullet" in lint(copy)


def test_no_contract_has_a_list_of_those_it_is_for() -> None:
    assert all(contract["source_modules"] == ["wcsim"] for contract in FORBIDDEN)
    assert len(FORBIDDEN) > 6
    assert all(contract["exhaustive"] for contract in CONTRACTS if contract["type"] == "layers")

"""The package as a whole: layers, names, start-up time, files no longer than they may be."""

from __future__ import annotations

import ast
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import wcsim
from wcsim.agents.networks import encoder
from wcsim.server.specs import SeatRequest

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "wcsim").rglob("*.py"))
FORBIDDEN_CALLS = re.compile(r"\b(pickle|cloudpickle|torch\.load|yaml\.load|eval|exec)\s*[.(]")


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_public_names_are_those_that_are_meant():
    assert wcsim.__all__ == ["ENV_ID", "StreetVecEnv", "WheelchairEnv", "__version__", "parallel_env"]
    assert all(hasattr(wcsim, name) for name in wcsim.__all__)
    assert wcsim.ENV_ID == "wcsim/Street-v1"
    with pytest.raises(AttributeError, match="no attribute 'Street'"):
        _ = wcsim.Street


def test_names_that_docs_told_before_still_work_and_say_where_they_are():
    with pytest.warns(DeprecationWarning, match="wcsim.server.specs.SeatRequest"):
        from wcsim.server.orders import JoinOrder
    assert JoinOrder is SeatRequest
    with pytest.warns(DeprecationWarning, match=r"networks\.encoder\.ObservationEncoder"):
        from wcsim.agents.networks import ObservationEncoder
    assert ObservationEncoder is encoder.ObservationEncoder
    with pytest.raises(ImportError, match="Nothing"):
        from wcsim.server.orders import Nothing  # noqa: F401


def test_completion_shows_the_faces_and_nothing_that_was_only_needed():
    shown = python("import wcsim; print(*dir(wcsim))").split()
    assert set(wcsim.__all__) <= set(shown)
    assert not {"Any", "import_module", "register", "registry", "TYPE_CHECKING"} & set(shown)
    assert [name for name in shown if name.startswith("_") and not name.startswith("__")] == []
    assert python("import sys, wcsim; dir(wcsim); print('wcsim.agents' in sys.modules)") == "False"


def test_importing_the_package_loads_no_simulator_and_no_torch():
    heavy = ("torch", "stable_baselines3", "pettingzoo", "libsumo", "pybullet", "numba", "zmq")
    loaded = python(f"import sys, wcsim; print([m for m in {heavy} if m in sys.modules])")
    assert loaded == "[]"


def test_only_the_vectorised_environment_loads_torch():
    code = "import sys, wcsim; wcsim.WheelchairEnv, wcsim.parallel_env; print('torch' in sys.modules)"
    assert python(code) == "False"


def test_a_world_process_never_loads_torch():
    assert python("import sys, wcsim.server.host.process; print('torch' in sys.modules)") == "False"


def test_help_comes_quickly():
    """In processor time: what it takes on a clock depends on what else the machine does."""
    best = 9.0
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "wcsim", "--help"], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        best = min(best, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert best < 0.5


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_functions_stay_short(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 400
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert (node.end_lineno or 0) - node.lineno < 60, node.name


FOLDERS = sorted({path.parent for path in SOURCES} | {path.parent for path in (ROOT / "tests").rglob("*.py")})
STAY = ("scenarios/sumo", "wcsim/bridge", "wcsim/physics", "wcsim/agents", "wcsim/supervisor", "tests")
MOST_ENTRIES = 14
MOST_ROOMS = 16
ROOTS = (ROOT, ROOT / "wcsim", ROOT / "tests")

def entries(folder: Path) -> set[str]:
    """What one sees in a folder: code and rooms, without data and what Python itself needs."""
    hidden = {
        "__init__.py",
        "__main__.py",
        "__pycache__",
        "conftest.py",
        "py.typed",
        "plants",
        "presets",
        "build",
        "dist",
    }
    seen = (path for path in folder.iterdir() if not path.name.startswith(".") and path.name not in hidden)
    return {path.name for path in seen if path.is_dir() or path.suffix not in (".xml", ".toml") or folder == ROOT}


@pytest.mark.parametrize("folder", [ROOT, *FOLDERS], ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_is_seen_at_a_glance(folder):
    assert len(entries(folder)) <= (MOST_ROOMS if folder in ROOTS else MOST_ENTRIES), sorted(entries(folder))


@pytest.mark.parametrize("folder", STAY)
def test_rooms_that_others_rely_on_stay(folder):
    assert (ROOT / folder).is_dir()


@pytest.mark.parametrize("folder", [f for f in FOLDERS if "wcsim" in f.parts], ids=lambda f: str(f.relative_to(ROOT)))
def test_a_folder_says_what_it_is_for(folder):
    said = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    assert said
    assert len(said.splitlines()[0]) > 20
    assert said.splitlines()[0].endswith(".")


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_executes_foreign_data(path):
    code = ast.unparse(ast.parse(path.read_text(encoding="utf-8")))
    assert not FORBIDDEN_CALLS.search(re.sub(r"\.eval\(\)", "", code))

"""The package as a whole: layers, names, start-up time, files no longer than they may be."""

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import networkx
import pytest

import wcsim
from tests.support.tracked import ROOT, parsed, tracked
from tests.support.typed import python_says

SOURCES = (*tracked("wcsim", ".py"), *tracked("benchmarks", ".py"))
FORBIDDEN_CALLS = re.compile(r"\b(pickle|cloudpickle|torch\.load|yaml\.load|eval|exec)\s*[.(]")

FORBIDDEN_WORDS = re.compile(r"\b(pickle|cloudpickle|load|eval|exec)\b")  # that those calls are made of


@cache
def texts() -> dict[str, str]:
    """What the files of the package say."""
    return {str(path.relative_to(ROOT)): path.read_text() for path in SOURCES}


def trees() -> dict[str, ast.Module]:
    """The same, parsed."""
    return parsed("wcsim") | parsed("benchmarks")


def test_public_names_are_those_that_are_meant():
    assert wcsim.__all__ == ["ENV_ID", "StreetVecEnv", "WheelchairEnv", "__version__", "parallel_env"]
    assert all(hasattr(wcsim, name) for name in wcsim.__all__)
    assert wcsim.ENV_ID == "wcsim/Street-v1"
    with pytest.raises(AttributeError, match="no attribute 'Street'"):
        _ = wcsim.Street


def test_completion_shows_the_faces_and_nothing_that_was_only_needed():
    agents, *shown = python_says(
        "import sys, wcsim; told = dir(wcsim); print('wcsim.agents' in sys.modules, *told)"
    ).split()
    assert agents == "False"
    assert set(wcsim.__all__) <= set(shown)
    assert not {"Any", "import_module", "register", "registry", "TYPE_CHECKING"} & set(shown)
    assert [name for name in shown if name.startswith("_") and not name.startswith("__")] == []


def test_importing_the_package_loads_no_simulator_and_no_torch_which_the_vectorised_environment_alone_loads():
    heavy = ("torch", "stable_baselines3", "pettingzoo", "libsumo", "pybullet", "numba", "zmq")
    code = f"import sys, wcsim; print([m for m in {heavy} if m in sys.modules])"
    faces = "wcsim.WheelchairEnv, wcsim.parallel_env; print('torch' in sys.modules)"
    assert python_says(f"{code}; {faces}").split() == ["[]", "False"]


def test_files_stay_short():
    assert [name for name, text in texts().items() if text.count("\n") > 600] == []


def test_functions_stay_short():
    found = [(name, node) for name, tree in trees().items() for node in ast.walk(tree)]
    long = [f"{name}: {node.name}" for name, node in found if isinstance(node, FUNCTION) and lines(node) >= 80]
    assert long == []


FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


def lines(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Of a function, after its first."""
    return (node.end_lineno or 0) - node.lineno


FOLDERS = sorted({path.parent for path in (*SOURCES, *tracked("tests", ".py"))})
STAY = ("scenarios/sumo", "wcsim/bridge", "wcsim/physics", "wcsim/agents", "wcsim/supervisor", "tests")
MOST_ENTRIES = 14
MOST_ROOMS = 19  # the tests' folder has those of support and of benchmarks beside the product's
ROOTS = (ROOT, ROOT / "wcsim", ROOT / "tests")


def entries(folder: Path) -> set[str]:
    """What one sees in a folder: code and rooms, without data and what Python itself needs."""
    hidden = {
        "__init__.py",
        "__main__.py",
        "conftest.py",
        "py.typed",
        "plants",
        "presets",
    }
    place = str(folder.relative_to(ROOT))
    inside = (path.relative_to(folder) for path in tracked("" if place == "." else place))
    code = (path for path in inside if len(path.parts) > 1 or folder == ROOT or path.suffix not in (".xml", ".toml"))
    return {path.parts[0] for path in code if not path.parts[0].startswith(".")} - hidden


def test_a_folder_is_seen_at_a_glance():
    most = {folder: MOST_ROOMS if folder in ROOTS else MOST_ENTRIES for folder in (ROOT, *FOLDERS)}
    assert {folder: sorted(entries(folder)) for folder in most if len(entries(folder)) > most[folder]} == {}


@pytest.mark.parametrize("folder", STAY)
def test_rooms_that_others_rely_on_stay(folder):
    assert (ROOT / folder).is_dir()


def test_a_folder_says_what_it_is_for():
    folders = {path.parent.relative_to(ROOT) for path in SOURCES}
    said = {str(folder): ast.get_docstring(trees()[str(folder / "__init__.py")]) or "" for folder in folders}
    first = {folder: text.partition("\n")[0] for folder, text in said.items()}
    assert {folder: line for folder, line in first.items() if len(line) <= 20 or not line.endswith(".")} == {}


def test_nothing_executes_foreign_data():
    asked = [name for name, text in texts().items() if FORBIDDEN_WORDS.search(text)]
    code = {name: re.sub(r"\.eval\(\)", "", ast.unparse(trees()[name])) for name in asked}
    assert [name for name, text in code.items() if FORBIDDEN_CALLS.search(text)] == []


def test_no_two_folders_need_each_other():
    """A file's own folder is its room; `TYPE_CHECKING` imports count for nothing, as nothing is loaded by them."""
    graph = networkx.DiGraph()
    for name, tree in trees().items():
        path = ROOT / name
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("wcsim."):
                for alias in node.names:
                    here, there = room_of(path), room_of(file_of(node.module, alias.name))
                    if here != there:
                        graph.add_edge(here, there)
    assert graph.number_of_edges() > 300
    assert [sorted(loop) for loop in networkx.strongly_connected_components(graph) if len(loop) > 1] == []


@cache
def file_of(module: str, name: str) -> Path:
    """Where `from module import name` leads: a file, or the door of a package."""
    folder = ROOT / module.replace(".", "/")
    places = (folder / f"{name}.py", folder / name / "__init__.py", folder.with_suffix(".py"), folder / "__init__.py")
    return next(place for place in places if place.is_file())


@cache
def room_of(path: Path) -> str:
    """The folder of a file; a file that lies beside rooms, as `wcsim/bridge/world.py` does, counts as a room itself."""
    beside_rooms = any(child.is_dir() and child.name != "__pycache__" for child in path.parent.iterdir())
    return str((path if beside_rooms and path.name != "__init__.py" else path.parent).relative_to(ROOT))


MOST_BRANCHES = 15
MOST_PARAMETERS = 8
# Of `wcsim/core/jit.py`: numba takes no dataclasses, and calls cost it inlining.
KERNELS = {"compile_fast_kernel", "compile_exact_kernel"}
BRANCHES = (
    ast.If,
    ast.For,
    ast.AsyncFor,
    ast.While,
    ast.IfExp,
    ast.ExceptHandler,
    ast.comprehension,
    ast.Assert,
    ast.match_case,
)


def branches(function: ast.AST) -> int:
    """Cyclomatic complexity; what is defined inside counts for the function that holds it."""
    nodes = list(ast.walk(function))
    also = sum(len(node.values) - 1 for node in nodes if isinstance(node, ast.BoolOp))
    return 1 + also + sum(isinstance(node, BRANCHES) for node in nodes)


def parameters(function: ast.FunctionDef) -> int:
    taken = function.args
    names = [each.arg for each in (*taken.posonlyargs, *taken.args, *taken.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Names and functions of a file that are no kernels, with those of its classes, without those inside of others."""
    for node in tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        owner = f"{node.name}." if isinstance(node, ast.ClassDef) else ""
        for found in inside:
            if isinstance(found, ast.FunctionDef) and not KERNELS & {ast.unparse(d) for d in found.decorator_list}:
                yield owner + found.name, found


def all_functions() -> list[tuple[str, ast.FunctionDef]]:
    return [each for tree in trees().values() for each in functions(tree)]


def test_functions_are_calm():
    busy = {name: count for name, function in all_functions() if (count := branches(function)) > MOST_BRANCHES}
    assert busy == {}


def test_functions_take_few_parameters():
    wide = {name: count for name, function in all_functions() if (count := parameters(function)) > MOST_PARAMETERS}
    assert wide == {}


def test_branches_and_parameters_are_counted():
    tree = ast.parse(
        "@compile_fast_kernel\ndef fast(a, b): ...\nclass A:\n"
        "  def f(self, a, *, b=0):\n    def g(x): return x if a and b or x else [y for y in x]\n"
        "    try: assert a\n    except OSError: pass\n"
    )
    ((name, found),) = functions(tree)
    assert (name, branches(found), parameters(found)) == ("A.f", 7, 2)


SAME_FILE_NAME = {
    "actors": "what an actor is, and how SUMO's are read",
    "barrier": "the protocol's state machine, and the script of its benchmark",
    "base": "what a room's files build on",
    "build": "a scene's folder, and a learner of its settings",
    "camera": "the sensor, and the script of its benchmark",
    "chair": "its section of a run file, what crosses borders of it, and its command",
    "checkpoint": "of any run, and what a Q-learner puts into it",
    "drive": "a block of a suite, a recording, and the command on whose page a person drives",
    "files": "written whole, and of a scenario",
    "messages": "between clients and a server, and between a page and its drive",
    "pictures": "for people, and of a drive's page",
    "plant": "its file, and what physics makes of it",
    "registry": "networks by name, and sensors by name",
    "rolling": "a chair without the engine, and the script of its benchmark",
    "records": "of a journal, and of crashes",
    "session": "of SUMO, and of a person's drive",
    "run": "its section of a run file, a scene's, and the command of a town's",
    "scene": "its file, and the command",
    "soak": "the benchmark, and its script",
    "street": "what crosses borders of it, and how it is built",
    "table": "of users, and of chairs",
    "train": "the loop, and the command",
    "users": "their commands, and the script of their benchmark",
    "world": "its section of a run file, and the world",
}


def doubles(names: Iterable[str]) -> set[str]:
    return {name for name, count in Counter(names).items() if count > 1}


def test_a_class_name_is_used_once():
    nodes = (node for tree in trees().values() for node in ast.walk(tree))
    names = (node.name for node in nodes if isinstance(node, ast.ClassDef) and not node.name.startswith("_"))
    assert doubles(names) == set()


def test_a_file_name_is_used_twice_only_where_the_folder_makes_it_plain():
    assert doubles(path.stem for path in SOURCES if not path.stem.startswith("__")) == set(SAME_FILE_NAME)


PAGES = [path for path in tracked("", ".md") if path.parent == ROOT or ROOT / "docs" in path.parents]
FOLDERS_NAMED = {part for path in SOURCES for part in path.relative_to(ROOT).parts[:2]}
FOLDERS_NAMED |= {"tests", "docs", "tools", "examples", "scenarios"}
NOT_OURS = {
    *("__init__.py", "randomTrips.py", "dist/NOTES.md", "wcsim/Street-v1"),  # any; SUMO's; a release's; an id
    "exported_policy.py",  # of an exported folder
}


def is_ours(word: str) -> bool:
    """Whether a word in backticks names a file or folder of the repository; with NAME in it, it is only a pattern."""
    if word in NOT_OURS or "NAME" in word or word.startswith("scenarios/sumo/my"):
        return False
    a_file = re.fullmatch(r"[\w-]+(/[\w-]+)*\.(py|md)", word)
    return bool(a_file) or ("/" in word and word.split("/")[0] in FOLDERS_NAMED)


def not_there(text: str, here: Path) -> list[str]:
    """Files and folders that a text names and that are not there; `here` is the folder of the file that it stands in.

    A bare file name is in that folder, or in the one that was named last on the line.
    """
    missing = []
    for line in text.splitlines():
        last = here
        for word in re.findall(r"`([\w./-]+)`", line):
            homes = [here, last, ROOT, ROOT / "wcsim", *last.parents] if "/" in word else [here, last, ROOT]
            found = next((home / word for home in homes if (home / word).exists()), None)
            if is_ours(word) and found is None:
                missing.append(word)
            if "/" in word and found is not None:
                last = found if found.is_dir() else found.parent
    return missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_a_page_names_are_there(page):
    assert not_there(page.read_text(), page.parent) == []


def test_files_that_docstrings_name_are_there():
    said = (
        (name, ast.get_docstring(node) or "")
        for name, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
    )
    missing = {name: lost for name, text in said if (lost := not_there(text, (ROOT / name).parent))}
    assert missing == {}


def test_a_file_that_is_not_there_is_found():
    told = "`bridge/world.py`, `mirror.py`, `session.py`, `reaction/drivers.py`; `town.toml`, `bridge/nothing.py`"
    assert not_there(told, ROOT) == ["session.py", "bridge/nothing.py"]


def test_what_git_ignores_stays_out_of_the_image():
    """Results of hours and caches of tools are no part of wcsim, and every change in them builds it anew."""

    def ignored(file: str) -> set[str]:
        return {line.removeprefix("**/").strip("/") for line in (ROOT / file).read_text().splitlines()}

    assert ignored(".gitignore") <= ignored(".dockerignore")

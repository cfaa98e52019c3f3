"""Counts of the source tree: code lines, public names, settings, and the ideas that exist more than once."""

import ast
import io
import tokenize
from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Final

from tests.support.tracked import ROOT, tracked
from tools.readability import pages, words
from tools.settings_page import keys, sections

TOKENS_A_LINE: Final = 10.5  # of the code when the table was begun, so joined lines save nothing
_BETWEEN: Final = (tokenize.COMMENT, tokenize.NL)
_NO_CODE: Final = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
_COMMENTED: Final = ("wcsim/physics", "wcsim/bridge", "wcsim/agents/danger", "wcsim/supervisor")
_STARTS: Final = ("run", "Popen", "fork", "ProcessPoolExecutor", "Process", "remote")
_STARTERS: Final = ("subprocess", "os", "context", "ray", "")
# Where an idea stands that has more than one form: the file that goes with it, or the class in it.
IDEAS: Final[dict[str, tuple[str, ...]]] = {
    "formats": ("wcsim/log/records.py",),
    "meters": ("wcsim/supervisor/kpi.py:KpiTotals",),
    "learners": (
        "wcsim/agents/learning/seqdqn.py",
        "wcsim/agents/danger/learner.py",
    ),
}
# The importing modules, what they should not import, and what is left out of the first, by the beginning of names.
BORDERS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]]] = {
    "world -> recordings": (
        ("bridge",),
        ("bridge.recording",),
        ("bridge.recording", "bridge.town_run", "bridge.user_drives"),
    ),
    "world -> a user's recordings": (("bridge.ego", "bridge.world"), ("users.recordings", "log"), ()),
    "users -> recordings": (("users",), ("log",), ("users.recordings",)),
    "shared world -> recordings": (("server",), ("bridge.recording",), ()),
    "processes -> shared world": (("server.launch",), ("server.specs", "server.protocol", "log"), ()),
    "danger -> policies": (("agents.danger",), ("agents.policies",), ()),
    "danger -> Q-learning": (("agents.danger",), ("agents.learning", "agents.networks.q_network"), ()),
    "Q-learning -> danger": (("agents.learning",), ("agents.danger",), ()),
    "page -> evaluation": (("drive",), ("agents.evaluation",), ()),
    "runs -> policies": (("agents.runs",), ("agents.policies",), ()),
    "evaluation -> learners": (("agents.evaluation",), ("agents.learning", "agents.danger", "agents.rounds"), ()),
    "data -> policies": (("agents.rounds",), ("agents.policies",), ()),
    "policies -> learners": (("agents.policies",), ("agents.learning", "agents.danger", "agents.rounds"), ()),
    "supervisor -> learners": (("supervisor",), ("agents",), ()),
}


def code_lines(folder: str) -> float:
    """Tokens of a folder's Python that are neither docstring, comment nor layout, in lines of the usual length."""
    return round(sum(_tokens(text)[0] for _, text in _sources(folder)) / TOKENS_A_LINE)


def lines_per_comment() -> float:
    """Code lines for each comment where numerics, order and ties are decided."""
    counts = [_tokens(text) for folder in _COMMENTED for _, text in _sources(folder)]
    return round(sum(code for code, _ in counts) / TOKENS_A_LINE / max(1, sum(comments for _, comments in counts)), 1)


def import_share() -> float:
    """Percent of the package's lines with code on them that are imports."""
    code = imports = 0
    for _, text in _sources("wcsim"):
        code += len(_lines(text))
        found = [node for node in _nodes(text) if isinstance(node, ast.Import | ast.ImportFrom)]
        imports += sum((node.end_lineno or node.lineno) - node.lineno + 1 for node in found)
    return round(100.0 * imports / code, 1)


def files(folder: str) -> float:
    """Python files of a folder."""
    return len(_sources(folder))


def text_lines(*suffixes: str) -> float:
    """Lines with something on them, in the package's files of these kinds."""
    texts = [path.read_text(encoding="utf-8") for suffix in suffixes for path in tracked("wcsim", suffix)]
    return sum(bool(line.strip()) for text in texts for line in text.splitlines())


def public_names() -> float:
    """Functions and classes of the package's modules without an underscore."""
    defined = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    nodes = [node for _, text in _sources("wcsim") for node in _tree(text).body if isinstance(node, defined)]
    return sum(not node.name.startswith("_") for node in nodes)


def settings() -> float:
    """Leaves of a run's configuration."""
    return sum(len(keys(model)) for _, model in sections())


def words_of_docs() -> float:
    """Words below `docs/` that are written by hand."""
    return sum(words(page.read_text(encoding="utf-8")) for page in pages() if page.is_relative_to(ROOT / "docs"))


def forms(idea: str) -> float:
    """How many forms of an idea there are; each stands in a file of its own."""
    return len(IDEAS[idea])


def tick_loops() -> float:
    """Files of the package that advance a world."""
    return sum(_calls(text, _ticks_a_world) for _, text in _sources("wcsim"))


def process_starters() -> float:
    """Files of the package that start a process."""
    return sum(_calls(text, _starts_a_process) for _, text in _sources("wcsim"))


def rewriters() -> float:
    """Functions of the package that return a `RunConfig`."""
    trees = [_nodes(text) for _, text in _sources("wcsim") if "RunConfig" in text]
    returned = [node.returns for tree in trees for node in tree if isinstance(node, ast.FunctionDef) and node.returns]
    return sum("RunConfig" in ast.unparse(annotation) for annotation in returned)


def broken_borders() -> float:
    """How many borders something crosses."""
    return sum(bool(crossings(name)) for name in BORDERS)


def crossings(border: str) -> list[tuple[str, str]]:
    """(importing module, what it imports) over one border."""
    sources, targets, excepted = BORDERS[border]
    found = []
    for name, text in _sources("wcsim"):
        if _is_below(name, sources) and not _is_below(name, excepted):
            found += [(name, imported) for imported in _imported(text) if _is_below(imported, targets)]
    return found


@cache
def _sources(folder: str) -> list[tuple[str, str]]:
    """(dotted name below the folder, text) of each Python file."""
    place = ROOT / folder
    paths = tracked(folder, ".py") if place.is_dir() else ()
    return [(".".join(p.relative_to(place).with_suffix("").parts), p.read_text(encoding="utf-8")) for p in paths]


@cache
def _tree(text: str) -> ast.Module:
    return ast.parse(text)


@cache
def _nodes(text: str) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(_tree(text)))


@cache
def _tokens(text: str) -> tuple[int, int]:
    """(tokens of code, comments); comment lines below one another are one, and those behind code are none."""
    comments = {number for number, line in enumerate(text.splitlines(), 1) if line.lstrip().startswith("#")}
    return sum(_lines(text).values()), sum(number - 1 not in comments for number in comments)


@cache
def _lines(text: str) -> Counter[int]:
    """Of each line how many tokens of code begin on it; strings that stand alone are docstrings."""
    tokens = [each for each in tokenize.generate_tokens(io.StringIO(text).readline) if each.type not in _BETWEEN]
    found, before = Counter[int](), tokenize.NEWLINE
    for token, after in pairwise(tokens):
        is_doc = token.type == tokenize.STRING and before in _NO_CODE and after.type == tokenize.NEWLINE
        if token.type not in _NO_CODE and not is_doc:
            found[token.start[0]] += 1
        before = token.type
    return found


def _calls(text: str, is_one: Callable[[str], bool]) -> bool:
    return any(is_one(name) for name in _called(text))


@cache
def _called(text: str) -> frozenset[str]:
    """Names of what a text calls, itself or by a class of its own."""
    nodes = [node.func for node in _nodes(text) if isinstance(node, ast.Call)]
    bases = [base for node in _nodes(text) if isinstance(node, ast.ClassDef) for base in node.bases]
    nodes += [base.value if isinstance(base, ast.Subscript) else base for base in bases]
    return frozenset(ast.unparse(node) for node in nodes if isinstance(node, ast.Attribute | ast.Name))


def _ticks_a_world(called: str) -> bool:
    owner, _, name = called.rpartition(".")
    return name == "tick" and owner.rpartition(".")[2].strip("_") == "world"


def _starts_a_process(called: str) -> bool:
    owner, _, name = called.rpartition(".")
    return name in _STARTS and owner in _STARTERS


def _imported(text: str) -> set[str]:
    """Modules of the package that a text imports, at its head or within a function."""
    found: set[str] = set()
    for node in _nodes(text):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name.removeprefix("wcsim.") for name in found if name.startswith("wcsim.")}


def _is_below(name: str, rooms: tuple[str, ...]) -> bool:
    return any(f"{name}.".startswith(f"{room}.") for room in rooms)

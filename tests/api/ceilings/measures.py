"""Counts of the source tree: tokens, names, comments, settings, and the ideas that exist more than once."""

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Final

from tests.support.tracked import ROOT, tracked
from tools.readability import pages, words
from tools.settings_page import keys, sections

TOKENS_A_LINE: Final = 10.5  # of the code when the table was begun
DECIDING: Final = ("wcsim/physics", "wcsim/bridge", "wcsim/agents/danger", "wcsim/supervisor")
_BETWEEN: Final = (tokenize.COMMENT, tokenize.NL)
_NO_CODE: Final = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
_STARTS: Final = ("run", "Popen", "fork", "ProcessPoolExecutor", "Process", "remote")
_KPI1_SUM = "distance_sum"
_MAGIC: Final = re.compile(r"\w*MAGIC\w*.* = b?'wcsim")
_STARTERS: Final = ("subprocess", "os", "context", "ray", "")
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


def tokens(folder: str = "wcsim") -> float:
    """Tokens of a folder's Python that are neither docstring, comment nor layout: joined lines save nothing."""
    return sum(_tokens(text)[0] for _, text in _sources(folder))


def rooms() -> list[str]:
    """The package's folders that are looked at by themselves: those of its first level, of `agents` those below."""
    names = [tuple(name.split(".")) for name, _ in _sources("wcsim")]
    below = {name[:2] for name in names if name[0] == "agents" and len(name) > 2}
    found = below | {name[:1] for name in names if name[0] != "agents" and len(name) > 1}
    return sorted("/".join(("wcsim", *name)) for name in found)


def lines_per_comment(*folders: str) -> float:
    """Code lines for each comment that has a line of its own; lines below one another are one comment."""
    counts = [_tokens(text) for folder in folders or ("wcsim",) for _, text in _sources(folder)]
    return round(sum(code for code, _ in counts) / TOKENS_A_LINE / max(1, sum(comments for _, comments in counts)), 1)


def silent_rooms() -> float:
    """Rooms with more than 40 code lines for each comment of a line of its own."""
    return sum(lines_per_comment(room) > 40.0 for room in rooms())


def import_share() -> float:
    """Percent of the package's lines with code on them that are imports."""
    code = imports = 0
    for _, text in _sources("wcsim"):
        code += len(_lines(text))
        found = [node for node in _nodes(text) if isinstance(node, ast.Import | ast.ImportFrom)]
        imports += sum((node.end_lineno or node.lineno) - node.lineno + 1 for node in found)
    return round(100.0 * imports / code, 1)


def files(folder: str = "wcsim") -> float:
    """Python files of a folder."""
    return len(_sources(folder))


def text_lines(*suffixes: str) -> float:
    """Lines with something on them, in the package's files of these kinds; three.js is another's."""
    paths = [path for suffix in suffixes for path in tracked("wcsim", suffix) if path.name != "three.js"]
    texts = [path.read_text() for path in paths]
    return sum(bool(line.strip()) for text in texts for line in text.splitlines())


def public_names() -> float:
    """Functions and classes of the package's modules without an underscore."""
    return sum(not node.name.startswith("_") for _, text in _sources("wcsim") for node in _defined(text))


def names(folder: str = "wcsim") -> float:
    """Functions and classes at the top of the modules of a folder, with and without an underscore."""
    return sum(len(_defined(text)) for _, text in _sources(folder))


def called_once(folder: str = "wcsim") -> float:
    """Private functions and methods whose module names them once only, to call them; kernels are left out."""
    return sum(len(_once(text)) for _, text in _sources(folder))


def late_constants(folder: str = "wcsim") -> float:
    """Files with a constant behind the first function or class that is made of none of these."""
    return sum(_has_late(text) for _, text in _sources(folder))


def settings() -> float:
    """Leaves of a run's configuration."""
    return sum(len(keys(model)) for _, model in sections())


def words_of_docs() -> float:
    """Words below `docs/` that are written by hand."""
    return sum(words(page.read_text()) for page in pages() if page.is_relative_to(ROOT / "docs"))


def formats() -> list[str]:
    """Modules with a format of their own: they have a constant of bytes or text that begins with the project's name."""
    return [
        name for name, text in _sources("wcsim") if any(_MAGIC.match(ast.unparse(node)) for node in _tree(text).body)
    ]


def meters() -> list[str]:
    """Functions that add up KPI 1: they give a sum its name."""
    return [
        f"{name}:{node.name}"
        for name, text in _sources("wcsim")
        for node in _nodes(text)
        if isinstance(node, ast.FunctionDef) and any(map(_names_kpi1, ast.walk(node)))
    ]


def learners() -> list[str]:
    """Modules that move weights along a gradient."""
    return [name for name, text in _sources("wcsim") if any(each.endswith(".backward") for each in _called(text))]


def resolvers() -> float:
    """Files of the package that resolve settings."""
    return sum("resolve" in _called(text) for _, text in _sources("wcsim"))


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


def roundabout_borders() -> float:
    """How many borders something crosses by what it imports in turn."""
    return sum(bool(crossings(name, indirect=True)) for name in BORDERS)


def crossings(border: str, indirect: bool = False) -> list[tuple[str, str]]:
    """(importing module, what it imports) over one border; `indirect`: also what that imports in turn."""
    sources, targets, excepted = BORDERS[border]
    found = []
    for name, text in _sources("wcsim"):
        if _is_below(name, sources) and not _is_below(name, excepted):
            all_of_it = _reached(name) if indirect else _imported(text)
            found += [(name, imported) for imported in all_of_it if _is_below(imported, targets)]
    return found


@cache
def _sources(folder: str) -> list[tuple[str, str]]:
    """(dotted name below the folder, text) of each Python file."""
    place = ROOT / folder
    paths = tracked(folder, ".py") if place.is_dir() else ()
    return [(".".join(p.relative_to(place).with_suffix("").parts), p.read_text()) for p in paths]


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


def _defined(text: str) -> list[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    return [node for node in _tree(text).body if isinstance(node, kinds)]


@cache
def _once(text: str) -> list[str]:
    """Private functions and methods that one call names, and nothing else; not from within, and no kernels."""
    named = Counter[str]()
    called = Counter[str]()
    for node in _nodes(text):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
            named[node.id if isinstance(node, ast.Name) else node.attr] += 1
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            called[node.func.id if isinstance(node.func, ast.Name) else node.func.attr] += 1
    return [
        node.name
        for node in _nodes(text)
        if isinstance(node, ast.FunctionDef)
        and node.name.startswith("_")
        and not node.name.endswith("__")
        and named[node.name] == called[node.name] == 1
        and not any("kernel" in ast.unparse(each) for each in node.decorator_list)
        and not any(isinstance(each, ast.Name) and each.id == node.name for each in ast.walk(node))
    ]


def _has_late(text: str) -> bool:
    body = _tree(text).body
    defined: set[str] = set()
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            defined.add(node.name)
        elif defined and isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            used = {each.id for each in ast.walk(node.value) if isinstance(each, ast.Name)}
            if not used & defined:
                return True
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            defined.update(map(ast.unparse, targets))
    return False


def _names_kpi1(node: ast.AST) -> bool:
    if isinstance(node, ast.Dict):
        return any(isinstance(key, ast.Constant) and key.value == _KPI1_SUM for key in node.keys)
    return isinstance(node, ast.keyword) and node.arg == _KPI1_SUM


@cache
def _reached(name: str) -> frozenset[str]:
    """Modules that are imported when `name` is, by whatever way."""
    texts = dict(_sources("wcsim"))
    found: set[str] = set()
    left = [name]
    while left:
        text = texts.get(left.pop())
        fresh = set() if text is None else {each for each in _imported(text) if each in texts} - found
        found |= fresh
        left += fresh
    return frozenset(found)


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

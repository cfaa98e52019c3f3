"""Which code runs: the package's files that a module needs, and the versions of other packages.

The files are found without running them.
"""

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

_NAME: Final = __name__.partition(".")[0]
_ROOT: Final = Path(__file__).parents[__name__.count(".")]
# Rooms that nothing imports that drives: `make lint` checks it.
_ABOVE: Final = ("chair_check", "cli", "scenes", "view")
_FOR_TYPES_ALONE: Final = re.compile(r"^if TYPE_CHECKING:[^\n]*\n(?:[ \t]+.*\n|\n)+", re.MULTILINE)
_FROM: Final = re.compile(r"^[ \t]*from ([\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_PLAIN: Final = re.compile(r"^[ \t]*import ([\w., ]+)", re.MULTILINE)
_COMMENT: Final = re.compile(r"#[^\n]*")
# PyBullet for Python 3.12 and later: its own packages end at 3.11.
_FORK: Final = "pybullet-arm64"
# Of the fork, and of PyBullet itself: scenes have the same hashes with both.
_SAME_BYTES: Final = {"3.2.8": "3.2.7"}

# Module, a name of it ("" for the module itself), its name in the importing file.
Imported = tuple[str, str, str]


def find_imported_source_files(module: str) -> tuple[Path, ...]:
    """The files of the package that a module needs, its own among them, sorted.

    What is imported for type checkers alone does not count; what a function imports does. A name
    that a module only passes on counts for the file in which it is made, so a file that only
    gathers names is left out.
    """
    seen: set[tuple[str, str]] = set()
    files: set[Path] = set()
    waiting = [(module, "")]
    while waiting:
        home, name = waiting.pop()
        if (home, name) in seen:
            continue
        seen.add((home, name))
        path = _file_of(home)
        if path is None:
            continue
        inner = f"{home}.{name}"
        if name and _file_of(inner) is not None:
            waiting.append((inner, ""))
            continue
        imported, _ = _parsed(path)
        passed_on = [(other, what) for other, what, here in imported if name and here == name]
        if not passed_on:
            files.add(path)
        waiting += passed_on or [(other, what) for other, what, _ in imported]
    return tuple(sorted(files))


def hash_package_code(root: Path = _ROOT / _NAME) -> str:
    """SHA-256 over every file of the package in `root` that a drive may run or read.

    Commands and pictures are none.
    """
    digest = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.toml")]):
        place = path.relative_to(root)
        if place.parts[0] not in _ABOVE:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def read_package_version(package: str) -> str:
    """The version of a distribution, "" where it is not installed.

    That of "pybullet" is of the engine: a fork that gives the same bytes counts as the release that
    it repeats.
    """
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        if package != "pybullet":
            return ""
    fork = read_package_version(_FORK)
    return _SAME_BYTES.get(fork, fork and f"{_FORK}-{fork}")


def _file_of(module: str) -> Path | None:
    if module.partition(".")[0] != _NAME:
        return None
    stem = _ROOT.joinpath(*module.split("."))
    for path in (stem.with_suffix(".py"), stem / "__init__.py"):
        if path.is_file():
            return path
    return None


@cache
def _parsed(path: Path) -> tuple[tuple[Imported, ...], frozenset[str]]:
    """The imports of a file from the package, and the top-level names of its other imports."""
    text = _FOR_TYPES_ALONE.sub("", path.read_text(encoding="utf-8"))
    found = tuple(_imports(text))
    own = tuple(item for item in found if item[0].partition(".")[0] == _NAME)
    return own, frozenset(module.partition(".")[0] for module, _, _ in found) - {_NAME}


def _imports(text: str) -> Iterator[Imported]:
    for module, names in _FROM.findall(text):
        for name in _COMMENT.sub("", names).strip("() \n").split(","):
            what, _, alias = name.strip().partition(" as ")
            if what:
                yield module, what, alias or what
    for modules in _PLAIN.findall(text):
        for name in modules.split(","):
            yield name.strip().partition(" as ")[0], "", ""

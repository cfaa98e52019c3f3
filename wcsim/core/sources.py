"""Which code runs: files of the package that a module needs, found without running them; versions of other packages."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

_NAME = __name__.partition(".")[0]
_ROOT = Path(__file__).parents[__name__.count(".")]
_ABOVE = (
    "chair_check",
    "cli",
    "scenes",
    "view",
)  # rooms that nothing imports that drives: `make lint` sees to it
_FOR_TYPES_ALONE = re.compile(r"^if TYPE_CHECKING:[^\n]*\n(?:[ \t]+.*\n|\n)+", re.MULTILINE)
_FROM = re.compile(r"^[ \t]*from ([\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_PLAIN = re.compile(r"^[ \t]*import ([\w., ]+)", re.MULTILINE)
_COMMENT = re.compile(r"#[^\n]*")
_FORK: Final = "pybullet-arm64"  # PyBullet for Python 3.12 and later: its own packages end at 3.11
_SAME_BYTES: Final = {
    "3.2.8": "3.2.7"
}  # of the fork, and of PyBullet itself: scenes have the same hashes with both

Imported = tuple[
    str, str, str
]  # module, a name of it ("" for the module itself), what it is called here


def sources_of(module: str) -> tuple[Path, ...]:
    """The files of the package that a module needs, its own among them, sorted.

    What is imported for type checkers alone does not count; what is imported late, in a function, does. A name that
    a module only passes on counts for the file in which it is made, so a file that gathers names is not in itself
    a reason.
    """
    seen: set[tuple[str, str]] = set()
    wanted, files = [(module, "")], set()
    while wanted:
        at = wanted.pop()
        if at in seen:
            continue
        seen.add(at)
        home, name = at
        path = _file_of(home)
        if path is None:
            continue
        inner = f"{home}.{name}"
        if name and _file_of(inner) is not None:
            wanted.append((inner, ""))
            continue
        imported, _ = _parsed(path)
        passed_on = [(other, what) for other, what, here in imported if name and here == name]
        if not passed_on:
            files.add(path)
        wanted += passed_on or [(other, what) for other, what, _ in imported]
    return tuple(sorted(files))


def code_digest(root: Path = _ROOT / _NAME) -> str:
    """SHA-256 over every file of the package in `root` that a drive may run or read: commands and pictures are none."""
    text = hashlib.sha256()
    for path in sorted(path for kind in ("*.py", "*.toml") for path in root.rglob(kind)):
        place = path.relative_to(root)
        if place.parts[0] not in _ABOVE:
            text.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return text.hexdigest()


def version_of(package: str) -> str:
    """The version of a distribution, "" where it is not installed.

    The one of "pybullet" is that of the engine: a fork that gives the same bytes counts as the release that it repeats.
    """
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        if package != "pybullet":
            return ""
    fork = version_of(_FORK)
    return _SAME_BYTES.get(fork, fork and f"{_FORK}-{fork}")


def _file_of(module: str) -> Path | None:
    if module.partition(".")[0] != _NAME:
        return None
    stem = _ROOT.joinpath(*module.split("."))
    return next(
        (path for path in (stem.with_suffix(".py"), stem / "__init__.py") if path.is_file()), None
    )


@cache
def _parsed(path: Path) -> tuple[tuple[Imported, ...], frozenset[str]]:
    """What a file imports of the package, and the top-level names of what else it imports."""
    text = _FOR_TYPES_ALONE.sub("", path.read_text(encoding="utf-8"))
    found = tuple(_named(text))
    own = tuple(item for item in found if item[0].partition(".")[0] == _NAME)
    return own, frozenset(module.partition(".")[0] for module, _, _ in found) - {_NAME}


def _named(text: str) -> Iterator[Imported]:
    for module, names in _FROM.findall(text):
        for name in _COMMENT.sub("", names).strip("() \n").split(","):
            what, _, called = name.strip().partition(" as ")
            if what:
                yield module, what, called or what
    for modules in _PLAIN.findall(text):
        for name in modules.split(","):
            yield name.strip().partition(" as ")[0], "", ""

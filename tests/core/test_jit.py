"""Machine code on disk: made anew when anything that is frozen into it changes, and not for ever more."""

import importlib
import json
import math
import os
import subprocess
import sys
from enum import IntEnum
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.extending import is_jitted

import wcsim
from wcsim.core import jit, joystick
from wcsim.core.files import KERNELS
from wcsim.core.jit import _frozen_digest, compile_exact_kernel

ROOT = Path(wcsim.__file__).parent
OWN = {
    "__init__": "",
    "law": "from wcsim.core.jit import compile_exact_kernel\n\nSLOWER = 3.0\n\n\n"
    "@compile_exact_kernel\ndef slowed(x):\n"
    "    return x / SLOWER\n",
    "boxes": "from wcsim.core.jit import compile_exact_kernel\n\n\n"
    "@compile_exact_kernel\ndef apart(x):\n    return x > 1.0\n",
    "drive": "from own.boxes import apart\nfrom own.law import slowed\n"
    "from wcsim.core.jit import compile_exact_kernel\n\n\n"
    "@compile_exact_kernel\ndef target(x):\n    return slowed(x) + 1.0\n\n\n"
    "@compile_exact_kernel\ndef touches(x):\n    return not apart(x)\n",
}
CODE = """
import json
from own.drive import target, touches
told = target(6.0), touches(6.0)
print(json.dumps([*told, [sum(kernel.stats.cache_hits.values()) for kernel in (target, touches)]]))
"""
"""Two kernels that call one of another file; the first one's callee freezes a constant of that file."""


def kernels(module: ModuleType) -> list[object]:
    """The kernels that a module defines."""
    return [value for value in vars(module).values() if is_jitted(value) and value.__module__ == module.__name__]


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, old
    path.write_text(text.replace(old, new))


def test_a_caller_follows_the_kernels_and_constants_of_other_files(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    for name, text in OWN.items():
        (own / f"{name}.py").write_text(text)

    def answers() -> list[object]:
        words = [sys.executable, "-B", "-c", CODE]  # a .pyc does not notice two edits within a second
        places = {"PYTHONPATH": str(ROOT.parent), "XDG_CACHE_HOME": str(tmp_path / "cache")}
        run = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True, env=places)
        return json.loads(run.stdout)

    assert answers() == [3.0, False, [0, 0]]
    change(own / "law.py", "SLOWER = 3.0", "# slower\nSLOWER = 3.0")
    assert answers() == [3.0, False, [1, 1]]  # a comment, and lines that move, cost nothing
    change(own / "law.py", "SLOWER = 3.0", "SLOWER = 2.0")
    change(own / "boxes.py", "x > 1.0", "x > 9.0")
    assert answers() == [4.0, True, [0, 0]]
    (own / "law.py").rename(own / "rule.py")
    change(own / "drive.py", "own.law", "own.rule")
    assert answers() == [4.0, True, [0, 1]]  # a copy imports a callee's file by its name


def test_every_kernel_says_what_is_frozen_into_it() -> None:
    """Whatever a kernel names can be told, so none is compiled from an old copy; 73 kernels and more."""
    homes = [path for path in ROOT.rglob("*.py") if "from wcsim.core.jit import compile_" in path.read_text()]
    digests = []
    for path in homes:
        name = ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
        found = kernels(importlib.import_module(name))
        assert found, name
        digests += [_frozen_digest(kernel) for kernel in found]
    assert len(set(digests)) == len(digests) > 70


FACTOR = 2.0
TABLE = np.arange(3.0)


class Kind(IntEnum):
    LOW = 1


class Pair(NamedTuple):
    left: float
    right: float


PAIR = Pair(1.0, 2.0)


@compile_exact_kernel
def inner(x: float) -> float:
    return x * FACTOR + math.sqrt(4.0)


@compile_exact_kernel
def outer(pair: Pair) -> float:
    """A callee, a number, an array, an enumeration, a tuple, a constant of a module, an argument with names."""
    return inner(pair.left) + TABLE[1] + Kind.LOW + PAIR.right + joystick.STILL_MPS


@pytest.mark.parametrize(
    "where, name, value",
    [
        (None, "FACTOR", 3.0),
        (None, "TABLE", np.arange(1.0, 4.0)),
        (None, "TABLE", np.arange(3)),
        (None, "Kind", IntEnum("Kind", {"LOW": 2})),
        (None, "PAIR", Pair(1.0, 3.0)),
        (None, "Pair", NamedTuple("Pair", [("right", float), ("left", float)])),
        (joystick, "STILL_MPS", 1.0),
        (None, "inner", jit.compile_fast_kernel(inner.py_func)),
    ],
)
def test_each_kind_of_frozen_thing_counts(
    where: ModuleType | None, name: str, value: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = _frozen_digest(outer)
    monkeypatch.setattr(where or sys.modules[__name__], name, value)
    assert _frozen_digest(outer) != before
    monkeypatch.undo()
    assert _frozen_digest(outer) == before


def test_what_can_be_no_constant_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "TABLE", Path(), raising=True)
    assert "pathlib.Path" not in _frozen_digest(outer)  # of a library: its name counts
    monkeypatch.setattr(sys.modules[__name__], "TABLE", type("Own", (), {"__module__": __name__})())
    with pytest.raises(TypeError, match=r"a kernel refers to .*Own.*expected a kernel, a number"):
        _frozen_digest(outer)


def test_old_copies_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for factor in range(6):
        monkeypatch.setattr(sys.modules[__name__], "FACTOR", float(factor))
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        copy = compile_exact_kernel(inner.py_func)
        copy._cache._cache_path = str(tmp_path)
        monkeypatch.setattr(copy._cache._impl.locator, "_cache_path", str(tmp_path))
        assert copy(1.0) == factor + 2.0
    for place in (tmp_path, tmp_path / "cache" / "wcsim" / KERNELS / __name__):
        indices, codes = sorted(place.glob("*.nbi")), sorted(place.glob("*.nbc"))
        assert len(indices) == len(codes) == jit.MOST_COPIES
        assert {path.name.split(".1.")[0] for path in codes} == {path.stem for path in indices}


def test_another_checkout_finds_the_copies_of_the_first_and_keeps_them_without_the_cache(tmp_path: Path) -> None:
    hits = []
    for checkout, cache in (("one", "cache"), ("two", "cache"), ("two", "another"), ("three", "another")):
        (tmp_path / checkout / "own").mkdir(parents=True, exist_ok=True)
        for name, text in OWN.items():
            (tmp_path / checkout / "own" / f"{name}.py").write_text(text)
        env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / cache)}
        told = subprocess.check_output([sys.executable, "-c", CODE], cwd=tmp_path / checkout, env=env)
        hits.append(json.loads(told)[-1])
    assert hits == [[0, 0], [1, 1], [1, 1], [0, 0]]


FORKED = """
import os
from cold import plus
child = os.fork()
if child == 0:
    os._exit(0 if plus(2.0) == 3.0 else 1)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
assert plus(3.0) == 4.0
"""


def test_a_forked_copy_of_a_process_compiles_what_nobody_has_compiled_yet(tmp_path: Path) -> None:
    """Judges of a suite are forks of the world; on a new machine one of them is the first that needs a kernel."""
    cold = (
        "from wcsim.core.jit import compile_exact_kernel\n\n\n@compile_exact_kernel\ndef plus(x):\n    return x + 1.0\n"
    )
    (tmp_path / "cold.py").write_text(cold)
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", FORKED], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_where_nothing_can_be_kept_kernels_still_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit._Copies, "_locator_classes", [])
    assert compile_exact_kernel(inner.py_func)(1.0) == 4.0


def test_a_package_that_cannot_be_written_has_its_copies_in_the_users_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(_: object) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(numba.core.caching.InTreeCacheLocator, "ensure_cache_path", refused)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    # As after a map was read in this process: that place is for others' kernels.
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "others"))
    hits = []
    for _ in range(2):
        copy = compile_exact_kernel(inner.py_func)
        assert copy(1.0) == 4.0
        hits.append(sum(copy.stats.cache_hits.values()))
    assert hits == [0, 1] and len(list((tmp_path / "wcsim" / KERNELS).rglob("*.nbi"))) == 1

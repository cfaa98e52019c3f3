"""Compiles kernels with numba, and caches the machine code on disk where that is possible.

numba freezes into a kernel whatever it takes from outside: the kernels that it calls, from any
file, and the constants that it names. Its own cache notices a change of the kernel's file alone. So
here a copy is named by a digest of the kernel and of all that is frozen into it, taken at the first
call, when everything has its value.

The copies lie in `__pycache__` beside the source, and in wcsim's cache folder, where another
checkout or installation finds them; where neither can be written, each process compiles for itself.
The newest few copies of a kernel stay. Of processes that need the same copy at the same time one
compiles it, and the others wait for a lock beside it.
"""

import hashlib
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from enum import Enum
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
import numpy as np
from filelock import FileLock, Timeout
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)
from numba.extending import is_jitted

from wcsim.core.files import KERNELS, find_cache_folder

P = ParamSpec("P")
R = TypeVar("R")

# A kernel takes seconds to compile; a process that holds its lock longer was stopped.
LONGEST_WAIT_S: Final = 60.0
# Of a kernel: who goes to and fro between two states of the code compiles each once.
MOST_COPIES: Final = 3
# Rounding must depend on how a loop is vectorised as little as possible: products may be fused.
_FAST: Final = {"contract", "nsz"}
_WORD: Final = re.compile(r"\w+")


def compile_fast_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a drawing kernel on its first call: no GIL, products fused, no division errors."""
    return _compiled(function, nogil=True, error_model="numpy", fastmath=_FAST)


def compile_exact_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel whose numbers must be those of Python."""
    return _compiled(function)


def cache_other_kernels() -> None:
    """Have numba cache other packages' kernels in wcsim's folder.

    Else it raises RuntimeError where neither their own folder nor the user's home can be written.
    """
    config = cast(Any, numba.config)
    if not config.CACHE_DIR:
        config.CACHE_DIR = str(find_cache_folder() / KERNELS)


def _compiled(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    compiled: Any = numba.njit(**options)(function)
    # Not jitted where numba's user has turned compilation off.
    if is_jitted(compiled):
        # No folder can be written: "cannot cache function: no locator available".
        with suppress(RuntimeError):
            compiled._cache = _FrozenCache(compiled)  # type: ignore[attr-defined]
    return cast("Callable[P, R]", compiled)


class _UserLocator(UserWideCacheLocator):
    """The place for a package that cannot be written: in wcsim's cache, which needs no home."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        """As numba makes it."""
        super().__init__(py_func, py_file)  # type: ignore[no-untyped-call]
        self._cache_path = str(find_cache_folder() / KERNELS / py_func.__module__)


class _Copies(CompileResultCacheImpl):
    """Where copies may lie, the best place first; what `cache_other_kernels` sets is for others."""

    _locator_classes = [  # noqa: RUF012 - numba's own form
        _UserLocator if kind is UserWideCacheLocator else kind
        for kind in CompileResultCacheImpl._locator_classes
        if kind is not UserProvidedCacheLocator
    ]


class _FrozenCache(FunctionCache):
    """The copies on disk of one kernel, found by `_frozen_digest`."""

    _impl_class = _Copies

    def __init__(self, compiled: Any) -> None:
        """Find a folder; raises RuntimeError when there is none that can be written."""
        super().__init__(compiled.py_func)  # type: ignore[no-untyped-call]
        self._compiled = compiled
        # Without the kernel's line, which may move.
        self._stem = self._impl.filename_base.rpartition("-")[0]
        # For all checkouts, known from the first call on.
        self._shared_folder: Path | None = None
        self._cache_file: Any
        self._shared: Any
        # A caller's lock is taken before those of its callees, never the other way: so no two
        # processes wait for each other.
        self._lock = FileLock(Path(self._cache_path) / f"{self._stem}.lock")
        self._owner = os.getpid()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code for a signature; None where this process is to compile it.

        Then it holds the lock until it has.
        """
        self._name_file()
        found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None and self._acquire_lock():
            # Another process may have compiled it meanwhile, or another checkout before.
            key = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
            data = None if self._cache_file.load(key) else self._shared.load(key)
            if data is not None:
                self._cache_file.save(key, data)
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            if found is not None:
                self._lock.release(force=True)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code for a signature, and remove old copies."""
        self._name_file()
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
            _remove_old_copies(Path(self._cache_path), self._stem)
            self._share(self._index_key(sig, data.codegen))  # type: ignore[no-untyped-call]
        finally:
            self._lock.release(force=True)

    def _share(self, key: object) -> None:
        """Store the copy for other checkouts too, where their place can be written."""
        folder = self._shared_folder
        if folder is None or folder == Path(self._cache_path):
            return
        with suppress(OSError, Timeout, NotImplementedError):
            folder.mkdir(parents=True, exist_ok=True)
            # Two writers of one index would give two signatures the same file.
            with FileLock(folder / f"{self._stem}.lock", timeout=1.0):
                self._shared.save(key, self._cache_file.load(key))
                _remove_old_copies(folder, self._stem)

    def _acquire_lock(self) -> bool:
        """Wait for the lock; False where there is none: then each process compiles for itself."""
        # After a fork the lock is the parent's, and refuses to be acquired.
        if self._owner != os.getpid():
            self._lock = FileLock(self._lock.lock_file)
            self._owner = os.getpid()
        self._lock.release(force=True)  # of a compilation that failed
        try:
            self._lock.acquire(timeout=LONGEST_WAIT_S)
        except (Timeout, OSError, NotImplementedError):
            return False
        return True

    def _name_file(self) -> None:
        """Name this kernel's copy by its digest, at its first call."""
        if self._shared_folder is None:
            digest = _frozen_digest(self._compiled)
            name = f"{self._stem}-{digest[:24]}.py{sys.version_info[0]}{sys.version_info[1]}"
            shared = find_cache_folder() / KERNELS / self._compiled.py_func.__module__
            self._cache_file, self._shared = (
                IndexDataCacheFile(str(folder), name, digest)  # type: ignore[no-untyped-call]
                for folder in (self._cache_path, shared)
            )
            self._shared_folder = shared


def _remove_old_copies(folder: Path, stem: str) -> None:
    """Remove all but the newest copies; another process may remove some meanwhile."""
    dated: list[tuple[int, Path]] = []
    for index in folder.glob(f"{stem}-*.nbi"):
        try:
            dated.append((index.stat().st_mtime_ns, index))
        except OSError:
            continue
    for _, index in sorted(dated, reverse=True)[MOST_COPIES:]:
        for path in (index, *folder.glob(f"{index.stem}.*.nbc")):
            path.unlink(missing_ok=True)


def _frozen_digest(compiled: Any) -> str:
    """SHA-256 over a kernel's code and options, and over all that is frozen into it.

    Comments and lines do not count.

    Raises:
        TypeError: It names something of its own package that can be no constant.
    """
    digest = hashlib.sha256(f"numpy {np.__version__}".encode())
    for fact in _facts(compiled, compiled.py_func.__module__.partition(".")[0], set()):
        digest.update(f"{fact}\n".encode())
    return digest.hexdigest()


def _facts(value: Any, package: str, seen: set[int]) -> Iterator[object]:
    """A value as objects whose `str` is the same in each process that has the same value."""
    if is_jitted(value):
        options = value.targetoptions.items()
        yield [
            (name, sorted(was) if isinstance(was, set) else was) for name, was in sorted(options)
        ]
        value = value.py_func
        package = value.__module__.partition(".")[0]
    if isinstance(value, FunctionType) and value.__module__.partition(".")[0] == package:
        if id(value) not in seen:
            seen.add(id(value))
            yield from _function_facts(value, package, seen)
    elif isinstance(value, tuple | frozenset):
        yield type(value).__qualname__, getattr(value, "_fields", ())
        for item in value if isinstance(value, tuple) else sorted(value, key=repr):
            yield from _facts(item, package, seen)
    else:
        yield _plain_fact(value, package)


def _plain_fact(value: Any, package: str) -> object:
    """A value that holds no function and no other values but numbers.

    Of something from a library the name stands for it: its code changes with its version alone.
    """
    if isinstance(value, type) and issubclass(value, Enum):
        return value.__qualname__, [
            (name, member.value) for name, member in value.__members__.items()
        ]
    if isinstance(value, type) and hasattr(value, "_fields"):
        return value.__qualname__, value._fields
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.str, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | Enum):
        return type(value).__qualname__, repr(value)
    if isinstance(value, ModuleType):
        # `_function_facts` adds what the kernel takes from it.
        return value.__name__
    home = getattr(value, "__module__", None) or type(value).__module__
    if home.partition(".")[0] == package:
        raise TypeError(
            f"a kernel refers to {value!r}; expected a kernel, a number, an array, a tuple, an "
            "enumeration"
        )
    return f"{home}.{getattr(value, '__qualname__', type(value).__qualname__)}"


def _function_facts(function: FunctionType, package: str, seen: set[int]) -> Iterator[object]:
    known = function.__globals__
    # A copy on disk imports its module by name, so it is of no use once that has moved.
    yield function.__module__
    for code in _codes(function.__code__):
        yield code.co_name, code.co_code.hex(), code.co_names, code.co_varnames, code.co_freevars
        for value in (*code.co_consts, *(known[name] for name in code.co_names if name in known)):
            if value is function.__doc__ or isinstance(value, CodeType):
                continue
            yield from _facts(value, package, seen)
            if isinstance(value, ModuleType):
                yield from _all_facts(
                    (vars(value)[n] for n in code.co_names if n in vars(value)), package, seen
                )
    closed = tuple(cell.cell_contents for cell in function.__closure__ or ())
    yield from _all_facts((function.__defaults__ or (), closed), package, seen)
    # An argument may be a tuple with names: in numba's own key its class counts by name alone.
    words = (
        word for note in function.__annotations__.values() for word in _WORD.findall(str(note))
    )
    yield from _all_facts(
        (known[word] for word in words if hasattr(known.get(word), "_fields")), package, seen
    )


def _all_facts(values: Iterable[Any], package: str, seen: set[int]) -> Iterator[object]:
    for value in values:
        yield from _facts(value, package, seen)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A function's code and that of what it defines inside."""
    yield code
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _codes(inner)

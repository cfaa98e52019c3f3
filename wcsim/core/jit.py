"""Compiles kernels with numba, and keeps the machine code on disk where that is possible.

numba keeps it in `__pycache__` beside the source, or in the user's cache folder when the package is read-only; where
neither can be written it refuses to decorate, and then the code is compiled anew in each process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

# Rounding must not depend on how a loop is vectorised more than it has to: products may be fused, and that is all.
_FAST = {"contract", "nsz"}


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a drawing kernel on its first call: without the GIL, products fused, no errors for divisions by zero."""
    return _compiled(function, nogil=True, error_model="numpy", fastmath=_FAST)


def exact_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel whose numbers must be those that Python would give."""
    return _compiled(function)


def _compiled(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # "cannot cache function: no locator available"
        compiled = numba.njit(**options)(function)
    return cast("Callable[P, R]", compiled)

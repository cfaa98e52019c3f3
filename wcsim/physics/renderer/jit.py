"""Compiles the rasteriser's kernels with numba: without the GIL, and kept on disk where that is possible."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

# Rounding must not depend on how a loop is vectorised more than it has to: products may be fused, and that is all.
_FAST = {"contract", "nsz"}


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call.

    numba keeps the machine code in `__pycache__` beside the source, or in the user's cache folder when the package is
    read-only; where neither can be written it refuses to decorate, and then the code is compiled anew in each process.
    """
    try:
        compiled = numba.njit(nogil=True, error_model="numpy", fastmath=_FAST, cache=True)(function)
    except RuntimeError:  # "cannot cache function: no locator available"
        compiled = numba.njit(nogil=True, error_model="numpy", fastmath=_FAST)(function)
    return cast("Callable[P, R]", compiled)

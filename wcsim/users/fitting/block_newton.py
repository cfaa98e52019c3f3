"""Least of a sum over stretches of time, found by their slopes, and how certain it is by how much they disagree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wcsim.types import F64

_ROUNDS, _HALVINGS, _DONE = 15, 6, 5e-3
_FARTHEST = 25.0  # steps of the derivatives, in one round: these say nothing of what is far off

Summands = Callable[[F64], F64]
"""The summands (B,) at a place (p,): minus the logarithm of a likelihood, stretch by stretch."""


def least(summands: Summands, start: F64, steps: F64) -> F64:
    """The place (p,) where the sum is least, from a `start` near it; `steps` (p,) are those of the derivatives.

    The sum's bend is that of its slopes' spread (Berndt, Hall, Hall and Hausman), which a likelihood has at its top.
    """
    here, value = start.copy(), float(summands(start).sum())
    for _ in range(_ROUNDS):
        slopes = _slopes(summands, here, steps)
        move = -np.linalg.solve(_upright(slopes.T @ slopes), slopes.sum(axis=0))
        move *= min(1.0, _FARTHEST / float(np.abs(move / steps).max()))
        gained = 0.0
        for _ in range(_HALVINGS):
            there = float(summands(here + move).sum())
            if there < value:
                gained = value - there
                here, value = here + move, there
                break
            move *= 0.4
        if gained < _DONE:
            break
    return here


def certainty(summands: Summands, here: F64, steps: F64, together: np.typing.NDArray[np.intp]) -> F64:
    """The covariance (p, p) of the least place, by White's sandwich.

    Args:
        summands: As above.
        here: The least place.
        steps: Of the derivatives.
        together: (B,) numbers of longer stretches, which alone are like strangers to each other.
    """
    slopes = _slopes(summands, here, steps)
    inverse = np.linalg.inv(_upright(_bend(summands, here, steps)))
    count = int(together.max()) + 1
    longer = np.stack([np.bincount(together, column, count) for column in slopes.T], axis=1)
    centred = longer - longer.mean(axis=0)
    return np.asarray(inverse @ (centred.T @ centred) @ inverse * count / max(1, count - 1), np.float64)


def _slopes(summands: Summands, here: F64, steps: F64) -> F64:
    """(B, p)."""
    sides = [(summands(here + step) - summands(here - step)) / (2.0 * step.sum()) for step in np.diag(steps)]
    return np.stack(sides, axis=1)


def _bend(summands: Summands, here: F64, steps: F64) -> F64:
    """(p, p) second derivatives of the sum."""
    jumps, middle = np.diag(steps), float(summands(here).sum())
    ahead = np.array([float(summands(here + jump).sum()) for jump in jumps])
    back = np.array([float(summands(here - jump).sum()) for jump in jumps])
    bend = np.diag((ahead - 2.0 * middle + back) / steps**2)
    for i in range(len(steps)):
        for k in range(i):
            both = float(summands(here + jumps[i] + jumps[k]).sum())
            neither = float(summands(here - jumps[i] - jumps[k]).sum())
            alone = ahead[i] + ahead[k] + back[i] + back[k] - 2.0 * middle
            bend[i, k] = bend[k, i] = (both + neither - alone) / (2.0 * steps[i] * steps[k])
    return np.asarray(bend, np.float64)


def _upright(bend: F64) -> F64:
    """The same, bent upwards in every direction."""
    scale = np.sqrt(np.maximum(np.abs(np.diag(bend)), 1e-12))
    values, vectors = np.linalg.eigh(bend / np.outer(scale, scale))
    lifted = vectors * np.maximum(np.abs(values), 1e-4) @ vectors.T
    return np.asarray(lifted * np.outer(scale, scale), np.float64)

"""Properties of a generated town that the seed does not choose, and their limits."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.errors import TownError

KINDS = ("grid", "spider", "random")
SIZES_M = (300.0, 1500.0)
MOST_SEED = 2**31 - 1  # SUMO takes no larger one
HIGHEST_M = 200.0
MOST_TRAFFIC = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """Properties of a generated town that the seed does not choose."""

    size_m: float = 700.0  # about, from edge to edge
    kind: str = ""  # of the streets, one of KINDS; "": the seed's choice
    split: str = "train"  # or "test"
    traffic: float = 1.0  # how dense, against `demand.MIX`; 0: none
    parked: float = 0.7  # share of the parking spaces that is taken
    hill_m: float | None = None  # height of its land; None: the seed's choice


def check_wishes(seed: int, wishes: Wishes) -> None:
    """Raise TownError for a seed that is none, or a property out of its limits."""
    if not 0 <= seed <= MOST_SEED:
        raise TownError(f"seed {seed}; expected 0 to {MOST_SEED}")
    if not SIZES_M[0] <= wishes.size_m <= SIZES_M[1]:
        raise TownError(f"a size of {wishes.size_m:g} m; expected {SIZES_M[0]:g} to {SIZES_M[1]:g} m from edge to edge")
    if wishes.kind not in ("", *KINDS):
        raise TownError(f"unknown kind {wishes.kind!r} of streets; expected one of: {', '.join(KINDS)}")
    if not 0.0 <= wishes.traffic <= MOST_TRAFFIC or not 0.0 <= wishes.parked <= 1.0:
        raise TownError(
            f"traffic {wishes.traffic:g}, parked {wishes.parked:g}; expected 0 to {MOST_TRAFFIC:g}, and 0 to 1"
        )
    if wishes.hill_m is not None and not 0.0 <= wishes.hill_m <= HIGHEST_M:
        raise TownError(f"a hill of {wishes.hill_m:g} m is not possible; expected 0 to {HIGHEST_M:g} m")

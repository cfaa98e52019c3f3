"""Compare two traces: exactly where versions agree, within tolerances elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wcsim.bridge.trace import TickRecord, read_trace


def difference(trace: Path, golden: Path) -> str:
    """The first difference between two traces, "" when they agree.

    Hashes are compared exactly when both were made by the same versions; otherwise positions, to 1 mm over the first
    second and 5 cm later, because contacts amplify the last bit.
    """
    (head, ticks), (golden_head, golden_ticks) = read_trace(trace), read_trace(golden)
    exact = head.fingerprint == golden_head.fingerprint
    if len(ticks) != len(golden_ticks):
        return f"{len(ticks)} ticks, golden {len(golden_ticks)}"
    for new, old in zip(ticks, golden_ticks, strict=True):
        told = _tick_difference(new, old, exact, 0.001 if new.tick * head.tick_s <= 1.0 else 0.05)
        if told:
            return f"tick {new.tick}: {told}"
    return ""


def _tick_difference(new: TickRecord, old: TickRecord, exact: bool, tolerance_m: float) -> str:
    if exact and new.state_hash == old.state_hash:
        return ""
    if new.actor_ids != old.actor_ids:
        return f"actors {sorted(set(new.actor_ids) ^ set(old.actor_ids))[:4]} are in one trace only"
    for name, a, b in zip(new.actor_ids, new.actors, old.actors, strict=True):
        if np.abs(a[:3] - b[:3]).max() > (0.0 if exact else tolerance_m):
            return f"actor {name} is {np.abs(a[:3] - b[:3]).max():.3g} m away from the golden trace"
    gap_m = float(np.abs(new.plants[:, :3] - old.plants[:, :3]).max(initial=0.0))
    if gap_m > (0.0 if exact else tolerance_m):
        return f"a chair is {gap_m:.3g} m away from the golden trace"
    return "the state hash differs" if exact else ""

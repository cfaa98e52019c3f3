"""Tables in Markdown of what the parts have made: rows of the suites, and three networks taken together."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from tools.results.parts import SEEDS
from wcsim.agents.evaluation.intervals import garwood
from wcsim.agents.evaluation.suite.result_files import read_episodes
from wcsim.core import seeding

DRAWS: Final = 4000
COLUMNS: Final = (
    "part", "policy", "episodes, km", "own", "others", "within", "m/s", "arrivals", "at red", "needless",
    "warned 1 s ahead", "score (95 %)",
)  # fmt: skip
Counts = npt.NDArray[np.float64]


def page(out: Path) -> str:
    """All tables of a folder of results."""
    found = []
    for path in sorted((out / "tables").glob("*.json")):
        result = json.loads(path.read_text(encoding="utf-8"))
        said = f"{result['suite']}-{result['set']}, list `{result['list_sha256'][:12]}`"
        found.append(f"### {path.stem} ({said})\n\n" + suite_table(result, out))
    judged = out / "judged" / "v1"
    runs = [name for name in (f"laptop-{seed}" for seed in SEEDS) if (out / name).is_dir()]
    if (judged / "episodes.json").is_file() and runs:
        found.append(pooled_text(judged, [str(out / name) for name in runs]))
    return "\n".join(found)


def suite_table(result: Mapping[str, Any], out: Path) -> str:
    """The rows of a test, and those of all parts together."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for row in [*result["rows"], *result["pooled"]]:
        low, high = row["score_ci"] or (float("nan"), float("nan"))
        cells = (
            row.get("part") or "all",
            row["policy"].removeprefix(f"{out}/"),
            f"{row['episodes']}, {row['km']:.2f}",
            f"{row['crashes_own']}",
            f"{row['crashes_other']}",
            share(row["kpi1_free_within"]),
            f"{row['speed_mps'] or 0.0:.2f}",
            f"{row['arrivals']}",
            f"{row['red_entries']}",
            f"{row['needless']}",
            share(row["warned_share"]),
            f"{row['score'] or 0.0:.3f} ({low:.2f} to {high:.2f})",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def share(value: float | None) -> str:
    """A share in per cent, - for none."""
    return "-" if value is None else f"{100.0 * value:.1f} %"


def pooled_text(judged: Path, runs: Sequence[str]) -> str:
    """Own crashes a kilometre of several networks together, between the blinded oracle (0) and the user alone (1)."""
    episodes = {
        name: np.array([[item.record.own, item.record.m / 1000.0] for item in items], np.float64)
        for name, items in read_episodes(judged).items()
    }
    missing = [name for name in ("follow", "oracle-visible", "dwa", *runs) if name not in episodes]
    if missing:
        return f"{judged}: no rows of {', '.join(missing)}; run the parts before\n"
    nets = [episodes[run] for run in runs]
    value, low, high = left_of(nets, episodes["follow"], episodes["oracle-visible"])
    own, km = sum(float(net[:, 0].sum()) for net in nets), sum(float(net[:, 1].sum()) for net in nets)
    few, many = (bound / km for bound in garwood(round(own)))
    rival = episodes["dwa"].sum(0)
    return (
        f"{len(runs)} networks: {own:.0f} own crashes in {km:.2f} km, {own / km:.2f} per km ({few:.2f} to {many:.2f}); "
        f"dwa {rival[0]:.0f} in {rival[1]:.2f}, {rival[0] / rival[1]:.2f} per km.\n"
        "(network - blinded oracle) / (follow - blinded oracle): "
        f"{value:.3f} ({low:.3f} to {high:.3f}, bootstrap over episodes)\n"
    )


def left_of(nets: Sequence[Counts], follow: Counts, oracle: Counts) -> tuple[float, float, float]:
    """What is left of the user's crashes above the oracle's, with its 95 % interval by drawing episodes anew.

    Args:
        nets: (N, 2) own crashes and km of the same N episodes, a network each.
        follow: (N, 2) of the user alone.
        oracle: (N, 2) of the blinded oracle.
    """
    together = np.sum(nets, axis=0)

    def left(picks: npt.NDArray[np.int64]) -> Counts:
        rates = [counts[picks].sum(-2) for counts in (together, follow, oracle)]
        net, user, best = (rate[..., 0] / np.maximum(rate[..., 1], 1e-9) for rate in rates)
        ratio: Counts = (net - best) / np.maximum(user - best, 1e-9)
        return ratio

    count = len(follow)
    drawn = seeding.generator(0, "bootstrap", count).integers(0, count, (DRAWS, count))
    low, high = np.percentile(left(drawn), (2.5, 97.5)).tolist()
    return float(left(np.arange(count))), float(low), float(high)


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))

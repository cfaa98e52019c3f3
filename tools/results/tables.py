"""Results of the parts as Markdown tables: rows of the suites, and three networks pooled."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from tools.results.compared import BLINDED, RIVAL, USER, compared_text
from tools.results.parts import AT_0_MS, SEEDS, judged
from wcsim.agents.evaluation.suite.result_files import read_result

COLUMNS: Final = (
    "part", "policy", "episodes, km", "own crashes", "own crashes per km (95 %)", "crashes caused by others",
    "close to user", "freezes", "arrivals", "entries at red", "m/s", "needed, unneeded interventions",
    "missed crashes", "warned 1 s ahead", "false warnings per km", "score (95 %)",
)  # fmt: skip


def page(out: Path) -> str:
    """All tables of a folder of results."""
    found = []
    for path in sorted((out / "tables").glob("*.json")):
        result = json.loads(path.read_text(encoding="utf-8"))
        said = f"{result['suite']}-{result['set']}, list `{result['list_sha256'][:12]}`"
        found.append(f"### {path.stem} ({said})\n\n" + suite_table(result, out))
    v1 = out / "judged" / "v1"
    runs = [name for name in (f"laptop-{seed}" for seed in SEEDS) if (out / name).is_dir()]
    if (v1 / "episodes.json").is_file() and runs:
        found.append(pooled_text(v1, [str(out / name) for name in runs]))
    found.append(delay_text(out, runs))
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
            rate(row),
            f"{row['crashes_other']}",
            share(row["kpi1_free_within"]),
            f"{row['freezes']}",
            f"{row['arrivals']}",
            f"{row['red_entries']}",
            f"{row['speed_mps'] or 0.0:.2f}",
            f"{row['needed']}, {row['needless']}",
            f"{row['missed']}",
            share(row["warned_share"]),
            "-" if row["false_warnings_per_km"] is None else f"{row['false_warnings_per_km']:.0f}",
            f"{row['score'] or 0.0:.3f} ({low:.2f} to {high:.2f})",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def rate(row: Mapping[str, Any]) -> str:
    """Own crashes per kilometre with their interval, - for a very short distance."""
    if row["crashes_per_km"] is None:
        return "-"
    low, high = row["crashes_per_km_ci"]
    return f"{row['crashes_per_km']:.2f} ({low:.2f} to {high:.2f})"


def share(value: float | None) -> str:
    """A share in per cent, - for none."""
    return "-" if value is None else f"{100.0 * value:.1f} %"


def pooled_text(folder: Path, runs: Sequence[str]) -> str:
    """Networks of several seeds, pooled, against the baselines; or a line on missing results."""
    result = read_result(folder)
    missing = [name for name in (USER, BLINDED, RIVAL, *runs) if name not in result.episodes]
    if missing:
        return f"{folder}: has no rows of {', '.join(missing)}; run the parts that make them (--list)\n"
    return compared_text(result, runs)


def delay_text(out: Path, runs: Sequence[str]) -> str:
    """Scores on `dev` with and without delay, one row a network; "" until both are driven."""
    both = [judged(out, "dev", tuple(runs), settings=settings).makes for settings in ((), (AT_0_MS,))]
    if not all(path.is_file() for path in both):
        return ""
    late, prompt = (_scores(path) for path in both)
    lines = ["| network | score with delay | without delay | ratio |", "|---|---|---|---|"]
    for name in runs:
        with_it, without = (scores[str(out / name)] for scores in (late, prompt))
        lines.append(f"| {name} | {with_it:.3f} | {without:.3f} | {100.0 * with_it / without:.0f} % |")
    return "\n".join([*lines, ""])


def _scores(path: Path) -> dict[str, float]:
    pooled = json.loads(path.read_text(encoding="utf-8"))["pooled"]
    return {row["policy"]: row["score"] or 0.0 for row in pooled}


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))

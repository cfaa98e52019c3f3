"""Results of the parts as Markdown tables: rows of the suites, and what a delay costs."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.pages import table
from tools.results.parts import AT_0_MS, SEEDS, judged
from wcsim.agents.evaluation.suite.rows import LOOK, Column, ResultRow


def page(out: Path) -> str:
    """All tables of a folder of results."""
    found = []
    for path in sorted((out / "tables").glob("*.json")):
        result = json.loads(path.read_text(encoding="utf-8"))
        said = f"{result['suite']}-{result['set']}, list `{result['list_sha256'][:12]}`"
        found.append(f"### {path.stem} ({said})\n\n" + suite_table(result, out))
    runs = [name for name in (f"laptop-{seed}" for seed in SEEDS) if (out / name).is_dir()]
    found.append(delay_text(out, runs))
    return "\n".join(found)


def suite_table(result: Mapping[str, Any], out: Path) -> str:
    """The rows of a test, and those of all parts together, with the columns of the console."""
    rows = [ResultRow(**row) for row in [*result["rows"], *result["pooled"]]]
    cells = [
        (row.part or "all", row.policy.removeprefix(f"{out}/"), *(_cell(row, column) for column in LOOK))
        for row in rows
    ]
    return "\n".join([*table(("part", "policy", *(column.heading for column in LOOK)), cells), ""])


def _cell(row: ResultRow, column: Column) -> str:
    """A figure, with its interval where it has one; - where nothing was measured."""
    figure, ends = column.texts(row)
    return f"{figure} ({ends})" if ends else figure or "-"


def delay_text(out: Path, runs: Sequence[str]) -> str:
    """Scores on `dev2` with and without delay, one row a network; "" until both are driven."""
    both = [judged(out, tuple(runs), settings=settings).makes for settings in ((), (AT_0_MS,))]
    if not all(path.is_file() for path in both):
        return ""
    results = [json.loads(path.read_text(encoding="utf-8")) for path in both]
    late, prompt = ({row["policy"]: row["score"] or 0.0 for row in result["pooled"]} for result in results)
    pairs = {name: (late[str(out / name)], prompt[str(out / name)]) for name in runs}
    rows = [(name, f"{one:.3f}", f"{two:.3f}", f"{100.0 * one / two:.0f} %") for name, (one, two) in pairs.items()]
    return "\n".join([*table(("network", "score with delay", "without delay", "ratio"), rows), ""])


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))

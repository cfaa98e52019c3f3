"""Results of the parts as Markdown tables: rows of the suites."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tools.pages import table
from wcsim.agents.evaluation.suite.rows import LOOK, Column, ResultRow


def page(out: Path) -> str:
    """All tables of a folder of results."""
    found = []
    for path in sorted((out / "tables").glob("*.json")):
        result = json.loads(path.read_text(encoding="utf-8"))
        said = f"{result['suite']}-{result['set']}, list `{result['list_sha256'][:12]}`"
        found.append(f"### {path.stem} ({said})\n\n" + suite_table(result, out))
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


if __name__ == "__main__":
    sys.stdout.write(page(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))

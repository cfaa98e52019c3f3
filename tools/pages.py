"""Write the pages of `docs/` that are made from the code: `python -m tools.pages`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
MADE: Final = ("api", "commands", "overrides", "settings")


def main() -> None:
    """Write each page that `tools/NAME_page.py` makes."""
    for name in MADE:
        (ROOT / "docs" / f"{name}.md").write_text(import_module(f"tools.{name}_page").page(), encoding="utf-8")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


if __name__ == "__main__":
    main()

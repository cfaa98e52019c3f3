"""The page of commands is made from the code."""

from __future__ import annotations

import runpy
from pathlib import Path

from wcsim.cli.main import SUBCOMMANDS

ROOT = Path(__file__).parents[3]


def test_the_page_is_that_of_the_commands(monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    made = runpy.run_path(str(ROOT / "tools" / "commands_page.py"))["page"]()
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert made == page, "make it again: python tools/commands_page.py > docs/commands.md"
    assert all(f"### wcsim {item.name}" in page for item in SUBCOMMANDS)
    assert {"### wcsim town import", "### wcsim scene bless", "### wcsim users fit"} <= {*page.splitlines()}

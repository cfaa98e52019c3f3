"""The page of names that users may rely on is made from the code."""

from __future__ import annotations

import runpy
from pathlib import Path

import wcsim
import wcsim.errors

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")


def test_the_page_is_that_of_the_code():
    made = runpy.run_path(str(ROOT / "tools" / "api_page.py"))["page"]()
    assert made == PAGE, "make it again: python tools/api_page.py > docs/api.md"


def test_every_name_has_a_line_that_says_what_it_is():
    rows = [line.split(" | ") for line in PAGE.splitlines() if line.startswith("| `")]
    assert len(rows) > 100
    assert [row for row in rows if len(row) != 2 or len(row[1].rstrip(" |")) < 5] == []


def test_the_page_names_the_environments_their_options_and_every_error():
    errors = {name for name, kind in vars(wcsim.errors).items() if isinstance(kind, type)}
    for name in (*wcsim.__all__, *errors, "reward_terms", "join", "wcsim.agents.policy_api.Policy", "SeatSpec"):
        assert f"| `{name}` |" in PAGE, name

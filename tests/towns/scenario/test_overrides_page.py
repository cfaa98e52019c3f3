from __future__ import annotations

import runpy
from pathlib import Path

from wcsim.towns.scenario.options import sumo_options
from wcsim.towns.scenario.overrides import RULES

ROOT = Path(__file__).resolve().parents[3]


def test_the_guide_holds_the_table_that_the_code_goes_by() -> None:
    made = runpy.run_path(str(ROOT / "tools" / "overrides_page.py"))["page"]()
    assert (ROOT / "docs" / "overrides.md").read_text(encoding="utf-8") == made


def test_every_rule_is_about_an_option_that_sumo_has() -> None:
    assert {rule.option for rule in RULES} <= set(sumo_options())

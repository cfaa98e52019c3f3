from __future__ import annotations

from pathlib import Path

from wcsim.towns.scenario.options import sumo_options
from wcsim.towns.scenario.overrides import RULES, overrides_markdown

PAGE = Path(__file__).resolve().parents[3] / "docs" / "overrides.md"


def test_the_guide_holds_the_table_that_the_code_goes_by() -> None:
    assert PAGE.read_text(encoding="utf-8") == overrides_markdown()


def test_every_rule_is_about_an_option_that_sumo_has() -> None:
    assert {rule.option for rule in RULES} <= set(sumo_options())

"""The pages that are made from the code are those of the code, and name all that they are to name."""

from importlib import import_module

import pytest

import wcsim
import wcsim.errors
from tools.pages import MADE, ROOT
from wcsim.cli.main import SUBCOMMANDS

TEXTS = {name: (ROOT / "docs" / f"{name}.md").read_text() for name in MADE}


@pytest.mark.parametrize("name", MADE)
def test_a_page_is_that_of_the_code(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")  # which a page of help sets, and which comes back afterwards
    assert import_module(f"tools.{name}_page").page() == TEXTS[name], "make it again: python -m tools.pages"


def test_every_command_has_its_help():
    assert all(f"### wcsim {item.name}" in TEXTS["commands"] for item in SUBCOMMANDS)
    assert {"### wcsim town import", "### wcsim scene bless", "### wcsim users fit"} <= {
        *TEXTS["commands"].splitlines()
    }


def test_every_name_has_a_line_that_says_what_it_is():
    rows = [line.split(" | ") for line in TEXTS["api"].splitlines() if line.startswith("| `")]
    assert len(rows) > 100
    assert [row for row in rows if len(row) != 2 or len(row[1].rstrip(" |")) < 5] == []


def test_the_page_names_the_environments_their_options_and_every_error():
    errors = {name for name, kind in vars(wcsim.errors).items() if isinstance(kind, type)}
    for name in (*wcsim.__all__, *errors, "reward_terms", "join", "wcsim.agents.policy_api.Policy", "SeatSpec"):
        assert f"| `{name}` |" in TEXTS["api"], name

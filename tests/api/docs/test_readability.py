"""Pages are short, and so are their sentences."""

from pathlib import Path

import pytest

from tools import readability

ROOT = readability.ROOT
MOST_WORDS = {"README.md": 700, "CONTRIBUTING.md": 800, "CHANGELOG.md": 600, "docs/results.md": 1_500}
MOST_LINES = {"AGENTS.md": 60}


@pytest.mark.parametrize("page", readability.pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_sentences_are_short(page: Path) -> None:
    text = page.read_text()
    assert [(count, said) for count, said in readability.lengths(text) if count > readability.LONGEST] == []
    assert readability.row(page)[2] < readability.MEAN


def test_pages_are_short() -> None:
    assert {name: n for name in MOST_WORDS if (n := readability.row(ROOT / name)[0]) > MOST_WORDS[name]} == {}
    lines = {name: len((ROOT / name).read_text().splitlines()) for name in MOST_LINES}
    assert {name: n for name, n in lines.items() if n > MOST_LINES[name]} == {}


def test_sentences_are_told_apart_and_code_tables_and_headings_left_out() -> None:
    prose = "# Head. Line\n\nOne two. `a.b` three [four five](x.md). Six, e.g. this\nseven?\n\n- Eight\n- Nine ten\n"
    assert readability.lengths(f"{prose}\n| a. b |\n\n```\nNo. no\n```\n") == [
        (2, "One two."),
        (4, "CODE three four five."),
        (4, "Six, e.g this seven?"),
        (1, "Eight"),
        (2, "Nine ten"),
    ]

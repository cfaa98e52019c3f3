"""Attacks on journals, ledgers, metrics and events."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.attack.files import journals
from tests.attack.outcomes import Tally

OTHERS = ("ledgers", "metrics", "events")


def test_no_record_of_a_journal_is_lost_without_a_word(memory: Path) -> None:
    tally = Tally().run(journals.cases(300, 1, memory))
    assert tally.defects == []
    assert tally.total == 300


def test_no_entry_or_line_is_lost_without_a_word(memory: Path) -> None:
    tally = Tally().run(journals.cases(300, 1, memory, OTHERS))
    assert tally.defects == []


@pytest.mark.proof
def test_no_record_of_a_journal_is_lost_without_a_word_many(memory: Path) -> None:
    tally = Tally().run(journals.cases(20_000, 2, memory))
    sys.stdout.write(f"\n{tally.table()}\n")
    assert tally.defects == []


@pytest.mark.proof
def test_no_entry_or_line_is_lost_without_a_word_many(memory: Path) -> None:
    tally = Tally().run(journals.cases(5_000, 2, memory, OTHERS))
    sys.stdout.write(f"\n{tally.table()}\n")
    assert tally.defects == []

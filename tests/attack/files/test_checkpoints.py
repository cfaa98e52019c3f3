"""Attacks on checkpoints."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.attack.files import checkpoints
from tests.attack.outcomes import Tally


def test_no_damaged_checkpoint_is_learned_on_with(memory: Path) -> None:
    tally = Tally().run(checkpoints.cases(250, 1, memory))
    assert tally.defects == []
    assert tally.total == 250


@pytest.mark.proof
def test_no_damaged_checkpoint_is_learned_on_with_many(memory: Path) -> None:
    tally = Tally().run(checkpoints.cases(5000, 2, memory))
    sys.stdout.write(f"\n{tally.table()}\n")
    assert tally.defects == []

"""Every family of the table: whatever comes, one of wcsim's own errors, or something that makes the same again."""

import sys
from functools import partial
from pathlib import Path

import pytest

from tests.attack.files.family import laid
from tests.attack.outcomes import Outcome, Tally
from tests.attack.table import EACH, TABLE, Row

ROWS = pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
OF_FILES = [row for row in TABLE if isinstance(row.cases, partial)]


def attacked(row: Row, count: int, seed: int, work: Path) -> Tally:
    tally = Tally().run(row.cases(count, seed, work))
    sys.stdout.write(f"\n{tally.table()}\n")
    assert tally.defects == [], "\n".join(tally.defects[:5])
    assert (tally.total, (work / "case").exists()) == (count, False)
    return tally


@ROWS
def test_a_sample(row: Row, memory: Path) -> None:
    tally = attacked(row, row.sample, 1, memory)
    assert sum(count for (_, outcome), count in tally.counts.items() if outcome is Outcome.HARMLESS) > 0


@pytest.mark.proof
@ROWS
def test_all(row: Row, memory: Path) -> None:
    tally = attacked(row, row.whole, 2, memory)
    areas = {area for area, _ in tally.counts}
    assert row not in OF_FILES or all(sum(tally.counts[area, how] for how in Outcome) >= EACH for area in areas)


@pytest.mark.parametrize("row", OF_FILES, ids=lambda row: row.name)
def test_the_sound_files_are_taken(row: Row, memory: Path) -> None:
    assert isinstance(row.cases, partial)
    for kind in row.cases.args[0](memory):
        assert laid(kind, memory / "case", lambda path, kind=kind: path.write_bytes(kind.sound)), kind.name


def test_a_number_is_always_the_same_case(memory: Path) -> None:
    one, other = ([case.name for case in OF_FILES[0].cases(50, 3, memory)] for _ in range(2))
    assert one == other

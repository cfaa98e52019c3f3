"""Whatever lies where a file should be: one of wcsim's own errors, or something that makes the same file again."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attack.files import files
from tests.attack.outcomes import Tally

SAMPLE, ALL = 600, 25_000


def test_the_sound_files_are_taken(tmp_path: Path) -> None:
    for kind in files.families(tmp_path):
        for name, data in (*kind.beside, (kind.file, kind.sound)):
            (tmp_path / name).write_bytes(data)
        assert kind.take(tmp_path / kind.file), kind.name


def test_a_sample_of_hostile_files(tmp_path: Path) -> None:
    tally = Tally().run(files.cases(SAMPLE, 1, tmp_path))
    assert tally.defects == []
    assert not list(tmp_path.iterdir())


def test_a_number_is_always_the_same_case(tmp_path: Path) -> None:
    one, other = ([case.name for case in files.cases(50, 3, tmp_path)] for _ in range(2))
    assert one == other


@pytest.mark.proof
def test_all_hostile_files(tmp_path: Path) -> None:
    tally = Tally().run(files.cases(ALL, 2, tmp_path))
    print(tally.table())  # noqa: T201
    assert tally.defects == []

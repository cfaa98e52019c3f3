"""A policy from somebody else: one of wcsim's own errors, or exactly the weights that the file holds."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attack.files import policies
from tests.attack.outcomes import Tally

SAMPLE, ALL = 250, 6_000


def test_the_sound_policy_is_taken(tmp_path: Path) -> None:
    sound = [case for case in policies.cases(80, 1, tmp_path) if case.name.endswith(": sound")]
    assert sound and all(case.feed() is True for case in sound)


def test_a_sample_of_hostile_policies(tmp_path: Path) -> None:
    tally = Tally().run(policies.cases(SAMPLE, 1, tmp_path))
    assert tally.defects == []
    assert not list(tmp_path.iterdir())


@pytest.mark.proof
def test_all_hostile_policies(tmp_path: Path) -> None:
    tally = Tally().run(policies.cases(ALL, 2, tmp_path))
    print(tally.table())  # noqa: T201
    assert tally.defects == []

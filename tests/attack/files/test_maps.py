"""No map, net, terrain or description of a town makes wcsim fail, hang, or take what it cannot be."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.attack.files.maps import cases
from tests.attack.outcomes import Outcome, Tally

SEED = 21


def attacked(tally: Tally) -> None:
    sys.stdout.write(f"\n{tally.table()}\n")
    assert tally.defects == [], "\n".join(tally.defects[:5])


def test_a_sample_of_maps(tmp_path: Path) -> None:
    tally = Tally().run(cases(400, SEED, tmp_path))
    attacked(tally)
    assert sum(count for (_, outcome), count in tally.counts.items() if outcome is Outcome.HARMLESS) > 30
    assert len({area for area, _ in tally.counts}) == 10
    assert not list(tmp_path.iterdir())


@pytest.mark.proof
@pytest.mark.timeout(900)
def test_eight_thousand_maps(tmp_path: Path) -> None:
    attacked(Tally().run(cases(8_000, SEED + 1, tmp_path)))

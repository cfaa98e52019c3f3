"""The last moment at which a crash could be survived: found in copies of the world, the same each time."""

from dataclasses import replace

import pytest

from wcsim.agents.evaluation.suite import alarms
from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.evaluation.suite.make import SETTINGS, scene_block
from wcsim.agents.evaluation.suite.run import drive_piece
from wcsim.types import Joystick

# Cells of the user alone, and the forks' answer: a door opens too near to brake, and a kerb behind the chair.
CELLS = [("car-door-near", 700, 0.9), ("reversing-off-kerb-near", 700, 0.9)]


@pytest.fixture(autouse=True)
def own_cache() -> None:
    """None: these scenes are those of every run."""


def piece_of(family: str, seed: int) -> Piece:
    return Piece(index=0, block=scene_block(family, seed), policy="follow", settings=SETTINGS, judged=True)


@pytest.mark.parametrize("family, seed, last_s", CELLS)
def test_a_crash_has_a_last_moment_the_same_each_time(family, seed, last_s):
    piece = piece_of(family, seed)
    (record,) = drive_piece(piece)
    assert record.own and record.last_moment_s == last_s
    assert drive_piece(piece) == (record,)
    # Without forks there is no answer, and nothing else is another.
    assert drive_piece(replace(piece, judged=False)) == (replace(record, last_moment_s=None, judged=False),)


def test_what_no_stick_saves_is_not_survivable(monkeypatch):
    monkeypatch.setattr(alarms, "STICKS", (Joystick(0.0, -1.0),))
    (record,) = drive_piece(piece_of("reversing-off-kerb-near", 700))
    assert record.own and record.last_moment_s is None

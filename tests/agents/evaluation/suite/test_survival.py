"""Generated scenes in a list, and the last moment at which a crash could be survived: the same each time."""

from dataclasses import replace

import pytest

from wcsim.agents.evaluation.suite import alarms
from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.evaluation.suite.make import SETTINGS, scene_block
from wcsim.agents.evaluation.suite.run import drive_piece
from wcsim.errors import TownError
from wcsim.types import Joystick


@pytest.fixture(autouse=True)
def own_cache() -> None:
    """None: these scenes are those of every run."""


def piece_of(family: str, seed: int = 700) -> Piece:
    return Piece(index=0, block=scene_block(family, seed), policy="follow", settings=SETTINGS, judged=True)


def test_a_crash_has_a_last_moment_the_same_each_time():
    """A door opens too near to brake."""
    piece = piece_of("car-door-near")
    (record,) = drive_piece(piece)
    assert (
        record.own and record.missed and record.score == 0.0 and (record.last_moment_s, record.cause) == (0.9, "missed")
    )
    assert drive_piece(piece) == (record,)
    # Without forks there is no answer, and nothing else is another.
    assert drive_piece(replace(piece, judged=False)) == (replace(record, last_moment_s=None, cause="", judged=False),)


@pytest.mark.parametrize(
    "family, seed, policy, cause",
    [
        ("overtaking-rider", 1, "dwa", "unseen"),
        ("scooter-cuts-in-near", 1118629420, "dwa", "late"),
        ("scooter-cuts-in-near", 2075844307, "dwa", "in_vain"),
        ("footplate-swing-near", 1645858598, "dwa", "given_back"),
    ],
)
def test_a_crash_has_a_cause(family, seed, policy, cause):
    (record,) = drive_piece(replace(piece_of(family, seed), policy=policy))
    assert record.status == "chair_crashed" and record.cause == cause


def test_what_no_stick_saves_is_not_survivable_though_who_stands_comes_through(monkeypatch):
    monkeypatch.setattr(alarms, "STICKS", (Joystick(0.0, -1.0),))
    piece = piece_of("reversing-off-kerb-near")
    (record,), (held,) = (drive_piece(replace(piece, policy=name)) for name in ("follow", "zero"))
    assert record.own and record.last_moment_s is None
    assert held.status == "timed_out" and held.interventions[0].verdict == "needed"


def test_a_scene_that_is_another_than_the_lists_is_refused():
    piece = piece_of("car-door")
    with pytest.raises(TownError, match="another version"):
        drive_piece(replace(piece, block=piece.block.model_copy(update={"scene_sha256": "0" * 64})))

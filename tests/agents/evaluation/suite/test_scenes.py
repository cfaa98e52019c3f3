"""Generated scenes as blocks of a list, driven like any other."""

import pytest

from tests.agents.evaluation.suite.lists import Held, config
from wcsim.agents.evaluation.suite.drive import Piece, drive_block
from wcsim.agents.evaluation.suite.make import scene_block
from wcsim.agents.opening.list_file import make_block_setup
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.errors import TownError


@pytest.fixture(scope="module")
def block():
    return scene_block("reversing-off-kerb", 3)


def driven(block, work, make):
    place = make_block_setup(block, config(), pytest.fail, work)
    (record,) = drive_block(Piece(index=0, block=block, judged=True), place, make)
    return record


@pytest.mark.proof
def test_the_user_alone_reverses_off_the_kerb_and_who_stands_comes_through(block, tmp_path):
    alone = driven(block, tmp_path / "a", lambda: make_baseline_policy("follow", config()))
    assert alone.part == "scenes" and alone.own and alone.missed and alone.score == 0.0
    held = driven(block, tmp_path / "b", lambda: Held(0.0, 0.0))
    assert held.status == "timed_out" and not held.own
    assert any(item.verdict == "needed" for item in held.interventions)


def test_a_scene_that_is_another_than_the_lists_is_refused(block, tmp_path):
    with pytest.raises(TownError, match="another version"):
        make_block_setup(block.model_copy(update={"scene_sha256": "0" * 64}), config(), pytest.fail, tmp_path)

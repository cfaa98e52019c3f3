"""A list and its shifts: what is changed, what is left out, and what a policy loses."""

from dataclasses import replace

import pytest

from tests.agents.evaluation.suite.lists import POINTS, Held, block_of, suite_in
from tests.agents.evaluation.suite.test_records import GOOD
from wcsim.agents.evaluation.suite import shifts
from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.evaluation.suite.records import NEEDLESS, EpisodeRecord, Intervention
from wcsim.agents.evaluation.suite.run import SuiteOrder, drive_piece
from wcsim.agents.evaluation.suite.shifts import AS_LISTED, SHIFTS, drive_shifts
from wcsim.config import resolve
from wcsim.errors import TownError

SAFE = replace(GOOD, part="scenes")
CRASH = replace(SAFE, status="chair_crashed", fault="own", reason="collision", last_moment_s=0.6)
MEDDLED = (Intervention(first=1, last=20, verdict=NEEDLESS, needless_steps=20),)
MEDDLES = replace(SAFE, interventions=MEDDLED)


def order_of(corner, tmp_path, **more):
    return SuiteOrder(suite=suite_in(corner, block_of(corner)), out=tmp_path, **more)


def test_every_shift_changes_one_thing_whatever_is_set(corner, tmp_path, monkeypatch):
    driven = []
    monkeypatch.setattr(shifts, "run_suite", lambda order, *_: driven.append(order) or {})
    own = ("cameras.0.noise.objects=good", "chair.plant=rwd", "world.action_delay_ticks=1")
    drive_shifts(order_of(corner, tmp_path, settings=own), (), lambda _: None)
    of = dict(zip(SHIFTS, driven, strict=True))
    listed = resolve("quick", of[AS_LISTED].settings)
    for name, order in of.items():
        config = resolve("quick", order.settings)
        users = {each.profile for block in order.suite.file.blocks for each in block.episodes}
        changed = (config != listed, users == {SHIFTS[name].profile}, order.overrules)
        assert sum(changed) == (name != AS_LISTED), name
        assert config.world.action_delay_ticks == 1
    assert of[AS_LISTED].suite == of["eyes: poor"].suite


def test_losses_are_of_the_same_episodes_and_the_order_is_compared(corner, tmp_path, monkeypatch):
    """Here the better policy as listed is the worse one with poor eyes, and nobody could survive one drive."""

    def run_suite(order: SuiteOrder, *_: object) -> dict[str, tuple[EpisodeRecord, ...]]:
        here = {"follow": [CRASH] * 8, "a": [SAFE] * 8, "b": [MEDDLES] * 8}
        if order.settings == SHIFTS["eyes: poor"].settings:
            here["a"] = [CRASH] * 4 + [SAFE] * 4
            here["follow"] = [*[CRASH] * 7, replace(CRASH, last_moment_s=None)]
        return {
            name: tuple(replace(each, block=place) for place, each in enumerate(found)) for name, found in here.items()
        }

    monkeypatch.setattr(shifts, "run_suite", run_suite)
    rows = {(row.row.policy, row.shift): row for row in drive_shifts(order_of(corner, tmp_path), (), print)}
    assert [rows[name, AS_LISTED].loss for name in ("follow", "a", "b")] == [0.0, 0.0, 0.0]
    poor = {name: rows[name, "eyes: poor"] for name in ("follow", "a", "b")}
    assert [each.left_out for each in poor.values()] == [1, 1, 1] and poor["a"].row.episodes == 7
    assert poor["a"].loss == pytest.approx(4 / 7) and poor["a"].loss_ci[0] > 0.0 == poor["b"].loss
    assert (poor["b"].tau, rows["b", "chair: measured"].tau) == (pytest.approx(1 / 3), 1.0)


def test_a_shift_that_a_town_cannot_have_is_told_and_left_out(corner, tmp_path, monkeypatch):
    def run_suite(order: SuiteOrder, *_: object) -> dict[str, tuple[EpisodeRecord, ...]]:
        if missing in order.settings:
            raise TownError("SUMO crashes here")
        return {"follow": (GOOD,)}

    monkeypatch.setattr(shifts, "run_suite", run_suite)
    told: list[object] = []
    missing = "world.street=jupedsim"
    rows = drive_shifts(order_of(corner, tmp_path), (), told.append)
    assert [row.shift for row in rows] == [name for name in SHIFTS if "JuPedSim" not in name]
    assert told == ["others: JuPedSim: left out: SUMO crashes here"]
    missing = "chair.plant=mwd"
    with pytest.raises(TownError):
        drive_shifts(order_of(corner, tmp_path), (), told.append)


def test_who_was_helped_twice_for_nothing_overrules_for_twenty_seconds(corner):
    """A policy that turns aside in turns of two seconds is stopped by its user after the second time."""
    piece = Piece(index=0, block=block_of(corner, max_steps=330), town=str(corner), policy=f"{__name__}:Meddles")
    meddled, overruled = (
        drive_piece(replace(piece, judged=True, overrules=overrules))[0] for overrules in (False, True)
    )
    assert len(meddled.interventions) > 4 >= len(overruled.interventions)
    second, *after = [item.first for item in overruled.interventions[1:]]
    assert all(item.verdict == NEEDLESS for item in overruled.interventions[:2])
    assert all(first - second >= 200 for first in after)


class Meddles(Held):
    """Lets go of the stick for half a second in every two."""

    def __init__(self, config: object) -> None:
        super().__init__(0.0, 0.0)
        self.step = 0

    def act(self, observation):
        self.step += 1
        if self.step % 20 < 5:
            return self.action
        return POINTS.nearest(tuple(observation["joystick"]))

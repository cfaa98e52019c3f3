"""The stage of pictures and films."""

from types import SimpleNamespace

from wcsim.towns.scenario.town import find_town
from wcsim.view.filming import BusiestMoment, open_stage


def test_who_drives_on_a_stage_is_who_was_asked_for(corner):
    for asked, drives in (((), "competent"), (("slow",), "slow")):
        with open_stage(find_town(str(corner)), 0, 64, ("world.warmup_s=0",), *asked) as stage:
            assert stage.world.seats[0].user.profile.name == drives


def test_a_moment_that_does_not_fit_is_kept_only_till_one_does():
    business = iter([5.0, -1.0, 3.0, 9.0, 1.0])
    stage = SimpleNamespace(shot=lambda after_s: after_s, business=lambda: next(business))
    kept = BusiestMoment(stage, fits=False)
    taken = [kept.look(float(second), second in (2, 3, 5)) for second in (1, 2, 3, 4, 5)]
    assert taken == [True, True, True, False, False]
    assert kept.shot == 3.0

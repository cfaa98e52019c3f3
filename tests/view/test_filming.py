"""The stage of pictures and films."""

from wcsim.towns.scenario.town import find_town
from wcsim.view.filming import open_stage


def test_who_drives_on_a_stage_is_who_was_asked_for(corner):
    for asked, drives in (((), "competent"), (("slow",), "slow")):
        with open_stage(find_town(str(corner)), 0, 64, ("world.warmup_s=0",), *asked) as stage:
            assert stage.world.seats[0].user.profile.name == drives

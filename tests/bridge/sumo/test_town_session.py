from dataclasses import replace
from pathlib import Path

import pytest

from wcsim.bridge.sumo.session import warmup_s
from wcsim.config import RunConfig, parse_json, resolve
from wcsim.towns.scenario.town import Town

ASKED = "world.warmup_s=10"


@pytest.fixture
def warm(corner_town: Town) -> Town:
    """A town that says itself how long its traffic runs before."""
    return replace(corner_town, file=corner_town.file.model_copy(update={"warmup_s": 30.0}))


def test_a_warm_up_that_somebody_sets_counts_and_else_the_towns(corner_town: Town, warm: Town, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[world]\nwarmup_s = 10\n")
    plain = resolve("quick")
    assert warmup_s(warm, plain) == 30.0 and warmup_s(corner_town, plain) == 240.0
    asked = (resolve("quick", (ASKED,)), resolve("quick", file), resolve(plain, (ASKED,)))
    for config in (*asked, resolve(plain, file), resolve("quick", ("world={warmup_s = 10}",))):
        again = parse_json(RunConfig, config.model_dump_json(), "a run")  # as it goes to other processes
        assert warmup_s(warm, config) == warmup_s(warm, again) == 10.0
        assert warmup_s(warm, resolve(again, ("env.profile=competent",))) == 10.0

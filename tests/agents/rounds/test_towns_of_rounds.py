"""Which towns a run drives in, and which are made for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.worlds import dqn_config
from wcsim.agents.rounds import towns_of_rounds
from wcsim.agents.rounds.run_of_rounds import towns_of
from wcsim.errors import TownError
from wcsim.towns.scenario.town import find_town


def test_towns_are_made_where_somebody_drives_in_them_alone(
    corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own, made = find_town(str(corner)), list[Path]()
    monkeypatch.setattr(towns_of_rounds, "make_town", lambda out, drawn, wishes: made.append(out))
    monkeypatch.setattr(towns_of_rounds, "open_town", lambda out: own)
    driven, read = (dqn_config("collect.made_towns=2", f"collect.segments={count}") for count in (1, 0))
    assert towns_of(own, (), read, tmp_path, 3) == (str(own.address),) and not made
    assert towns_of(own, (), driven, tmp_path, 3) == (str(own.address),) * 3 and len(made) == 2


def test_towns_of_the_command_take_turns_with_those_of_the_configuration(corner: Path, tmp_path: Path) -> None:
    own, config = find_town(str(corner)), dqn_config(f'collect.towns=["{corner}"]')
    assert towns_of(own, ("helsinki",), config, tmp_path, 3) == (
        str(corner),
        find_town("helsinki").address,
        str(corner),
    )
    with pytest.raises(TownError, match="monaco is a test town"):
        towns_of(own, (), dqn_config('collect.towns=["monaco"]'), tmp_path, 3)

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.worlds import quick_config
from wcsim.bridge.record import TRACE, RecordOrder, check_mirrored, record_town
from wcsim.bridge.trace_file import read_trace
from wcsim.errors import SumoError
from wcsim.towns.town import find_town
from wcsim.types import ActorKind, ActorState


def actor(name: str, x_m: float, piece: int = 0) -> ActorState:
    return ActorState(
        id=name,
        kind=ActorKind.CAR,
        p_W_m=np.array([x_m, 0.0, 0.0]),
        yaw_rad=0.0,
        pitch_rad=0.0,
        v_W_mps=np.zeros(3),
        size_lwh_m=(4.0, 1.8, 1.5),
        piece=piece,
    )


def test_ghosts_and_missing_actors_are_told_from_who_is_only_near_the_border():
    chairs, near, border, far = np.zeros((1, 2)), actor("v:near", 10.0), actor("v:border", 49.0), actor("v:far", 80.0)
    everyone = (near, border, far)
    check_mirrored((near,), everyone, chairs, 50.0)
    check_mirrored((near, border, actor("v:near~1", 6.0, piece=1)), everyone, chairs, 50.0)
    with pytest.raises(SumoError, match=r"not there: v:ghost; there but not shown: nobody"):
        check_mirrored((near, actor("v:ghost", 3.0)), everyone, chairs, 50.0)
    with pytest.raises(SumoError, match=r"not there: nobody; there but not shown: v:near"):
        check_mirrored((), everyone, chairs, 50.0)
    check_mirrored((), everyone, np.zeros((0, 2)), 50.0)  # no chair sees anybody


def test_a_recorded_town_holds_everybody_and_the_chairs(corner, tmp_path):
    order = RecordOrder(seconds=6.0, seed=3, chairs=2, folder=tmp_path, outputs=("fcd",))
    opened = []
    facts = record_town(find_town(str(corner)), quick_config(), order, opened.append)
    header, records = read_trace(tmp_path / TRACE)
    assert (header.seats, len(records), facts.ticks) == (2, 60, 60)
    assert records[-1].plants.shape == (2, 15)
    assert records[-1].time_s == pytest.approx(6.0) == facts.end_s
    assert {name for record in records for name in record.actor_ids} == {b.id for r in records for b in r.bodies}
    assert facts.vehicles + facts.persons == len({name for record in records for name in record.actor_ids})
    assert facts.mirrored >= 1 and facts.episodes >= 2
    assert opened[0].outputs[0] == tmp_path / "sumo" / "fcd.xml"
    again = record_town(find_town(str(corner)), quick_config(), replace(order, folder=tmp_path / "b"), opened.append)
    assert again == facts
    assert (tmp_path / TRACE).read_bytes() == (tmp_path / "b" / TRACE).read_bytes()

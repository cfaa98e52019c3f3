"""Blocks on other machines: what travels with them is enough, and the records are those of this machine."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from wcsim.agents.evaluation.suite.run import SuiteOrder, drive_alone, needs_of, piece_of, run_suite, town_addresses
from wcsim.errors import ConfigError
from wcsim.server.workers.cluster import bundle
from wcsim.server.workers.machines import Machines


def test_a_block_with_what_travels_gives_the_same_records(corner, tmp_path):
    order = SuiteOrder(suite=suite_in(corner, block_of(corner, max_steps=12)), out=tmp_path)
    towns = town_addresses(order)
    for policy in ("dwa", "shipped"):
        piece = piece_of(order, 0, policy, towns, judged=False)
        places = {}
        for number, parcel in enumerate(needs_of(piece)):
            there = tmp_path / f"{policy}-{number}" / parcel.folder.name
            there.mkdir(parents=True)
            bundle.unpack(bundle.packed(parcel), there)
            assert bundle.digest_of(there, parcel.names) == bundle.digest_of(parcel.folder, parcel.names)
            places[parcel.address] = str(there / parcel.inner)
        assert len(places) == (1 if policy == "dwa" else 2)
        there_found = drive_alone(piece, lambda address, places=places: places.get(address, address))
        assert there_found == drive_alone(piece, str)


def test_what_does_not_travel_is_refused_before_a_cluster_is_asked(corner, tmp_path):
    order = SuiteOrder(
        suite=suite_in(corner, block_of(corner)), out=tmp_path, machines=Machines(cluster="10.255.255.1:6379")
    )
    with pytest.raises(ConfigError, match=r"class tests.*does not travel"):
        run_suite(order, ["tests.agents.evaluation.suite.lists:Held"], lambda *said: None)


@pytest.mark.proof
def test_a_suite_on_ray_is_the_same_bytes(corner: Path, tmp_path: Path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'wcsim[cluster]'")
    block = block_of(corner, max_steps=40)
    suite = suite_in(corner, block, block.model_copy(update={"seed": 77}))
    here = SuiteOrder(suite=suite, out=tmp_path / "here")
    there = SuiteOrder(suite=suite, out=tmp_path / "there", jobs=2, machines=Machines(cluster="local"))
    names = ["follow", "dwa", "shipped"]
    found = [
        {name: [record.to_json() for record in records] for name, records in run_suite(order, names, print).items()}
        for order in (here, there)
    ]
    assert json.dumps(found[0]) == json.dumps(found[1])
    kept = [sorted(p.name for p in (tmp_path / where / "kept").iterdir()) for where in ("here", "there")]
    assert kept[0] == kept[1]
    for name in kept[0]:
        assert (tmp_path / "here" / "kept" / name).read_bytes() == (tmp_path / "there" / "kept" / name).read_bytes()

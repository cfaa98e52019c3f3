"""Blocks on other machines: what travels with them is enough, and the records are those of this machine."""

import json
from pathlib import Path

import pytest
import torch

from tests.agents.evaluation.suite.lists import block_of, suite_in
from tests.agents.rounds.small_runs import run_in
from wcsim.agents.danger.network import DangerNet, channels_last, spec_of
from wcsim.agents.danger.policy import save_danger
from wcsim.agents.evaluation.suite.run import SuiteOrder, _drive_alone, _needs_of, piece_of, run_suite, town_addresses
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest
from wcsim.config.run_file import DangerRuleSettings
from wcsim.errors import ConfigError
from wcsim.server.workers.cluster_node import _unpack, compress_input_files
from wcsim.server.workers.machines import WorkerPoolSettings


@pytest.fixture(scope="module")
def run(corner: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A run with a policy that has learned nothing."""
    resolved = run_in(corner, tmp_path_factory.mktemp("trained") / "run")
    folder = create_run_folder(resolved.out, resolved.config, make_run_manifest(resolved.config, resolved.info))
    torch.manual_seed(3)
    net = DangerNet(spec_of(folder.config))
    save_danger(folder.policy("final"), channels_last(net).eval(), DangerRuleSettings(), folder.config)
    return str(folder.path)


def test_a_block_with_what_travels_gives_the_same_records(corner, run, tmp_path):
    order = SuiteOrder(suite=suite_in(corner, block_of(corner, max_steps=6)), out=tmp_path)
    towns = town_addresses(order)
    for number, policy in enumerate(("follow", run, f"{run}@0.3", f"{run}:final")):
        work = tmp_path / f"node-{number}"
        piece = piece_of(order, 0, policy, towns, judged=False)
        places = {}
        for parcel in _needs_of(piece):
            there = work / str(len(places)) / parcel.folder.name
            _unpack(compress_input_files(parcel), there)
            places[parcel.address] = str(there / parcel.inner)
        assert len(places) == (1 if policy == "follow" else 2)
        if policy in ("follow", f"{run}@0.3"):
            there_found = _drive_alone(piece, lambda address, places=places: places.get(address, address))
            assert there_found == _drive_alone(piece, str)


def test_what_does_not_travel_is_refused_before_a_cluster_is_asked(corner, tmp_path):
    order = SuiteOrder(
        suite=suite_in(corner, block_of(corner)), out=tmp_path, machines=WorkerPoolSettings(cluster="10.255.255.1:6379")
    )
    with pytest.raises(ConfigError, match=r"class tests.*cannot be sent"):
        run_suite(order, ["tests.agents.evaluation.suite.lists:Held"], lambda *said: None)


@pytest.mark.proof
def test_a_suite_on_ray_is_the_same_bytes(corner: Path, run: str, tmp_path: Path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'wcsim[cluster]'")
    block = block_of(corner, max_steps=40)
    suite = suite_in(corner, block, block.model_copy(update={"seed": 77}))
    here = SuiteOrder(suite=suite, out=tmp_path / "here")
    there = SuiteOrder(suite=suite, out=tmp_path / "there", jobs=2, machines=WorkerPoolSettings(cluster="local"))
    names = ["follow", "dwa", run]
    found = [
        {name: [record.to_json() for record in records] for name, records in run_suite(order, names, print).items()}
        for order in (here, there)
    ]
    assert json.dumps(found[0]) == json.dumps(found[1])
    kept = [sorted(p.name for p in (tmp_path / where / "kept").iterdir()) for where in ("here", "there")]
    assert kept[0] == kept[1]
    for name in kept[0]:
        assert (tmp_path / "here" / "kept" / name).read_bytes() == (tmp_path / "there" / "kept" / name).read_bytes()

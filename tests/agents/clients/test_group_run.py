"""The orders that the world of several clients gets, from a launcher's and from one by hand."""

from pathlib import Path

import pytest

from tests.support.worlds import dqn_config
from wcsim.agents.clients.group_run import ResolvedClient, ResolvedGroupRun, create_group_run_folder, make_world_spec
from wcsim.agents.runs.run_folder import make_run_manifest
from wcsim.cli import serve
from wcsim.server.host import opening
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import Town, find_town


def of_one_client(out, config, info):
    folder = create_group_run_folder(out, config, make_run_manifest(config, info), {"a": config})
    return ResolvedGroupRun(
        clients=(ResolvedClient(name="a", seat=0, config=config),), out=folder.path, info=info
    ), folder


@pytest.mark.parametrize("lease_s", [10.0, 120.0, 600.0])
def test_a_world_gives_its_clients_the_lease_that_was_asked_for(tmp_path, lease_s):
    config = dqn_config()
    run, folder = of_one_client(tmp_path / "run", config, RunInfo(seed=1, town="t"))
    trained = make_world_spec(run, "t", folder, tmp_path, 1, lease_s)
    served = serve._order(serve._Options(lease=lease_s), find_town("helsinki"), config, Path("place"))
    assert trained.rules.lease_s == served.rules.lease_s == lease_s


def test_each_generation_of_a_world_is_in_the_next_town(
    tmp_path: Path, corner: Path, corner_town: Town, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = RunInfo(seed=1, town="t", more_towns={str(corner): "0" * 64, "made:7": "0" * 64})
    run, folder = of_one_client(tmp_path / "run", dqn_config(), info)
    order = make_world_spec(run, "helsinki", folder, tmp_path, 1, 10.0)
    assert order.more_towns == (corner_town.address, "made:7")
    monkeypatch.setattr(opening, "requested_town", str)
    monkeypatch.setattr(opening, "World", lambda town, *given, epoch, find_user: (town, epoch))
    worlds = [opening.make_street_world(order, (None,), 3, epoch=epoch) for epoch in range(4)]
    assert worlds == [("helsinki", 0), (str(corner), 1), ("made:7", 2), ("helsinki", 3)]

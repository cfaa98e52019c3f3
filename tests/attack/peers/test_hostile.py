"""A world of honest clients under a hostile one with a key, which says 1,000 messages a second."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.attack.peers import hostile
from tests.server.servers import Server, stand_in_order
from wcsim.log.reader import iter_inputs
from wcsim.log.writer import JOURNAL
from wcsim.server.ledger import audit, iter_ledger
from wcsim.server.protocol.events import Rules
from wcsim.server.transport.keys import make_keys

NAMES = ("a", "b", "c", "d")


def besieged(folder: Path, town: str, rounds: int, phase_s: float) -> dict[str, float]:
    """Let four clients drive while a hostile one floods their world, then while another process burns as much."""
    keys = folder / "keys"
    make_keys(keys, ("evil",))
    rules = Rules(capacity=4, expected=4, gather_s=120.0, lease_s=60.0, notice_s=1.0)
    listen = {"listen": "tcp://127.0.0.1:*", "keys": str(keys), "run": str(folder / "run")}
    order = stand_in_order(folder, rules=rules, **listen)
    if town:
        order = replace(order, town=town)
    with Server(order, folder) as server:
        network = server.status().listening
        orders = [hostile.honest_order(order.endpoint, name, seat, folder) for seat, name in enumerate(NAMES)]
        clients = [hostile.honest_client(item, folder) for item in orders]
        server.status(lambda now: now.ticks > 20)
        before_mb = server.status().rss_mb
        told = list(hostile.phases(network, keys, rounds, phase_s))
        after_mb = server.status().rss_mb
        members = server.status().members
        for client in clients:
            hostile.end(client)
        server.process.terminate()
        server.wait()
    ledgers = [(seat, iter_ledger(folder / f"{name}.ledger")) for seat, name in enumerate(NAMES)]
    found = audit(iter_inputs(folder / "run" / JOURNAL), ledgers)
    sights = hostile.sights_of(folder, "a")
    floods, burns = ([phase for phase in told if phase.what == what] for what in ("flood", "burn"))
    flood_s, burn_s = hostile.tick_times_s(sights, floods), hostile.tick_times_s(sights, burns)
    return {
        "members": len(members),
        "ticks": found.ticks,
        "lost": found.lost + found.doubled + found.phantom,
        "flood_p50_ms": 1e3 * float(np.median(flood_s)),
        "burn_p50_ms": 1e3 * float(np.median(burn_s)),
        "flood_p99_ms": 1e3 * float(np.quantile(flood_s, 0.99)),
        "burn_p99_ms": 1e3 * float(np.quantile(burn_s, 0.99)),
        "flood_cpu": float(np.mean([phase.cpu_share for phase in floods])),
        "burn_cpu": float(np.mean([phase.cpu_share for phase in burns])),
        "grown_mb": after_mb - before_mb,
    }


def test_nobody_loses_a_step_to_a_flood(tmp_path: Path) -> None:
    facts = besieged(tmp_path, "", rounds=1, phase_s=1.5)
    assert (facts["members"], facts["lost"]) == (4, 0)
    assert facts["ticks"] > 100


@pytest.mark.proof
@pytest.mark.timeout(1200)
def test_five_minutes_under_a_hostile_client(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    facts = besieged(tmp_path, "helsinki", rounds=10, phase_s=30.0)
    with capsys.disabled():
        sys.stdout.write(f"\n{facts}\n")
    assert (facts["members"], facts["lost"]) == (4, 0)
    assert facts["flood_p99_ms"] <= 2.0 * facts["burn_p99_ms"]

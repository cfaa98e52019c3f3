"""A world of honest clients under a hostile one with a key, which says 1,000 messages a second."""

import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.attack.peers import hostile
from tests.server.servers import Server, stand_in_order, start_client
from wcsim.log.reader import iter_journal_inputs
from wcsim.log.writer import JOURNAL
from wcsim.server.ledger import audit_ledgers, iter_ledger_frames
from wcsim.server.protocol.events import ServerRules
from wcsim.server.transport.keys import create_missing_keys

NAMES = ("a", "b", "c", "d")


def besieged(
    folder: Path, town: str, phases: Callable[[str, Path], Iterable[hostile.Phase]]
) -> tuple[dict[str, float], list[hostile.Phase]]:
    """Let four clients drive a world through phases of its address and keys: what they lost, and the phases."""
    keys = folder / "keys"
    create_missing_keys(keys, ("evil",))
    rules = ServerRules(capacity=4, expected=4, gather_s=120.0, lease_s=60.0, notice_s=1.0)
    listen = {"listen": "tcp://127.0.0.1:*", "keys": str(keys), "run": str(folder / "run")}
    order = stand_in_order(folder, rules=rules, **listen)
    if town:
        order = replace(order, town=town)
    with Server(order, folder) as server:
        network = server.status().listening
        orders = [hostile.honest_order(order.endpoint, name, seat, folder) for seat, name in enumerate(NAMES)]
        clients = [start_client(item, folder) for item in orders]
        server.status(lambda now: now.ticks > 20)
        before_mb = server.status().rss_mb
        told = list(phases(network, keys))
        after_mb = server.status().rss_mb
        members = server.status().members
        for client in clients:
            hostile.end(client)
        server.process.terminate()
        server.wait()
    ledgers = [(seat, iter_ledger_frames(folder / f"{name}.ledger")) for seat, name in enumerate(NAMES)]
    found, _ = audit_ledgers(iter_journal_inputs(folder / "run" / JOURNAL), ledgers)
    lost = found.lost + found.doubled + found.phantom
    return {"members": len(members), "ticks": found.ticks, "lost": lost, "grown_mb": after_mb - before_mb}, told


def test_nobody_loses_a_step_to_a_flood(tmp_path: Path) -> None:
    facts, _ = besieged(tmp_path, "", partial(hostile.flooded, seed=0, phase_s=1.5))
    assert (facts["members"], facts["lost"]) == (4, 0)
    assert facts["ticks"] > 100


@pytest.mark.proof
@pytest.mark.timeout(1200)
def test_five_minutes_under_a_hostile_client(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    facts, told = besieged(tmp_path, "helsinki", partial(hostile.phases, rounds=10, phase_s=30.0))
    sights = hostile.sights_of(tmp_path, "a")
    for what in ("flood", "burn"):
        within = [phase for phase in told if phase.what == what]
        times_s = hostile.tick_times_s(sights, within)
        facts |= {f"{what}_p{part}_ms": 1e3 * float(np.percentile(times_s, part)) for part in (50, 99)}
        facts[f"{what}_cpu"] = float(np.mean([phase.cpu_share for phase in within]))
    with capsys.disabled():
        sys.stdout.write(f"\n{facts}\n")
    assert (facts["members"], facts["lost"]) == (4, 0)
    assert facts["flood_p99_ms"] <= 2.0 * facts["burn_p99_ms"]

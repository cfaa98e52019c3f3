"""Epochs that end as planned: the world's process is replaced, and nobody loses a step."""

import shutil
import subprocess
import threading
from dataclasses import replace

import pytest

from benchmarks.barrier.fake_world import FakeWorld
from tests.server.host.test_process import BOTH, audited, drive_through, two_linked
from tests.server.servers import AHEAD, Server, stand_in_order, together
from tests.server.servers import driven as driven_through
from tests.support.worlds import quick_config
from wcsim.config import resolve
from wcsim.log.reader import (
    hash_log,
    iter_journal_inputs,
    iter_journal_part_inputs,
    list_log_parts,
    read_header,
    rotate_log,
)
from wcsim.log.records import Admitted, Dismissed, Ended, EpochBegun
from wcsim.log.writer import JOURNAL
from wcsim.server.host.opening import EPOCH_OVER, _epoch_seed, open_server_parts
from wcsim.server.host.process import SETTLED_TICKS, _EpochCap
from wcsim.server.launch.states import WorldExitCode
from wcsim.server.ledger import iter_ledger_frames
from wcsim.server.protocol.events import BarrierState
from wcsim.server.protocol.members import RosterClient
from wcsim.server.protocol.server_core import ServerCore
from wcsim.types import SeatSpec

CAP, TICKS = 20, 47


def capped(folder, **changes):
    """A stand-in whose epochs end after CAP ticks."""
    config = resolve(quick_config(), f"world.epoch_ticks={CAP}")
    order = stand_in_order(folder, run=str(folder / "run"), rules=BOTH, config=config, **changes)
    return replace(order, epoch_ticks=CAP)


def kept_up(server, codes, until):
    """Start the world again whenever its epoch is over, as a launcher does."""
    while not until.is_set():
        try:
            code = server.process.wait(0.05)
        except subprocess.TimeoutExpired:  # it runs
            continue
        codes.append(code)
        server.kill()  # and close what it wrote to
        server.start()


def driven(folder, ticks):
    """Two clients drive so many ticks through as many epochs as it takes; the exit codes of the worlds."""
    folder.mkdir()
    codes, over = [], threading.Event()
    with two_linked(capped(folder), folder) as (server, links, _):
        server.status()
        keeper = threading.Thread(target=kept_up, args=(server, codes, over))
        keeper.start()
        try:
            restarts = together(links, lambda link: drive_through(link, ticks))
        finally:
            over.set()
            keeper.join()
    return codes, restarts


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A run through two ends of epochs."""
    folder = tmp_path_factory.mktemp("epochs") / "a"
    return folder, *driven(folder, TICKS)


def test_an_epoch_ends_at_its_cap_and_all_go_on_in_the_next_one(first):
    folder, codes, restarts = first
    assert codes == [WorldExitCode.EPOCH_OVER] * 2 and restarts == [2, 2]
    records = audited(folder)
    for name in "ab":  # the last frame of an epoch was seen before its world went
        seen = {(entry.epoch, entry.tick) for entry in iter_ledger_frames(folder / name) if entry.stepped}
        assert {(epoch, tick) for epoch in (0, 1) for tick in range(1, CAP + 1)} <= seen
    parts = list_log_parts(folder / "run" / JOURNAL)
    assert [part.name for part in parts] == ["journal.00001", "journal.00002", "journal"]
    begun = [[r.epoch for r in iter_journal_part_inputs(part) if isinstance(r, EpochBegun)] for part in parts]
    assert begun == [[0], [1], [2]]
    assert sum(isinstance(record, EpochBegun) for record in records) == 3


def test_everybody_comes_back_before_the_next_epoch_begins_so_equal_runs_stay_equal(first, tmp_path):
    driven(tmp_path / "b", TICKS)
    one, other = (hash_log(folder / "run" / JOURNAL) for folder in (first[0], tmp_path / "b"))
    assert one == other


def test_a_world_that_died_between_two_parts_goes_on_with_the_next_epoch(first, tmp_path):
    run = tmp_path / "a" / "run"
    shutil.copytree(first[0] / "run", run)
    rotate_log(run / JOURNAL)
    assert read_header(run / JOURNAL).seats == 2
    with Server(capped(tmp_path / "a"), tmp_path) as server:
        assert server.status().epoch == 3


def written(order, *records):
    """A world's beginning, and these records after it."""
    journal = open_server_parts(order, FakeWorld).journal
    for record in records:
        journal.append(record)
    journal.close()


@pytest.mark.parametrize("died", [True, False])
def test_a_world_that_ended_while_it_was_made_leaves_its_epoch_to_the_next_one(tmp_path, died):
    order, path = capped(tmp_path), tmp_path / "run" / JOURNAL
    both = [Admitted(epoch=0, tick=0, seat=seat, spec=SeatSpec(), name=name) for seat, name in enumerate("ab")]
    written(order, *both, *(() if died else (Ended(reason=f"{EPOCH_OVER}: of a test"),)))

    def dying(*_, **__):
        raise SystemExit(0)

    for _ in range(2):  # the second one comes upon a part in which nothing has begun
        with pytest.raises(SystemExit):
            open_server_parts(order, dying)
        assert len(list_log_parts(path)) == 2 and list(iter_journal_part_inputs(path)) == []
    opened = open_server_parts(order, FakeWorld)
    opened.journal.close()
    assert (opened.core.epoch, opened.core.rules.expected) == (1, 2)
    begun = [(record.epoch, record.seed) for record in iter_journal_inputs(path) if isinstance(record, EpochBegun)]
    assert begun == [(epoch, _epoch_seed(order.seed, epoch)) for epoch in (0, 1)] and len(list_log_parts(path)) == 2


def test_who_leaves_at_the_last_tick_of_an_epoch_is_not_waited_for_in_the_next_one(tmp_path):
    with two_linked(capped(tmp_path), tmp_path) as (server, (a, b), _):
        driven_through([a, b], CAP)
        b.close()
        a.send(CAP, AHEAD)
        assert server.wait() == WorldExitCode.EPOCH_OVER
    *_, gone, last = iter_journal_part_inputs(tmp_path / "run" / JOURNAL)
    assert gone == Dismissed(epoch=0, tick=CAP, seat=1, reason="left") and isinstance(last, Ended)
    opened = open_server_parts(capped(tmp_path), FakeWorld)
    assert opened.core.rules.expected == 1 and opened.journal is not None
    opened.journal.close()


def full_at(core, tick):
    """Why the epoch is over when the barrier of this tick is full."""
    core.stage, core.tick = BarrierState.COLLECT, tick
    core.roster.members = [RosterClient(seat=0, name="a", spec=SeatSpec(), session=b"a", peer=b"a", action=AHEAD)]
    core.advance(0.0)
    return core.stage is BarrierState.EPOCH_OVER


def test_an_epoch_ends_early_when_its_process_has_grown(tmp_path, monkeypatch):
    sizes = iter((500.0, 1400.0, 1600.0))
    monkeypatch.setattr("wcsim.server.host.process.measure_rss_mb", lambda: next(sizes))
    order = replace(stand_in_order(tmp_path, run=str(tmp_path)), epoch_ticks=6000)
    core = ServerCore(BOTH)
    cap = _EpochCap(order, core)
    core.tick = SETTLED_TICKS - 1
    cap.check_memory()
    for grown in (False, False, True):
        core.tick = SETTLED_TICKS
        cap.check_memory()
        assert full_at(core, SETTLED_TICKS) == bool(cap.reason) == grown
    assert "from 500 to 1600 MB" in cap.reason


@pytest.mark.parametrize("ends, tick, over", [(6000, 5999, False), (6000, 6000, True), (0, 6000, False)])
def test_an_epoch_ends_at_a_full_barrier_of_its_last_tick_where_somebody_goes_on(tmp_path, ends, tick, over):
    core = ServerCore(BOTH)
    cap = _EpochCap(replace(stand_in_order(tmp_path, run=str(tmp_path)), epoch_ticks=ends), core)
    assert not cap.reason, "somebody has not seen its last tick yet"
    assert full_at(core, tick) == bool(cap.reason) == over

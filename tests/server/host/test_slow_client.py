"""Six clients in processes of their own, one of which thinks ten times longer than the others."""

import sys
from pathlib import Path

from benchmarks.soak.stub_client import read_sights
from tests.server.servers import STAND_IN
from tests.support.worlds import quick_config
from wcsim.core.own_folder import create_runtime_folder, world_endpoint_from_folder
from wcsim.log.reader import iter_journal_inputs
from wcsim.log.writer import JOURNAL
from wcsim.server.launch.launcher import ProcessLauncher
from wcsim.server.launch.states import ClientLaunchPlan, LaunchProcessStates
from wcsim.server.ledger import audit_ledgers, iter_ledger_frames
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import SeatRequest, WorldProcessSpec, encode_json_line, make_world_launch_plan
from wcsim.types import SeatSpec
from wcsim.view.live_table import _line_of

STEPS, SLOW = 60, 4
THINK_MS = 5.0


def plan(place: Path, folder: Path, seat: int) -> ClientLaunchPlan:
    name = f"c{seat}"
    join = SeatRequest(
        endpoint=world_endpoint_from_folder(place),
        name=name,
        claim=name,
        spec=SeatSpec(),
        seat=seat,
        ledger=str(folder / f"{name}.ledger"),
    )
    file = place / f"{name}.json"
    file.write_bytes(encode_json_line(join))
    think_ms = 10.0 * THINK_MS if seat == SLOW else THINK_MS
    argv = (sys.executable, "-m", "benchmarks.soak.stub_client", str(file), "--steps", str(STEPS))
    argv += ("--think-ms", str(think_ms), "--sights", str(folder / f"{name}.sights"))
    return ClientLaunchPlan(name=name, seat=seat, argv=argv, log=folder / "logs" / name)


def test_all_step_at_its_pace_nobody_loses_a_tick_and_it_is_named(tmp_path: Path):
    states: list[LaunchProcessStates] = []
    with create_runtime_folder() as place:
        order = WorldProcessSpec(
            town="",
            config=quick_config(),
            seed=1,
            rules=ServerRules(capacity=6, expected=6),
            endpoint=world_endpoint_from_folder(place),
            ring=str(place / "ring"),
            run=str(tmp_path),
        )
        plans = [plan(place, tmp_path, seat) for seat in range(6)]
        argv = (sys.executable, "-m", STAND_IN)
        outcome = ProcessLauncher(
            make_world_launch_plan(order, place, tmp_path / "logs" / "world.log", argv),
            plans,
            tmp_path,
            show=states.append,
        ).run()
    assert outcome.code == 0, outcome.message
    ledgers = [(seat, tuple(iter_ledger_frames(tmp_path / f"c{seat}.ledger"))) for seat in range(6)]
    whole, each = audit_ledgers(iter_journal_inputs(tmp_path / JOURNAL), ledgers)
    assert whole.ticks == STEPS
    for told in each:
        assert (told.first_tick, told.last_tick, told.steps) == (0, STEPS, STEPS)
        assert (told.missing, told.lost, told.doubled, told.phantom) == (0, 0, 0, 0)
    for seat in range(6):
        times_s = [sight.time_s for sight in read_sights(tmp_path / f"c{seat}.sights")]
        assert (times_s[-1] - times_s[0]) / STEPS >= 1e-3 * 10.0 * THINK_MS
    last = [state for state in states if state.world is not None and len(state.world.members) == 6][-1]
    assert last.world is not None and last.world.ticks > STEPS // 2
    held = {item.name: item.seconds for item in last.world.held}
    assert max(held, key=lambda name: held[name]) == f"c{SLOW}" and held[f"c{SLOW}"] > 0.5 * sum(held.values())
    assert f"slowest client c{SLOW}" in _line_of(last)

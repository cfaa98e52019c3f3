"""Processes that die, hang and are ended: a launcher with stand-ins for world and clients."""

import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.events import read_events
from tests.support.yardstick import waited
from wcsim.config import RunConfig
from wcsim.core.own_folder import create_runtime_folder, world_endpoint_from_folder
from wcsim.server.launch.launcher import ProcessLauncher
from wcsim.server.launch.states import ClientLaunchPlan, LauncherTimeouts, ProcessRestartRules
from wcsim.server.launch.supervised import MOST_EXCUSED_DEATHS
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import WorldProcessSpec, make_world_launch_plan

STUB = (sys.executable, "-I", "-S", str(Path(__file__).parent / "launch_stubs.py"))
QUICK = LauncherTimeouts(
    world_lease_s=3.0,
    loading_lease_s=60.0,
    client_lease_s=3.0,
    joining_s=60.0,
    saving_s=60.0,
    leaving_s=0.1,
    ending_s=60.0,
    client=ProcessRestartRules(first_s=0.01, longest_s=0.05),
    world=ProcessRestartRules(first_s=0.01, longest_s=0.05),
)


def launcher(
    folder, clients, world="", members=None, show=None, orders=False, world_argv=(*STUB, "world"), listen="", **rules
):
    """A launcher of stubs; `clients` maps names to their words."""
    place = folder / "place"
    place.mkdir(parents=True, mode=0o700)
    order = WorldProcessSpec(
        town="",
        config=RunConfig(),
        seed=0,
        rules=ServerRules(capacity=4),
        endpoint=world_endpoint_from_folder(place),
        ring=str(place / "ring"),
        name=" ".join(clients if members is None else members),
        run=str(folder),
        hook=world,
        listen=listen,
    )
    plans = [
        ClientLaunchPlan(
            name=name,
            seat=seat,
            argv=(*STUB, "client", str(folder / name), *words.split()),
            log=folder / "logs" / f"{name}.log",
            order=b"{}" if orders else b"",
            order_file=place / f"{name}.json" if orders else None,
        )
        for seat, (name, words) in enumerate(clients.items())
    ]
    plan = make_world_launch_plan(order, place, folder / "logs" / "world.log", world_argv)
    return ProcessLauncher(plan, plans, folder, replace(QUICK, **rules), show)


@pytest.fixture
def launch(tmp_path):
    """Runs a launcher of stubs to its end."""
    return lambda *clients, **more: launcher(tmp_path, *clients, **more).run()


@pytest.fixture
def who_had(tmp_path):
    """Who had such an event, in their order."""
    return lambda event: [line["who"] for line in read_events(tmp_path) if line["event"] == event]


def standings(outcome):
    return {client.name: client.standing for client in outcome.clients}


def test_all_start_and_end_in_order(launch, who_had, tmp_path):
    states = []
    outcome = launch({"a": "steps=30", "b": "steps=60"}, show=states.append)
    assert (outcome.code, outcome.message, outcome.stopped) == (0, "", False)
    assert standings(outcome) == {"a": "done", "b": "done"}
    assert [client.status.step for client in outcome.clients] == [30, 60]
    assert (tmp_path / "ended").exists()
    assert [(e["event"], e["who"]) for e in read_events(tmp_path)[:3]] == [
        ("start", "world"), ("start", "a"), ("start", "b"),
    ]  # fmt: skip
    assert who_had("done") == ["a", "b"]
    assert read_events(tmp_path)[-1]["event"] == "end"
    assert all(state.world is None or state.world.tick >= 0 for state in states)
    assert states[-1].stopping
    assert list((tmp_path / "place").iterdir()) == []


def test_a_client_that_is_killed_goes_on_where_it_was(launch, who_had, tmp_path):
    outcome = launch({"a": "steps=60 die=20x1", "b": "steps=60"})
    assert outcome.code == 0
    assert who_had("death") == who_had("restart") == who_had("recovery") == ["a"]
    death = next(e for e in read_events(tmp_path) if e["event"] == "death")
    assert "SIGKILL" in death["reason"]
    back = next(e for e in read_events(tmp_path) if e["event"] == "recovery")
    assert back["after_s"] > 0.0
    assert back["step"] >= 19
    assert [(client.restarts, client.status.step) for client in outcome.clients] == [(1, 60), (0, 60)]


def test_clients_that_lost_their_world_or_seat_are_started_again(launch, who_had):
    outcome = launch({f"exit{code}": f"steps=40 exit{code}=20x1" for code in (1, 3, 4, 5)})
    assert outcome.code == 0
    assert sorted(who_had("restart")) == ["exit1", "exit3", "exit4", "exit5"]


def test_a_client_that_has_grown_is_replaced_at_once_and_has_not_died(launch, who_had):
    outcome = launch({"a": "steps=200 exit7=20x3"})
    assert (outcome.code, standings(outcome)) == (0, {"a": "done"})
    assert who_had("replaced") == ["a"] * 3 and who_had("death") == []
    assert who_had("restart") == ["a"] * 3 and outcome.clients[0].restarts == 0


def test_a_client_that_dies_in_vain_is_given_up_and_the_others_go_on(launch, who_had, tmp_path):
    outcome = launch({"a": "steps=60 die=10 forgets", "b": "steps=200"})
    assert outcome.code == 1
    assert standings(outcome) == {"a": "given up", "b": "done"}
    assert "client a was dropped: it was killed by SIGKILL" in outcome.message
    assert str(tmp_path / "logs" / "a.log") in outcome.message
    assert who_had("death") == ["a"] * 5


def test_a_client_that_dies_often_but_comes_on_is_not_given_up(launch, who_had):
    words = " ".join(f"die={step}x{life}" for life, step in enumerate(range(5, 35, 5), start=1))
    outcome = launch({"a": f"steps=40 {words}"})
    assert outcome.code == 0
    assert who_had("death") == ["a"] * 6


def test_a_mistake_of_the_user_ends_the_run_with_its_message(launch, who_had, tmp_path):
    outcome = launch({"a": "steps=100000", "b": "exit2=3 patient"})
    assert (outcome.code, outcome.message) == (2, "a fault of kind 2")
    assert standings(outcome) == {"a": "stopped", "b": "given up"}
    assert (tmp_path / "a" / "saved").exists()
    assert who_had("restart") == []


def test_a_world_that_dies_is_started_again(launch, who_had):
    outcome = launch({"a": "steps=150"}, world="die=30x1")
    assert outcome.code == 0
    assert who_had("death") == who_had("restart") == who_had("recovery") == ["world"]


def test_a_world_whose_epoch_is_over_is_replaced_at_once_and_has_not_died(launch, who_had, tmp_path):
    states = []
    outcome = launch({"a": "steps=200"}, world="exit5=20x3", show=states.append)
    assert (outcome.code, standings(outcome)) == (0, {"a": "done"})
    assert who_had("replaced") == ["world"] * 3 and who_had("death") == []
    assert next(line["reason"] for line in read_events(tmp_path) if line["event"] == "replaced") == "a fault of kind 5"
    assert who_had("restart") == ["world"] * 3 and states[-1].world_restarts == 0


def test_a_world_that_hangs_is_ended_and_started_again(launch, who_had):
    outcome = launch({"a": "steps=1500"}, world="hang=30x1")
    assert outcome.code == 0
    assert who_had("hang") == who_had("restart") == ["world"]


def test_a_world_that_a_signal_holds_is_ended_long_before_one_that_may_be_busy(launch, who_had):
    outcome = launch({"a": "steps=1500"}, world="held=30x1", world_lease_s=600.0, held_s=0.2)
    assert outcome.code == 0
    assert who_had("hang") == who_had("restart") == ["world"]


def test_a_world_that_dies_at_the_same_tick_again_and_again_is_given_up(launch, who_had):
    outcome = launch({"a": "steps=100000"}, world="die=30")
    assert outcome.code == 1
    assert "died 5 times at tick" in outcome.message
    assert who_had("death") == ["world"] * 5
    assert standings(outcome) == {"a": "stopped"}


@pytest.mark.parametrize("words", ["exit2=40", "exit3=0"])
def test_what_a_world_says_of_its_order_is_not_tried_again(launch, who_had, words):
    outcome = launch({"a": "steps=100000"}, world=words)
    assert (outcome.code, outcome.message) == (2, f"a fault of kind {words[4]}")
    assert who_had("restart") == []


def test_a_client_that_lost_its_seat_and_hangs_is_ended(launch, who_had):
    # At times it hears late that its seat is lost.
    outcome = launch({"a": "steps=30 hang=10x1"}, world="evict=9", joining_s=8.0)
    assert outcome.code == 0
    assert who_had("hang") == who_had("restart") == ["a"]


def test_a_client_that_never_takes_its_seat_is_ended(launch, who_had):
    outcome = launch({"a": "steps=100000"}, members=[], joining_s=0.5, client_lease_s=0.3)
    assert outcome.code == 1
    assert set(who_had("hang")) == {"a"}


def test_a_client_that_does_not_end_when_asked_is_killed(launch, tmp_path):
    outcome = launch({"a": "steps=100000 hang=5 deaf", "b": "exit2=20 patient"}, saving_s=2.0)
    assert outcome.code == 2
    assert standings(outcome)["a"] == "stopped"
    stopped = next(e for e in read_events(tmp_path) if e["event"] == "stopped")
    assert stopped["code"] == -signal.SIGKILL
    assert {client.name: client.unsaved for client in outcome.clients} == {"a": "was killed by SIGKILL", "b": ""}


def test_a_client_without_room_is_given_up_and_the_others_go_on(launch, who_had):
    outcome = launch({"a": "seated exit6=5 steps=99", "b": "steps=80"})
    assert outcome.code == 1
    assert standings(outcome) == {"a": "given up", "b": "done"}
    assert "no disk space" in outcome.message and "a fault of kind 6" in outcome.message
    assert who_had("restart") == []


def test_a_world_without_room_has_failed_and_was_not_refused(launch, who_had):
    outcome = launch({"a": "steps=100000"}, world="exit4=40")
    assert (outcome.code, standings(outcome)) == (1, {"a": "stopped"})
    assert "wcsim resume" in outcome.message
    assert who_had("restart") == []


def test_a_client_that_a_world_which_does_not_tick_sends_away_is_given_up_and_the_run_ends(launch, who_had):
    """As one whose pictures do not fit; the world would wait for it, and the others with the world."""
    outcome = launch({"a": "steps=99 exit4=1", "b": "steps=100000"}, world="idle")
    assert (outcome.code, standings(outcome)) == (1, {"a": "given up", "b": "stopped"})
    deaths = who_had("death")
    assert set(deaths) == {"a"}
    assert 5 <= len(deaths) < 5 + MOST_EXCUSED_DEATHS  # those before the world is there are forgiven


def test_orders_are_there_again_when_somebody_removed_them(who_had, tmp_path):
    def rob(state):
        if state.clients[0].status and state.clients[0].status.step > 5 and not (tmp_path / "robbed").exists():
            (tmp_path / "robbed").touch()
            shutil.rmtree(tmp_path / "place")

    it = launcher(tmp_path, {"a": "steps=300 die=30x1"}, show=rob, orders=True)
    outcome = it.run()
    assert outcome.code == 0, outcome.message
    assert who_had("place lost") == ["world"]
    assert who_had("restart").count("world") == 1


# --- signals, in a process of its own ---

RUNNER = """
import json, sys
from pathlib import Path
from tests.server.launch.test_launcher import launcher
folder = Path(sys.argv[1])
def show(state):
    pids = [state.world_pid, *(client.pid for client in state.clients)]
    beside = folder / "pids.tmp"
    steps = [client.status.step if client.status else 0 for client in state.clients]
    beside.write_text(json.dumps({"pids": pids, "steps": steps}))
    beside.rename(folder / "pids")
outcome = launcher(folder, {"a": sys.argv[2], "b": "steps=100000"}, show=show).run()
print(outcome.code, outcome.stopped, outcome.message)
"""


def begun(folder, words="steps=100000"):
    """A launcher in a process of its own whose clients all work, and the processes that it started."""
    child = subprocess.Popen(
        [sys.executable, "-c", RUNNER, str(folder), words],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    waited((folder / "pids").is_file)

    def pids_of_all_at_work():
        seen = json.loads((folder / "pids").read_text())
        return all(seen["pids"]) and all(seen["steps"]) and seen["pids"]

    return child, waited(pids_of_all_at_work)


def gone(pids, within_s):
    """Whether all of these processes have ended."""
    return waited(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), within_s)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_everything_in_order(tmp_path, number):
    child, pids = begun(tmp_path)
    child.send_signal(number)
    out, _ = child.communicate(timeout=120)
    assert out.split() == ["0", "True", "stopped"]
    assert gone(pids, 0.0)
    for name in ("a", "b"):
        assert (tmp_path / name / "saved").exists()
    assert (tmp_path / "ended").exists()
    assert [e["event"] for e in read_events(tmp_path)][-4:] == ["stop", "stopped", "stopped", "end"]


def test_a_second_signal_ends_everything_at_once(tmp_path):
    child, pids = begun(tmp_path, "steps=100000 hang=5 deaf")
    child.send_signal(signal.SIGTERM)
    time.sleep(0.3)
    child.send_signal(signal.SIGTERM)
    child.communicate(timeout=120)
    assert gone(pids, 0.0)


def test_world_and_clients_go_on_while_their_launcher_stands_still(who_had, tmp_path):
    child, pids = begun(tmp_path)
    child.send_signal(signal.SIGSTOP)
    wanted = 100 + json.loads((tmp_path / "pids").read_text())["steps"][0]
    waited(lambda: int((tmp_path / "a" / "step").read_text() or 0) >= wanted)  # the client does not stand still, too
    child.send_signal(signal.SIGTERM)
    child.send_signal(signal.SIGCONT)
    out, _ = child.communicate(timeout=120)
    assert out.split() == ["0", "True", "stopped"]
    assert gone(pids, 0.0) and who_had("death") == []


@pytest.mark.parametrize("stands", [False, True])
def test_nothing_outlives_a_launcher_that_is_killed(tmp_path, stands):
    child, pids = begun(tmp_path)
    if stands:
        child.send_signal(signal.SIGSTOP)
    child.kill()
    child.communicate(timeout=120)
    assert gone(pids, 60.0)
    assert (tmp_path / "a" / "saved").exists()


OWNER = """
import time
from wcsim.core.own_folder import create_runtime_folder
with create_runtime_folder() as place:
    print(place, flush=True)
    time.sleep(60)
"""


def test_the_place_of_a_killed_launcher_is_removed_by_the_next_one(tmp_path):
    child = subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE, text=True)
    left = Path(child.stdout.readline().strip())
    assert left.is_dir()
    assert left.stat().st_mode & 0o077 == 0
    with create_runtime_folder():
        assert left.is_dir()  # its owner lives
    child.kill()
    child.communicate()
    with create_runtime_folder() as mine:
        assert not left.exists()
        assert mine.is_dir()
    assert not mine.exists()

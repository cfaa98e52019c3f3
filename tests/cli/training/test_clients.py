"""Several networks in one world, a world by hand, and a client by hand."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK, finished, parsed, start
from tests.support.yardstick import waited
from wcsim.agents.clients.group_run import ResolvedGroupRun, create_group_run_folder, open_group_run_folder
from wcsim.agents.clients.paid_times import read_group_run_times
from wcsim.agents.networks.names import NETWORK_NAMES
from wcsim.agents.networks.registry import NETWORKS
from wcsim.agents.opening.learner_registry import Q_LEARNING
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest, open_run
from wcsim.cli.main import main
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.shared.run_config import settings_from_learner
from wcsim.cli.shared.training import make_q_config_layers
from wcsim.cli.training.clients import ALL_DONE, ClientProcessOptions, _stop_message, train_clients
from wcsim.cli.training.train import _QLearningOptions as QOptions
from wcsim.cli.training.train_clients import TrainClientsOptions, make_client_names, resolve_clients
from wcsim.config import resolve
from wcsim.errors import ConfigError, InterruptedRunError, PolicyError
from wcsim.log.reader import iter_journal_inputs, read_header
from wcsim.log.records import EpochBegun
from wcsim.log.writer import JOURNAL
from wcsim.server.launch.states import ClientProcessState, ClientStatusReport, LaunchProcessStates, ProcessRestartRules
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.town import streets_hash
from wcsim.towns.scene_folders.build import build_scene, find_scene

SMALL = (
    *("--set", "world.warmup_s=0", "--set", "cameras.0.width_px=40", "--set", "cameras.0.height_px=36"),
    *("--set", "learn.batch_size=4", "--set", "learn.learning_starts=8", "--set", "learn.episode_steps=15"),
)


def q_config(asked, *more):
    return resolve(asked.preset, *make_q_config_layers(asked, *more))


def places(child):
    """What the worlds of a command have left in memory."""
    return [path.name for path in Path("/dev", "shm").glob(f"wcsim-*-{child.pid}-*")]


# --- options ---


def test_names_of_clients():
    assert make_client_names(("fig6", "fig6", "fig6")) == ("fig6", "fig6-2", "fig6-3")
    assert make_client_names(("a.b:world", "a.b:logs")) == ("world-2", "logs-2")
    assert make_client_names(("deep.file:Net", "file:Net", "patch")) == ("Net", "Net-2", "patch")


def test_names_of_networks_are_known_without_torch():
    assert tuple(sorted(NETWORKS)) == NETWORK_NAMES


def test_steps_shorten_a_first_phase_that_would_be_most_of_it():
    learn = q_config(QOptions()).learn
    assert q_config(QOptions(steps=2 * learn.phase1_steps)).learn.phase1_steps == learn.phase1_steps
    for steps in (1, 60, 2 * learn.phase1_steps - 1):
        config = q_config(QOptions(steps=steps))
        short = config.learn
        assert short.total_steps == steps
        assert short.phase1_steps == round(steps * learn.phase1_steps / learn.total_steps)
        assert short.learning_starts <= max(steps / 2, 1)
        assert f"{steps} steps: {short.phase1_steps} in" in Q_LEARNING.describe(config)
    assert "an oracle's labels (learn.aid=oracle)" in Q_LEARNING.describe(resolve("dqn"))
    assert Q_LEARNING.describe(resolve("paper")).startswith("Q-learning from rewards, 1000000 steps: 250000 in")


def test_clients_differ_in_what_they_learn_with_and_share_the_world(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text("[learn]\ngamma = 0.5\n[env]\nwindow = 2\n")
    options = TrainClientsOptions(clients="patch,fig6", steps=100, config_for=(f"fig6={own}",))
    patch, fig6 = resolve_clients(options)
    assert [(c.name, c.seat) for c in (patch, fig6)] == [("patch", 0), ("fig6", 1)]
    assert [c.config.learn.network for c in (patch, fig6)] == ["patch", "fig6"]
    assert (patch.config.learn.gamma, fig6.config.learn.gamma, fig6.config.env.window) == (0.97, 0.5, 2)
    assert patch.config == resolve(patch.config, settings_from_learner(patch.config))
    own.write_text("[world]\ntick_s = 0.05\nsubsteps = 12\n")
    with pytest.raises(ConfigError, match="patch and fig6 ask for different worlds"):
        resolve_clients(options)


# --- how a run ends, without its processes ---

STEPS = 8


@pytest.fixture
def halfway(tmp_path, corner, corner_town):
    """A run of two clients, of which the first is done, and its town."""
    words = ("wcsim", "train", "--town", str(corner), "--preset", "dqn")
    info = RunInfo(seed=1, town="corner", town_sha256=streets_hash(corner_town), command=words)
    clients = resolve_clients(TrainClientsOptions(clients="patch,fig6", steps=STEPS, preset="dqn"))
    configs, world = {client.name: client.config for client in clients}, clients[0].config
    folder = create_group_run_folder(tmp_path / "run", world, make_run_manifest(world, info), configs)
    create_run_folder(folder.path / "patch", world, make_run_manifest(world, info)).with_status("done", STEPS)
    return ResolvedGroupRun(clients=clients, out=folder.path, info=info, resume=True), corner_town


class NoProcesses:
    """Stands in for a launcher: shows these states, and ends with the last one's clients, or as `ends` does."""

    states, ends, rules = (), None, None

    def __init__(self, *given, signals):
        *_, NoProcesses.rules, self._show = given

    def run(self):
        for state in self.states:
            self._show(state)
        if self.ends is not None:
            self.ends()
        clients = self.states[-1].clients if self.states else ()
        return replace(ALL_DONE, clients=clients)


def ended(monkeypatch, halfway, states=(), ends=None, last=True, **asked):
    """What comes of a run whose processes do that."""
    monkeypatch.setattr(NoProcesses, "states", states)
    monkeypatch.setattr(NoProcesses, "ends", None if ends is None else staticmethod(ends))
    monkeypatch.setattr("wcsim.cli.training.clients.ProcessLauncher", NoProcesses)
    run, town = halfway
    return train_clients(ClientProcessOptions(), replace(run, last=last), town, **asked)


def test_a_stop_that_comes_while_a_part_of_a_run_is_told_ends_the_run(monkeypatch, halfway, capsys):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)

    def tell(*_):
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("wcsim.cli.training.clients._print_report", tell)
    try:
        with pytest.raises(InterruptedRunError, match="wcsim resume"):
            ended(monkeypatch, halfway, last=False)
        assert ended(monkeypatch, halfway) == ExitCode.DONE, "nothing is to follow"
    finally:
        for number, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(number, handler)


def test_work_that_a_client_could_not_save_when_it_was_stopped_is_not_called_kept(tmp_path):
    kept, lost = (
        ClientProcessState(name=n, seat=0, standing="stopped", unsaved=why) for n, why in (("a", ""), ("b", "x"))
    )
    assert "holds the training so far" in _stop_message(tmp_path, (kept,))
    assert "client b x: the training since its last checkpoint is lost" in _stop_message(tmp_path, (kept, lost))
    full = ClientProcessState(name="c", seat=0, standing="given up", reason="has no disk space to save: x")
    told = _stop_message(tmp_path, (kept, full))
    assert "stopped, but client c has no disk space to save: x: the training since" in told


def test_who_kills_processes_on_purpose_says_when_they_are_given_up(monkeypatch, halfway):
    for asked in (ProcessRestartRules(deaths=99), None):
        ended(monkeypatch, halfway, (learning_state(1.0, 1.0),), restarts=asked)
        rules = NoProcesses.rules
        assert rules.client == rules.world == (asked or ProcessRestartRules())


def learning_state(elapsed_s, learned_s, step=1):
    """The second client learns, in a world that does not tick yet."""
    status = ClientStatusReport(name="fig6", step=step, learning_s=learned_s)
    client = ClientProcessState(name="fig6", seat=1, standing="running", status=status)
    told = {"elapsed_s": elapsed_s, "world_standing": "running", "world_pid": 1, "world_restarts": 0, "world": None}
    return LaunchProcessStates(**told, clients=(client,))


def test_what_clients_pay_is_kept_each_minute_and_when_something_fails(monkeypatch, halfway):
    run, _ = halfway
    kept = []

    def states():
        for elapsed_s in (1.0, 59.0, 61.0, 90.0):
            yield learning_state(elapsed_s, learned_s=elapsed_s)
            times = read_group_run_times(run.out)
            kept.append(None if times is None else times.clients["fig6"].learning_s)

    def fail():
        raise RuntimeError("in the launcher")

    with pytest.raises(RuntimeError):
        ended(monkeypatch, halfway, states(), fail)
    assert kept == [None, None, 61.0, 61.0]
    assert read_group_run_times(run.out).clients["fig6"].learning_s == 90.0


def test_steps_of_clients_that_were_done_before_stay_in_the_sum(monkeypatch, halfway):
    run, _ = halfway
    for step, total in ((5, STEPS + 5), (0, STEPS)):  # in the second sitting the other one said nothing yet
        ended(monkeypatch, halfway, (learning_state(1.0, 1.0, step),))
        assert open_group_run_folder(run.out).manifest.steps == total


# --- whole runs ---


def test_two_networks_learn_in_one_world_of_a_town_a_generation(tmp_path, corner):
    other = tmp_path / "other"
    other.mkdir()
    build_scene(find_scene("two-chairs"), other)
    words = ("--town", f"{corner},{other}", "--steps", 20, "--out", "run", "--json", "x.json", *SMALL)
    generations = ("--set", "world.epoch_ticks=12", "--set", "learn.phase1_steps=8")
    child = start(tmp_path, "train-clients", "patch,fig6", *words, *generations)
    out, _ = finished(child, 200)
    result = parsed(tmp_path / "x.json")
    assert [(c["name"], c["ticks"], c["missing"], c["duplicated"]) for c in result["clients"]] == [
        ("patch", 19, 0, 0),
        ("fig6", 19, 0, 0),
    ], "the step that met the end of a generation was no tick"
    assert (result["ticks"], result["status"]) == (19, "done")
    assert result["journal_hash"] in out
    assert result["ticks_per_s"] >= 0.0
    run = open_group_run_folder(tmp_path / "run")
    assert (run.manifest.status, run.manifest.seed, run.clients) == ("done", 0, ("patch", "fig6"))
    for name in run.clients:
        own = open_run(tmp_path / "run" / name)
        assert (own.manifest.status, own.config.learn.network) == ("done", name)
        assert own.policy("final").is_dir()
        times = read_group_run_times(run.path).clients[name]
        assert times.learning_s > 0.0
        assert times.world_s > 0.0
    with pytest.raises(PolicyError, match="several clients; name one of them"):
        open_run(tmp_path / "run")
    assert places(child) == []
    journal = tmp_path / "run" / JOURNAL
    assert read_header(journal).more_towns == (str(other),)
    assert [record.epoch for record in iter_journal_inputs(journal) if isinstance(record, EpochBegun)] == [0, 1]
    assert main(["log", "verify", str(journal)]) == ExitCode.DONE


def test_more_cameras_than_a_ring_has_places_for_are_refused(wcsim, folder, corner):
    camera = '[[cameras]]\nname = "c%d"\nwidth_px = 16\nheight_px = 12\n'
    (folder / "many.toml").write_text("".join(camera % number for number in range(65)))
    told = wcsim("train-clients", "patch", "--town", corner, "--config", "many.toml", "--out", "run")
    assert (told.code, "64" in told.err, "Traceback" in told.err) == (ExitCode.REFUSED, True, False), told
    assert not (folder / "run").exists()


@pytest.mark.proof
def test_equal_seeds_give_equal_worlds(tmp_path, corner):
    hashes = []
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        words = ("train-clients", "conv3d,fig6", "--town", corner, "--steps", 60, "--seed", seed, "--out", name)
        child = start(tmp_path, *words, "--json", f"{name}.json", *SMALL)
        finished(child)
        hashes.append(parsed(tmp_path / f"{name}.json")["journal_hash"])
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.proof
def test_what_was_stopped_goes_on_with_resume(tmp_path, corner):
    words = ("train-clients", "patch,fig6", "--town", corner, "--steps", 200, "--out", "run", *SMALL)
    child = start(tmp_path, *words)
    waited(lambda: places(child))
    waited(lambda: (tmp_path / "run" / "fig6" / "metrics.csv").is_file())
    waited(lambda: len((tmp_path / "run" / "fig6" / "metrics.csv").read_text().splitlines()) > 1)
    child.send_signal(signal.SIGINT)
    _, err = finished(child, 200, ExitCode.STOPPED)
    assert "wcsim resume run" in err
    assert places(child) == []
    assert open_group_run_folder(tmp_path / "run").manifest.status == "interrupted"
    for name in ("patch", "fig6"):
        assert open_run(tmp_path / "run" / name).manifest.status == "interrupted"
    with (tmp_path / "run" / "journal").open("ab") as file:
        file.write(b"torn")
    child = start(tmp_path, "resume", "run", "--json", "x.json")
    _, err = finished(child)
    result = parsed(tmp_path / "x.json")
    assert [(c["ticks"], c["missing"], c["duplicated"]) for c in result["clients"]] == [(200, 0, 0), (200, 0, 0)]
    assert "the last 4 bytes were an incomplete record" in err
    assert (tmp_path / "run" / "journal.torn").read_bytes() == b"torn"
    child = start(tmp_path, "resume", "run", "--json", "again.json")
    child.communicate(timeout=120)
    again = parsed(tmp_path / "again.json")
    assert (child.returncode, again) == (0, {**result, "ticks_per_s": 0.0})


@pytest.mark.proof
def test_a_world_by_hand_and_a_client_by_hand(tmp_path, corner):
    words = ("--listen", "tcp://127.0.0.1:*", "--keys", "keys", "--make-keys", "ann", "--run", "world")
    server = start(tmp_path, "serve", "--town", corner, "--seats", 2, *words, *QUICK)
    told = []
    while not any(line.startswith("over the network") for line in told):
        told.append(server.stdout.readline())
        assert told[-1], server.stderr.read()
    addresses = [word for line in told for word in line.split() if word.startswith(("ipc://", "tcp://"))]
    assert [address[:6] for address in addresses] == ["ipc://", "tcp://"]
    for number, address in enumerate(addresses):
        keys = ("--keys", "keys") if address.startswith("tcp") else ()
        learn = ("--steps", 12, "--set", "learn.batch_size=4", "--set", "learn.learning_starts=4")
        client = start(tmp_path, "join", address, "--network", "patch", "--out", f"j{number}", *learn, *keys)
        finished(client, 120)
        assert open_run(tmp_path / f"j{number}").config.cameras[0].width_px == 32
    server.send_signal(signal.SIGINT)
    finished(server, 120)
    assert (tmp_path / "world" / "journal").is_file()
    client = start(tmp_path, "join", addresses[0], "--network", "patch", "--wait", 1)
    _, err = client.communicate(timeout=120)
    assert (client.returncode, "no answer within" in err) == (2, True), err

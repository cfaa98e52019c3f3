"""A run folder, a journal or a key of somebody else: what it names is not run, not followed, not trusted."""

import os
from pathlib import Path

import pytest

from tests.attack.peers.peers import Attacker, a_join, refusal
from tests.server.servers import AHEAD, Server, stand_in_order
from wcsim.agents.clients.client import train_client
from wcsim.agents.runs import transfer
from wcsim.agents.runs.run_folder import MANIFEST, create_run_folder, make_run_manifest, open_run, read_run_json
from wcsim.bridge.replay.replayed import verify
from wcsim.cli.main import _printable, main
from wcsim.core.files import lock_run_folder, write_json
from wcsim.core.plugins import import_class
from wcsim.errors import ConfigError, PolicyError, WcsimError
from wcsim.log.records import Header, header_from_bytes, header_to_bytes, with_fields
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.events import ServerRules
from wcsim.server.specs import ClientProcessSpec, RunInfo, SeatRequest
from wcsim.server.transport.keys import create_missing_keys
from wcsim.towns.scenario.town import Town, streets_hash

HEADER = Header(name="x", town="helsinki", town_sha256="0", config="{}", seed=1, seats=2, tick_s=0.1, fingerprint="f")


@pytest.mark.parametrize("name", ["run/evil:H", "/x/evil:H", "../evil:H", ".evil:H", "evil:H.x", "a b:C", "a:\x1b[31m"])
def test_a_class_is_named_by_words_not_by_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    for file in (tmp_path / "run" / "evil.py", tmp_path / "evil.py"):
        file.write_text("raise SystemExit('it ran')\n", encoding="utf-8")
    with pytest.raises(PolicyError, match="is not module:Class") as caught:
        import_class(name, "step hook")
    assert "\x1b" not in str(caught.value)


def test_a_journals_hook_is_named_on_the_command_line_or_not_loaded(tmp_path: Path) -> None:
    from wcsim.log.writer import LogWriter

    with LogWriter(tmp_path / "journal", with_fields(HEADER, hook="evil:H")):
        pass
    for hook in ("", "other:H"):
        with pytest.raises(ConfigError, match="a hook is code"):
            verify(tmp_path / "journal", None, 0, None, hook=hook)


def test_own_classes_of_a_run_made_elsewhere_are_named_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "mine"))
    classes = transfer.custom_class_names("a:Hook", ("b:Reward",), ("patch", "c:Net"))
    assert classes == ("a:Hook", "b:Reward", "c:Net")
    mark = transfer.sign_custom_classes(classes)
    transfer.require_trusted_classes(tmp_path, classes, mark, ())
    transfer.require_trusted_classes(tmp_path, (), "", ())
    with pytest.raises(PolicyError, match=r"b:Reward"):
        transfer.require_trusted_classes(tmp_path, (*classes, "d:More"), mark, ("a:Hook", "c:Net", "d:More"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "theirs"))
    for theirs in (mark, "", "0" * 64):
        with pytest.raises(PolicyError, match="made elsewhere"):
            transfer.require_trusted_classes(tmp_path, classes, theirs, ())
    transfer.require_trusted_classes(tmp_path, classes, mark, classes)


def test_resume_refuses_a_folder_that_names_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], a_small_run: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text("raise SystemExit('it ran')\n", encoding="utf-8")
    manifest = read_run_json(a_small_run, MANIFEST)
    for changes in ({"hook": "evil:H"}, {"rewards": ["evil:H"]}):
        write_json(a_small_run / MANIFEST, {**manifest, **changes})
        assert main(["resume", str(a_small_run), "--steps", "40"]) == 2
        assert "made elsewhere" in capsys.readouterr().err


def test_a_run_in_use_keeps_its_steps(a_small_run: Path) -> None:
    with lock_run_folder(a_small_run):
        assert main(["resume", str(a_small_run), "--steps", "40"]) == 2
    assert open_run(a_small_run).config.learn.total_steps == 30


@pytest.fixture
def a_small_run(tmp_path: Path, corner: Path, corner_town: Town) -> Path:
    """A run folder as `wcsim train` leaves it, but for its policies."""
    from wcsim.cli.shared.run_config import settings_from_learner
    from wcsim.config import resolve

    config = resolve("dqn", ("learn.total_steps=30", "learn.network=patch"))
    config = resolve(config, settings_from_learner(config))
    words = ("wcsim", "train", "--town", str(corner))
    info = RunInfo(seed=1, town=corner_town.name, town_sha256=streets_hash(corner_town), command=words)
    return create_run_folder(tmp_path / "run", config, make_run_manifest(config, info)).path


@pytest.mark.parametrize("hard", [False, True])
def test_a_folder_with_a_link_is_not_written_to(tmp_path: Path, hard: bool) -> None:
    precious = tmp_path / "precious"
    precious.touch()
    inside = tmp_path / "run" / "deep" / "events.jsonl"
    inside.parent.mkdir(parents=True)
    (tmp_path / "run" / "shared").touch()
    (inside.parent / "shared").hardlink_to(tmp_path / "run" / "shared")
    with lock_run_folder(tmp_path / "run"):  # two names in the folder for one file, as checkpoints have
        pass
    if hard:
        inside.hardlink_to(precious)
    else:
        inside.symlink_to(precious)
    with pytest.raises(PolicyError, match="is a link"), lock_run_folder(tmp_path / "run"):
        pass


def test_a_clients_folder_with_work_and_no_manifest_is_kept(tmp_path: Path) -> None:
    from tests.support.worlds import quick_config

    kept = tmp_path / "patch" / "checkpoints" / "step-00000100"
    kept.mkdir(parents=True)
    join = SeatRequest(endpoint="ipc:///nowhere/x", name="patch", claim="c")
    order = ClientProcessSpec(
        config=quick_config(),
        out=str(tmp_path / "patch"),
        info=RunInfo(seed=1, town="helsinki"),
        join=join,
    )
    with pytest.raises(PolicyError, match="holds data"):
        train_client(order, resume=True)
    assert kept.is_dir()


@pytest.mark.parametrize("changes", [{"seats": 10**9}, {"seats": 0}, {"tick_s": 1e-300}, {"seed": -1}])
def test_a_journals_header_asks_for_no_boundless_world(changes: dict[str, float]) -> None:
    assert header_from_bytes(header_to_bytes(HEADER)) == HEADER
    with pytest.raises(WcsimError, match="expected"):
        header_from_bytes(header_to_bytes(with_fields(HEADER, **changes)))  # type: ignore[arg-type]


def test_a_seat_asked_for_by_number_is_not_an_empty_claims(tmp_path: Path) -> None:
    rules = ServerRules(capacity=2, expected=1, notice_s=60.0)
    with Server(stand_in_order(tmp_path, rules=rules), tmp_path) as server:
        server.status()
        with Attacker(server.order.endpoint) as one, Attacker(server.order.endpoint) as other:
            assert isinstance(one.say(a_join(name="one", claim=b"", seat=1))[0], m.Welcome)
            assert refusal(other.say(a_join(name="other", claim=b"", seat=1))).error == "SeatTakenError"


def test_a_key_that_was_taken_back_is_not_heard_through_an_old_connection(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    create_missing_keys(keys, ("ann", "ben"))
    rules = ServerRules(capacity=2, expected=1, notice_s=60.0)
    with Server(stand_in_order(tmp_path, rules=rules, listen="tcp://127.0.0.1:*", keys=str(keys)), tmp_path) as server:
        network = server.status().listening
        with SocketSeatLink(server.seat("honest")) as honest, Attacker(network, keys, "ben") as ben:
            seen = honest.join()
            assert refusal(ben.say(m.Beat(b"x" * 16, 0))).error == "StaleSessionError"
            (keys / "clients" / "ben.public").unlink()
            for _ in range(200):
                answer = refusal(ben.say(m.Beat(b"x" * 16, 0))).error
                if answer == "AccessError":
                    break
                seen = honest.act(seen.tick, AHEAD)
                honest._socket.poll(20)
            assert answer == "AccessError"
            assert refusal(ben.say(a_join(name="carol"))).error == "AccessError"


def test_what_a_terminal_obeys_is_not_printed() -> None:
    assert _printable("a\x1b[31mb\nc\x9b1m") == "a\\x1b[31mb\nc\\x9b1m"


def test_a_pipe_is_no_entry_of_a_folder_to_follow(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with lock_run_folder(tmp_path):
        pass

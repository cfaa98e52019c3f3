"""What cannot be used is refused in one line, before anything begins, and Ray's own words stay in its log."""

import os
import socket
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.support.cluster.ray_nodes import quiet_environment
from tests.support.cluster.workpieces import (
    always_die,
    answer_with_text,
    echo,
    itself,
    take_in_a_bomb,
)
from wcsim.cli.shared.common import workers_from_options
from wcsim.config import resolve
from wcsim.errors import ConfigError
from wcsim.server.workers import machines, ray_workers
from wcsim.server.workers.cluster_node import MOST_BYTES, collect_machine_info, find_node_mismatch, find_node_warnings
from wcsim.server.workers.machines import WorkInputFiles, WorkPiece, WorkResult
from wcsim.server.workers.ray_workers import RayWorkerPool, _DriverSpec


@pytest.mark.parametrize("address", ["ray://10.0.0.1:10001", "auto", "10.0.0.1", "10.0.0.1:0", "10.0.0.1:70000", "-"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ConfigError, match=r"expected `local`, or HOST:PORT"):
        workers_from_options(address, 1, "--worlds")


def test_nobody_at_an_address_is_told_within_seconds(monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setattr(machines, "_REACH_TIMEOUT_S", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, and nobody listens
        with pytest.raises(ConfigError, match=r"no answer within .*`ray start --head"):
            workers_from_options(f"127.0.0.1:{taken.getsockname()[1]}", 1, "--worlds")


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("wcsim.errors.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'wcsim\[cluster\]'"):
        workers_from_options("local", 1, "--jobs")


def test_the_nodes_say_how_many_work_at_once():
    with pytest.raises(ConfigError, match="--num-cpus"):
        workers_from_options("10.0.0.1:6379", 2, "--jobs")


def test_what_lies_on_this_machine_alone_is_refused():
    from wcsim.agents.runs.transfer import require_sendable_run

    config = resolve("quick")
    require_sendable_run(config, ("env.profile=slow",), ("patch",))
    for own in (
        lambda: require_sendable_run(config, own_code=("own_network:OwnNet",)),
        lambda: require_sendable_run(config, ("chair.plant=my.toml",)),
        lambda: require_sendable_run(config, ('chair.plant="my.toml"',)),
        lambda: require_sendable_run(config, users=("me.toml",)),
        lambda: require_sendable_run(resolve("quick", "collect.profiles=['recorded:mine.csv']")),
    ):
        with pytest.raises(ConfigError, match=r"cannot be sent; expected .* without --cluster"):
            own()


def test_a_node_of_another_version_or_code_is_refused_and_a_small_one_is_not():
    here = collect_machine_info()
    assert find_node_mismatch(here, here) == ""
    assert "code 0000" in find_node_mismatch(here | {"code": "0000"}, here)
    assert "libsumo 9.9" in find_node_mismatch(here | {"libsumo": "9.9"}, here)
    assert "torch none" in find_node_mismatch(here | {"torch": ""}, here)
    assert "wcsim 9.9" in find_node_mismatch(here | {"wcsim": "9.9"}, here)
    assert "wcsim None" in find_node_mismatch({"host": "old"}, here)
    assert "Python 3.99" in find_node_mismatch(here | {"Python": "3.99"}, here)
    small = find_node_warnings(here | {"shm_mib": "64", "cpu": "another"}, here)
    assert "64 MiB" in small[0] and "--shm-size=1g" in small[0] and "another" in small[1]


class _Ray:
    __version__ = "2.60.0"

    @staticmethod
    def remote(**_: int) -> Any:
        return lambda call: call


@pytest.mark.parametrize(
    "error, told",
    [
        (
            RuntimeError(
                "Version mismatch: The cluster was started with:\n    Ray: 2.59.0\n    Python: 3.11.7\n"
                "This process on node x was started with:\n    Ray: 2.60.0\n    Python: 3.11.7\n"
            ),
            r"runs Ray 2\.59\.0 with Python 3\.11\.7; expected Ray 2\.60\.0 .*'ray==2\.59\.0'",
        ),
        (type("AuthenticationError", (Exception,), {})("InvalidAuthToken abc"), r"~/\.ray/auth_token .*chmod 600"),
        (ConnectionError("Could not find a node\nTraceback"), r"ConnectionError: Could not find a node\).*ray start"),
    ],
)
def test_what_ray_says_against_it_becomes_one_line(error, told, tmp_path):
    import re

    spec = _DriverSpec(address="10.0.0.1:6379", count=1, log=tmp_path / "ray.log")
    text = ray_workers._why_not_joined(spec, error, _Ray)
    assert re.search(told, text) and "\n" not in text and "abc" not in text


def test_a_token_that_was_asked_for_is_found_in_what_ray_wrote_for_this_try_alone(tmp_path):
    spec = _DriverSpec(address="10.0.0.1:6379", count=1, log=tmp_path / "ray.log")
    assert ray_workers._read_log(spec.log, 0) == ""
    spec.log.write_text("W 1 Unauthenticated: RPC error: InvalidAuthToken: Authentication token is missing\n")
    before, error = spec.log.stat().st_size, ConnectionError("Failed to connect to Ray cluster")
    assert "~/.ray/auth_token" in ray_workers._why_not_joined(spec, error, _Ray, ray_workers._read_log(spec.log, 0))
    assert "cannot join (ConnectionError" in ray_workers._why_not_joined(
        spec, error, _Ray, ray_workers._read_log(spec.log, before)
    )


@pytest.mark.parametrize("place", ["home", "RAY_AUTH_TOKEN_PATH", "RAY_AUTH_TOKEN", ""])
def test_who_has_a_token_shows_it_and_a_word_of_the_users_own_stays(tmp_path, monkeypatch, place):
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    token = tmp_path / ".ray" / "auth_token"
    if place == "home":
        token.parent.mkdir()
        token.write_text("abc")
    elif place:
        monkeypatch.setenv(place, str(token))
    spec = _DriverSpec(address="10.0.0.1:6379", count=0, log=tmp_path / "log")
    for name in (
        "RAY_USAGE_STATS_ENABLED",
        *ray_workers._START_TIMEOUTS,
    ):  # what is set beside is taken back at the end
        monkeypatch.setenv(name, "1")
    ray_workers._set_environment(spec)
    assert os.environ.get("RAY_AUTH_MODE") == ("token" if place else None)
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    ray_workers._set_environment(spec)
    assert os.environ["RAY_AUTH_MODE"] == "disabled"


@pytest.mark.proof
def test_what_is_malformed_ends_in_a_line_on_live_ray_and_the_next_piece_is_done(tmp_path, monkeypatch, capfd):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'wcsim[cluster]'")
    for name, value in quiet_environment().items():
        monkeypatch.setenv(name, value)
    folder, found = tmp_path / "parcel", {}
    folder.mkdir()
    (folder / "large").touch()
    os.truncate(folder / "large", MOST_BYTES + 1)
    needed = [
        WorkInputFiles(address="p", folder=folder, names=(name,)) for name in ("../cluster/ray.log", "large", "none")
    ]
    works = [WorkPiece(key=one.names[0], call=echo, piece=one, needs=itself) for one in needed]
    calls = (answer_with_text, take_in_a_bomb, always_die, echo)
    works += [WorkPiece(key=call.__name__, call=call, piece="x") for call in calls]
    with closing(RayWorkerPool("local", 1, tmp_path / "cluster", lambda told: None, join_s=300.0)) as workers:
        for work in works:
            workers.begin(workers.names()[0], work)
            until_s = time.monotonic() + 300.0
            while work.key not in found and time.monotonic() < until_s:
                found |= {end.key: end for end in workers.collect(0.2)}
    for key, told in (
        ("../cluster/ray.log", "expected a name below its folder"),
        ("large", "expected at most"),
        ("none", "No such file"),
        ("answer_with_text", "no result"),
        ("take_in_a_bomb", f"more than {MOST_BYTES} bytes"),
    ):
        assert told in str(found[key].error)
    assert found["always_die"].lost and found["always_die"].counts and found["echo"].data == b"x"
    assert capfd.readouterr() == ("", ""), "Ray's words are in its log"


def test_an_answer_that_is_no_result_is_an_error_of_its_piece(monkeypatch):
    monkeypatch.setattr(ray_workers, "MOST_BYTES", 3)
    driver = ray_workers._Driver(_DriverSpec(address="10.0.0.1:6379", count=1, log=Path()), _Ray)
    piece = ray_workers._RunningPiece(worker="a/1", node="n", key="k", since_s=0.0)
    for answer in (None, *(WorkResult(worker="a/1", key="k", data=data) for data in ("x", b"long", b"ok"))):
        driver._settle_with(piece, answer)
    *errors, well = driver._update.results
    assert well.data == b"ok" and len(errors) == 3
    assert all("k: a/1 has answered with" in str(end.error) for end in errors)

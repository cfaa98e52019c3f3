"""Files that hang, fill the memory or end in a traceback where nobody looks at them first."""

import hashlib
import io
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console

from tests.attack.files import files, policies
from tests.attack.scenarios.twists import Data, json_text
from wcsim.agents.learning import saved_policy
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.runs.policy_file import POLICY_JSON, WEIGHTS
from wcsim.agents.runs.run_folder import CONFIG, MANIFEST, open_run, read_run_json
from wcsim.cli.main import main
from wcsim.cli.shared.consoles import print_sumo_overrides
from wcsim.config import TownFile, read_toml, resolve
from wcsim.config.plant import read_plant
from wcsim.config.scene import SceneFile
from wcsim.errors import ConfigError, JournalError, PolicyError
from wcsim.log.framing import frame_payload, iter_whole_records
from wcsim.log.reader import read_trace_states
from wcsim.towns.scenario.overrides import Override
from wcsim.users.recordings.recorded_user import find_user

TOML_BOMBS = {
    "nesting": "a=" + "[" * 5000,
    "a long number": "a=" + "9" * 5000,
    "dots": ".".join("a" * 50_000) + "=1",
    "dots in a table": "[" + ".".join("a" * 50_000) + "]",
    "bytes": "a = '" + "x" * (2 << 20) + "'",
    "no text": "\udcff\udcfe",
}
JSON_BOMBS = {
    "nesting": "[" * 100_000,
    "deep objects": '{"a":' * 5000,
    "a long number": '{"seed": ' + "9" * 5000 + "}",
    "twice": '{"seed": 1, "seed": 2}',
    "a list": "[]",
    "nothing": "",
    "no text": "\udcff\udcfe",
}
Take = Callable[[Path], Any]
TOML_READERS: dict[str, Take] = {
    "config": lambda path: resolve("quick", path),
    "town": lambda path: read_toml(path, TownFile),
    "scene": lambda path: read_toml(path, SceneFile),
    "plant": lambda path: read_plant(str(path)),
}


NAMES = {
    torch.float64: "F64", torch.float16: "F16", torch.bfloat16: "BF16", torch.int8: "I8", torch.bool: "BOOL",
    torch.complex64: "C64", torch.float8_e4m3fn: "F8_E4M3", torch.float8_e5m2: "F8_E5M2",
}  # fmt: skip


def write(path: Path, text: str) -> Path:
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    return path


# --- settings, plants, scenes, towns ---


@pytest.mark.parametrize("bomb", TOML_BOMBS)
@pytest.mark.parametrize("take", TOML_READERS.values(), ids=TOML_READERS)
def test_a_toml_bomb_is_refused_in_one_line(tmp_path: Path, take: Take, bomb: str) -> None:
    with pytest.raises(ConfigError, match=r"bomb\.toml") as caught:
        take(write(tmp_path / "bomb.toml", TOML_BOMBS[bomb]))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("value", ["[" * 5000, "9" * 5000, "{" * 100, "nan", "[" * 40 + "]" * 40])
def test_a_bomb_among_the_words_of_a_command(value: str) -> None:
    for key in ("learn.gamma", "vary.plant", "cameras", "a." * 5000 + "a", "world.tick_s"):
        with pytest.raises(ConfigError, match="--set"):
            resolve("quick", f"{key}={value}")


def places(tmp_path: Path) -> list[Path]:
    """Paths that must not be read, however they are named."""
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    (tmp_path / "folder.toml").mkdir()
    names = ("pipe.toml", "zero.toml", "loop.toml", "folder.toml", "none.toml", "x\0.toml", "a" * 300 + ".toml")
    return [tmp_path / name for name in names]


def test_pipes_devices_and_odd_names_are_no_files(tmp_path: Path) -> None:
    for path in places(tmp_path):
        for take in (*TOML_READERS.values(), lambda path: find_user(f"recorded:{path}")):
            with pytest.raises(ConfigError):
                take(path)
        with pytest.raises(JournalError):
            read_trace_states(path)


@pytest.mark.parametrize("bomb", TOML_BOMBS)
def test_a_broken_town_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bomb: str
) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "scenarios" / "sumo" / "own"
    own.mkdir(parents=True)
    write(own / "town.toml", TOML_BOMBS[bomb])
    assert main(["town", "list"]) == 0
    assert "monaco" in capsys.readouterr().out


# --- runs ---


def a_run(folder: Path) -> Path:
    """A sound run of one client."""
    kind = next(kind for kind in files.families(folder) if kind.name == "run")
    for name, data in (*kind.beside, (kind.file, kind.sound)):
        (folder / name).write_bytes(data)
    open_run(folder)
    return folder


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": "x"}, {"seed": -1}, {"seed": 1 << 70}, {"steps": 1.5}, {"steps": "x"}, {"status": "won"}, {"town": 3},
        {"command": "wcsim"}, {"command": [1]}, {"rewards": {"a": 1}}, {"versions": [1]},
        {"overrides": [{"option": 1}]},
        {"overrides": 3}, {"git_revision": None}, {"hook": ["a"]}, {"more": 1},
        {"clients": "patch"}, {"clients": ["../../x"]}, {"clients": ["a/b"]}, {"clients": [".."]}, {"clients": [""]},
        {"clients": ["a", "a"]}, {"clients": [1]}, {"clients": {"a": 1}}, {"clients": ["\x1b[31m"]},
    ],
)  # fmt: skip
def test_entries_of_a_manifest_have_types_and_bounds(tmp_path: Path, changes: Data) -> None:
    path = a_run(tmp_path) / MANIFEST
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
    with pytest.raises(PolicyError, match=r"manifest\.json: .*" + next(iter(changes))):
        read_run_json(tmp_path, MANIFEST)
    with pytest.raises(PolicyError, match=r"manifest\.json"):
        open_run(tmp_path)


# --- policies ---


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> policies.Sound:
    return policies.sound_policy(tmp_path_factory.mktemp("sound"))


def a_policy(folder: Path, about: Data, weights: bytes) -> Path:
    """A policy whose digest fits."""
    about = {**about, "weights_sha256": hashlib.sha256(weights).hexdigest()}
    (folder / POLICY_JSON).write_text(json_text(about))
    (folder / WEIGHTS).write_bytes(weights)
    return folder


@pytest.fixture
def policy(tmp_path: Path, sound: policies.Sound) -> Path:
    """A sound one."""
    return a_policy(tmp_path, sound.about, sound.weights)


READERS = {MANIFEST: open_run, CONFIG: open_run, POLICY_JSON: load_policy, WEIGHTS: load_policy}


@pytest.mark.parametrize("name", [MANIFEST, CONFIG, POLICY_JSON])
@pytest.mark.parametrize("bomb", JSON_BOMBS)
def test_a_json_bomb_in_a_run_or_policy_is_refused_in_one_line(policy: Path, name: str, bomb: str) -> None:
    write(a_run(policy) / name, JSON_BOMBS[bomb])
    with pytest.raises(PolicyError, match=name.replace(".", r"\.")) as caught:
        READERS[name](policy)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", READERS)
def test_a_device_in_a_copied_run_or_policy_is_not_read(policy: Path, name: str) -> None:
    (a_run(policy) / name).unlink()
    (policy / name).symlink_to("/dev/zero")
    told = "is not a run" if READERS[name] is open_run else "not a policy folder|not a regular file"
    with pytest.raises(PolicyError, match=told):
        READERS[name](policy)


def test_an_entry_that_comes_twice_is_refused(policy: Path) -> None:
    path = policy / POLICY_JSON
    path.write_text('{"window": 1, ' + path.read_text()[1:])
    with pytest.raises(PolicyError, match="'window' occurs twice"):
        load_policy(policy)


@pytest.mark.parametrize(
    "value, dtype",
    [
        (1e300, torch.float64), (0.1, torch.float64), (0.1, torch.float16), (0.1, torch.bfloat16), (1, torch.int8),
        (1, torch.bool), (1 + 2j, torch.complex64), (0.1, torch.float8_e4m3fn), (0.1, torch.float8_e5m2),
    ],
)  # fmt: skip
def test_weights_of_another_type_are_refused(tmp_path: Path, sound: policies.Sound, value: Any, dtype: Any) -> None:
    tensors = {}
    for name, (_, shape, _) in policies.unpacked(sound.weights).items():
        made = torch.full(shape, value, dtype=torch.complex64 if isinstance(value, complex) else torch.float64)
        tensors[name] = (NAMES[dtype], shape, made.to(dtype).contiguous().view(torch.uint8).numpy().tobytes())
    data = policies.packed(tensors)
    data += b" " * max(0, len(sound.weights) - len(data))  # as large as it should be
    with pytest.raises(PolicyError):
        load_policy(a_policy(tmp_path, sound.about, data))
    one = {**policies.unpacked(sound.weights), "advantage.bias": tensors["advantage.bias"]}
    with pytest.raises(PolicyError, match=r"has \d+ bytes|advantage\.bias is"):
        load_policy(a_policy(tmp_path, sound.about, policies.packed(one)))


def test_weights_that_leave_the_finite_numbers_when_used_are_refused(tmp_path: Path, sound: policies.Sound) -> None:
    tensors = {
        name: (kind, shape, torch.full(shape, 3e38).numpy().tobytes())
        for name, (kind, shape, _) in policies.unpacked(sound.weights).items()
    }
    with pytest.raises(PolicyError, match="values that are not finite"):
        load_policy(a_policy(tmp_path, sound.about, policies.packed(tensors)))


@pytest.mark.parametrize(
    "changes",
    [{"hidden": 65_536}, {"network": "fig6"}],
)
def test_a_description_gets_no_memory_before_it_fits_the_weights(
    tmp_path: Path, sound: policies.Sound, monkeypatch: pytest.MonkeyPatch, changes: Data
) -> None:
    built = []
    whole = saved_policy._empty_net

    def watched(*words: Any) -> Any:
        net = whole(*words)
        built.append({str(tensor.device) for tensor in net.state_dict().values()})
        return net

    monkeypatch.setattr(saved_policy, "_empty_net", watched)
    about = {**sound.about, "net": {**sound.about["net"], **changes}, "image_hw_px": [2048, 2048]}
    with pytest.raises(PolicyError, match=r"the network that policy\.json describes"):
        load_policy(a_policy(tmp_path, about, sound.weights))
    assert built == [{"meta"}]


def test_pictures_that_would_fill_the_memory_are_refused(tmp_path: Path, sound: policies.Sound) -> None:
    about = {**sound.about, "image_hw_px": [2048, 2048], "window": 16}
    with pytest.raises(PolicyError, match="image_hw_px"):
        load_policy(a_policy(tmp_path, about, sound.weights))


def test_weights_that_change_between_two_looks_are_read_once(
    policy: Path, sound: policies.Sound, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = []
    spoilt = bytearray(sound.weights)
    spoilt[-1] ^= 0x40
    whole = hashlib.sha256

    def exchanged(data: bytes = b"") -> Any:
        looks.append(len(data))
        (policy / WEIGHTS).write_bytes(bytes(spoilt))  # after the bytes were read, before they are used
        return whole(data)

    monkeypatch.setattr("wcsim.agents.runs.weights.hashlib.sha256", exchanged)
    state = load_policy(policy).net.state_dict()
    told = policies.unpacked(sound.weights)
    assert looks == [len(sound.weights)]
    assert all(state[name].numpy().tobytes() == data for name, (_, _, data) in told.items())


# --- recordings of a world ---


def test_a_recording_that_unpacks_to_far_more_than_it_has_is_refused(tmp_path: Path) -> None:
    trace = next(kind for kind in files.families(tmp_path) if kind.name == "trace").sound
    last = [record.crc for record in iter_whole_records(io.BytesIO(trace))][-1]
    (tmp_path / "trace").write_bytes(trace + frame_payload(bytes(8 << 20), last))
    with pytest.raises(JournalError, match="is damaged at byte"):
        read_trace_states(tmp_path / "trace")


def test_a_policy_with_a_long_name_is_unknown_and_no_traceback() -> None:
    assert main(["test", "a" * 5000, "--town", "monaco"]) == 2


def test_words_of_a_scenario_are_shown_and_not_obeyed() -> None:
    console = Console(markup=False, file=io.StringIO(), width=200)
    rows = (Override(option="[/b]", author="[red]\x1b[2J", wcsim="[/]", why="why"),)
    print_sumo_overrides(console, "own", rows)
    assert "([/b])" in console.file.getvalue()
    print_sumo_overrides(console, "own", rows, verbose=True)
    shown = console.file.getvalue()
    assert "[/b]" in shown and "[red]" in shown and "[/]" in shown and "\x1b" not in shown

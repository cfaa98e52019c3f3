"""`wcsim export`: what it refuses before it drives, and the folder that it leaves."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.agents.export.test_danger_graph import CONFIG, network, ride
from tests.agents.export.test_value_graph import Plain, config_of, saved
from tests.cli.conftest import files_in, parsed
from tests.cli.test_bad_input import refused
from tests.log.drives import tick, write_drive
from wcsim.agents.danger.policy import save_danger
from wcsim.agents.export.export_folder import WRITTEN
from wcsim.agents.export.guard import MEANING
from wcsim.agents.rounds import recorded_ride
from wcsim.agents.rounds.recorded_ride import _RecordedRide
from wcsim.cli.recordings.users import SMALL_CAMERA
from wcsim.cli.training import export
from wcsim.config import resolve
from wcsim.config.run_file import DangerRuleSettings

SEEN = ("cameras.0.width_px=48", "cameras.0.height_px=36", "sensors.odometry=typical", "env.observe_gyro=true")


@pytest.fixture
def policy(folder: Path) -> Path:
    save_danger(folder / "own", network(), DangerRuleSettings(threshold=0.4), CONFIG)
    return Path("own")


def a_drive(folder: Path, *settings: str) -> Path:
    (folder / "a.drive").unlink(missing_ok=True)
    return write_drive(folder / "a.drive", [tick(1)], config=resolve("quick", settings).model_dump_json())


def lacking(told: str) -> list[str]:
    """What a refusal says that is to be typed besides."""
    return shlex.split(told.partition("the same command and ")[2].partition(", or with")[0])


def test_a_missing_extra_is_told_before_anything_is_driven(wcsim, policy, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    monkeypatch.setattr(export, "_ride", lambda _: pytest.fail("it was driven"))
    refused(wcsim("export", policy, "--onnx", "x"), "pip install 'wcsim[train]'")


@pytest.mark.parametrize("name", ["dwa", "dwa@1.5", "follow", "tests.own:Policy"])
def test_what_has_no_network_is_not_exported(wcsim, folder, name):
    refused(wcsim("export", name, "--onnx", "x"), f"{name} has no network", "RUN:phase1", "shipped")
    assert files_in(folder) == set()


def test_a_network_of_two_cameras_drives_without_wcsim_as_it_was_exported(wcsim, folder):
    two = resolve(CONFIG, 'env.camera=["front","rear"]')
    net = network()
    net.spec = net.spec.model_copy(update={"more_cameras": two.cameras[1:]})
    save_danger(folder / "seeing", net, DangerRuleSettings(threshold=0.4), two)
    assert wcsim("export", "seeing", "--onnx", "x").code == 0
    meaning = json.loads(Path("x", MEANING).read_text())
    assert {"depth", "rear_depth", "rear_seg"} < meaning["inputs"].keys() and len(meaning["cameras"]) == 2
    alone = subprocess.run([sys.executable, Path("x", "exported_policy.py")], capture_output=True, text=True)
    assert alone.returncode == 0, alone


def test_a_run_that_is_not_there_is_not_taken_for_a_baseline(wcsim):
    told = wcsim("export", "runs/a", "--onnx", "x")
    refused(told, "runs/a is not a run", "`wcsim train` made")
    assert "dwa" not in told.err and "did you mean" not in told.err
    refused(wcsim("export", "shiped", "--onnx", "x"), "did you mean 'shipped'?")


def test_only_an_earlier_export_is_replaced(wcsim, folder, policy):
    Path("mine").mkdir()
    for name in (*WRITTEN, "notes.txt"):
        Path("mine", name).write_text("kept")
    (folder / "mine" / "__pycache__").mkdir()  # of the loop, once it was imported
    refused(wcsim("export", policy, "--onnx", "mine"), "mine holds notes.txt, which", "new folder")
    assert Path("mine", "notes.txt").read_text() == "kept"


def test_a_recording_without_what_the_network_sees_is_refused_with_all_that_it_lacks(wcsim, folder, policy):
    a_drive(folder, "cameras.0.width_px=16", "cameras.0.height_px=12", "env.classes=wcsim")
    told = wcsim("export", policy, "--onnx", "x", "--ride", "a.drive")
    refused(told, "a.drive lacks inputs of own", "record it again", "wcsim drive --policy own --record")
    words = lacking(told.err)
    assert words[::2] == ["--set"] * (len(words) // 2)
    a_drive(folder, *words[1::2])
    assert "lacks inputs" not in wcsim("export", policy, "--onnx", "x", "--ride", "a.drive").err
    assert not Path("x").exists()


def test_the_page_says_what_a_simulated_users_drive_lacks_for_the_policy_that_ships(wcsim, folder):
    a_drive(folder, *SMALL_CAMERA)
    words = lacking(wcsim("export", "shipped", "--onnx", "x", "--ride", "a.drive").err)
    page = (Path(__file__).parents[3] / "docs" / "export.md").read_text().replace("\\\n", " ")
    (typed,) = [shlex.split(line) for line in page.splitlines() if line.strip().startswith("wcsim users record")]
    assert words and typed[-len(words) :] == words


@pytest.mark.parametrize("same, by, own", [(1.0, "own", True), (1.0, "", True), (0.99, "follow", False)])
def test_a_recording_of_another_policy_is_told_from_one_of_its_own(same, by, own):
    told = export._beside_recording(same, by, "runs/my own")
    assert own == ("wcsim drive --policy 'runs/my own' --record FILE" not in told)


def test_the_reference_of_somebody_elses_drive_is_what_the_policy_chooses_there(wcsim, folder, policy, monkeypatch):
    """And the folder stands alone: its own loop, in a process without wcsim, chooses the same."""
    a_drive(folder, *SEEN)
    ridden = _RecordedRide(seen=tuple(ride(12)), actions=(80,) * 12, delay_ticks=2)
    monkeypatch.setattr(recorded_ride, "recorded_ride", lambda *given: ridden)
    told = wcsim("export", policy, "--onnx", "x", "--ride", "a.drive", "--force")
    assert told.code == 0, told
    assert "0.0% of the actions match the recording, which dwa drove" in told.out
    assert "wcsim drive --policy own --record FILE" in told.out
    with np.load("x/reference.npz") as kept:
        assert len(kept["action"]) == 12 and (kept["action"] != 80).all()
    assert parsed("x/meaning.json")["facts"]["same_as_recorded"] == 0.0
    assert {path.name for path in Path("x").iterdir()} == set(WRITTEN)
    alone = subprocess.run([sys.executable, "-P", "x/exported_policy.py"], capture_output=True, text=True, check=False)
    assert alone.returncode == 0, alone.stderr
    assert alone.stdout.startswith("12 of 12 actions as recorded")


def test_a_network_of_q_learning_is_exported_with_what_it_is_shown_itself(wcsim, folder, monkeypatch):
    saved(folder / "fig6", config_of("fig6", "groups", CONFIG.cameras[0]))
    a_drive(folder, *SEEN)
    told = wcsim("export", "fig6", "--onnx", "x", "--ride", "a.drive")
    refused(told, "a.drive lacks inputs of fig6")
    assert lacking(told.err) == ["--set", "env.observe_gyro=false"], "it has seen five numbers of the IMU in training"
    a_drive(folder, *SEEN, "env.observe_gyro=false")
    seen = tuple({**step, "imu": step["imu"][:5]} for step in ride(12))
    ridden = _RecordedRide(seen=seen, actions=(80,) * 12, delay_ticks=2)
    monkeypatch.setattr(recorded_ride, "recorded_ride", lambda *given: ridden)
    told = wcsim("export", "fig6", "--onnx", "x", "--ride", "a.drive", "--force")
    assert told.code == 0, told
    assert "100.0% of 12 actions match the network, 100.0% match wcsim's policy" in told.out
    assert "the limit of 40 ms" in told.out and "map cells" not in told.out
    meaning = parsed("x/meaning.json")
    assert meaning["action_delay_ticks"] == 2 and list(meaning["inputs"]) == ["depth", "seg", "imu", "joystick"]


def test_a_network_of_somebodys_own_is_exported_by_name_alone(wcsim, folder):
    own = f"{Plain.__module__}:Plain"
    saved(folder / "mine", config_of(own, camera=CONFIG.cameras[0]))
    refused(wcsim("export", "mine", "--onnx", "x"), f"if you trust it, name it: --network {own}")
    refused(wcsim("export", "mine", "--onnx", "x", "--network", "patch"), "name it: --network")
    assert not Path("x").exists()

"""Every shipped scene does what it must show, and does it as its golden trace says."""

import shutil

import pytest

from tests.scenes.pinned import pinned_scenes
from tests.scenes.planted import PLANTED, plant
from tests.support.framing import write_log
from wcsim.cli.scene import find_unmet_expectations
from wcsim.config import read_toml
from wcsim.config.scene import SceneExpectations, SceneFile
from wcsim.log.diff import explain_hash_mismatch, find_golden_difference
from wcsim.log.fingerprint import PACKAGES
from wcsim.log.reader import read_trace_states
from wcsim.log.records import with_fields
from wcsim.scenes.run import TRACE_EVERY, run_in_child
from wcsim.towns.scene_folders.build import GOLDEN, find_scene, list_scenes

NAMES = [folder.name for folder in list_scenes()]
MUST_BE_THERE = {
    "car-at-zebra",
    "cyclist-overtaking",
    "kerb-drop",
    "left-hand-crossing",
    "lowered-kerb",
    "narrow-gate",
    "parked-car-and-sign",
    "pedestrian-crossing",
    "roadworks",
    "rush-hour",
    "slope",
    "turning-bus",
    "two-chairs",
}
MOST_TRACE_BYTES = 300_000


run_pinned = pytest.fixture(scope="module")(pinned_scenes)


def test_all_scenes_are_there():
    assert set(NAMES) >= MUST_BE_THERE
    assert sum((find_scene(name) / GOLDEN).stat().st_size for name in MUST_BE_THERE) < MOST_TRACE_BYTES


@pytest.mark.parametrize("name", NAMES)
def test_scene(name, tmp_path, run_pinned):
    folder = find_scene(name)
    scene = read_toml(folder / "scene.toml", SceneFile)
    facts = run_pinned(folder, tmp_path / "new.trace")
    assert find_unmet_expectations(facts, scene.expect) == ()
    assert scene.expect != SceneExpectations(), "a scene that expects nothing shows nothing"
    assert find_golden_difference(tmp_path / "new.trace", folder / GOLDEN) == ""
    # On every Python and with either PyBullet: a processor or a C library may round otherwise, a package must not.
    note = explain_hash_mismatch(tmp_path / "new.trace", folder / GOLDEN)
    assert not any(f"{package}-" in note for package in PACKAGES)
    assert set(facts) == set(SceneExpectations.model_fields)


def test_every_scene_has_a_planted_fault():
    assert {fault.scene for fault in PLANTED} >= MUST_BE_THERE


@pytest.mark.parametrize(
    "fault",
    [pytest.param(fault, id=fault.scene, marks=() if fault.quick else pytest.mark.proof) for fault in PLANTED],
)
def test_a_planted_fault_turns_a_scene_red(fault, tmp_path, run_pinned):
    folder = tmp_path / fault.scene
    shutil.copytree(find_scene(fault.scene), folder)
    plant(folder, fault)
    facts = run_pinned(folder, tmp_path / "new.trace")
    told = find_unmet_expectations(facts, read_toml(folder / "scene.toml", SceneFile).expect)
    assert any(fault.told in line for line in told), told
    assert find_golden_difference(tmp_path / "new.trace", folder / GOLDEN)


def test_a_fault_is_named_with_what_was_got_and_expected(tmp_path, run_pinned):
    facts = run_in_child(find_scene("kerb-drop"), tmp_path / "a")  # as `wcsim scene run` does
    assert facts == run_pinned(find_scene("kerb-drop"), tmp_path / "b")
    told = find_unmet_expectations(facts, SceneExpectations(crashed=False, max_pitch_deg=(0.0, 1.0)))
    assert len(told) == 2
    assert "crashed is True, expected False" in told[0]
    assert "expected 0 to 1" in told[1]


def test_one_changed_number_is_found(tmp_path):
    golden = find_scene("pedestrian-crossing") / GOLDEN
    header, ticks = read_trace_states(golden)
    plants = ticks[5].plants.copy()
    plants[0, 0] += 1e-9
    other = with_fields(ticks[5], plants=plants, state_hash="0")
    changed = write_log(tmp_path / "a", header, (*ticks[:5], other, *ticks[6:]))
    assert f"tick {ticks[5].tick}" in find_golden_difference(changed, golden)
    assert ticks[5].tick == 6 * TRACE_EVERY

"""Every shipped scene does what it must show, and does it as its golden trace says."""

from __future__ import annotations

import shutil

import pytest

from wcsim.bridge.scene import GOLDEN, run_in_child
from wcsim.bridge.scene_facts import facts_from_line, facts_line, faults
from wcsim.bridge.trace import TickRecord, TraceWriter, read_trace
from wcsim.bridge.trace_diff import difference
from wcsim.cli.main import main
from wcsim.config import SceneExpect, SceneFile, read_toml
from wcsim.towns.scenes import find_scene, list_scenes

NAMES = [folder.name for folder in list_scenes()]


def test_the_two_first_scenes_are_there():
    assert {"pedestrian-crossing", "kerb-drop"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_scene(name, tmp_path):
    folder = find_scene(name)
    scene = read_toml(folder / "scene.toml", SceneFile)
    facts = run_in_child(folder, tmp_path / "new.trace")
    assert faults(facts, scene.expect) == ()
    assert scene.expect != SceneExpect(), "a scene that expects nothing shows nothing"
    assert difference(tmp_path / "new.trace", folder / GOLDEN) == ""
    assert facts_from_line(facts_line(facts)) == facts


def test_a_fault_is_named_with_what_was_got_and_expected(tmp_path):
    facts = run_in_child(find_scene("kerb-drop"), tmp_path / "a")
    told = faults(facts, SceneExpect(crashed=False, max_pitch_deg=(0.0, 1.0)))
    assert len(told) == 2
    assert "crashed is True, expected False" in told[0]
    assert "expected 0 to 1" in told[1]


def test_a_changed_scene_fails_and_is_blessed_again(tmp_path, capsys, monkeypatch):
    folder = tmp_path / "scenes" / "mine"
    shutil.copytree(find_scene("kerb-drop"), folder)
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text.replace('name = "kerb-drop"', 'name = "mine"').replace("0.6]", "0.59]"))
    assert main(["scene", "run", str(folder)]) == 1
    assert "golden" in capsys.readouterr().out
    assert main(["scene", "bless", str(folder)]) == 0
    assert "blessed" in capsys.readouterr().out
    assert main(["scene", "run", str(folder)]) == 0
    assert main(["scene", "bless", str(folder)]) == 0
    assert "unchanged" in capsys.readouterr().out


def test_one_changed_number_is_found(tmp_path):
    golden = find_scene("pedestrian-crossing") / GOLDEN
    header, ticks = read_trace(golden)
    plants = ticks[50].plants.copy()
    plants[0, 0] += 1e-9
    fields = {name: getattr(ticks[50], name) for name in TickRecord.__dataclass_fields__}
    changed = TickRecord(**{**fields, "plants": plants, "state_hash": "0"})
    with TraceWriter(tmp_path / "a", header) as writer:
        for tick in (*ticks[:50], changed, *ticks[51:]):
            writer.append(tick)
    assert f"tick {ticks[50].tick}" in difference(tmp_path / "a", golden)

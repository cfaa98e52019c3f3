"""The golden trace of a scene covers all of its ticks, however long it is."""

import re
import shutil

import pytest

from wcsim.log.diff import find_golden_difference
from wcsim.log.reader import read_trace_states
from wcsim.scenes.run import _run_scene
from wcsim.towns.scene_folders.build import find_scene


@pytest.mark.parametrize("duration_s, ticks", [(0.9, [9]), (1.5, [10, 15]), (1.0, [10])])
def test_a_change_in_the_last_tick_is_told(duration_s, ticks, tmp_path):
    folder = tmp_path / "scene"
    shutil.copytree(find_scene("kerb-drop"), folder)
    file = folder / "scene.toml"
    text = re.sub(r"duration_s = .*", f"duration_s = {duration_s}", file.read_text())
    for name, last_y in (("golden", 0.6), ("changed", -0.6)):
        script = f"script = [[0.0, 0.0, 0.6], [{duration_s - 0.1:.1f}, 0.0, {last_y}]]"
        file.write_text(re.sub(r"joystick = .*", script, text))
        _run_scene(folder, tmp_path / name)
    assert [record.tick for record in read_trace_states(tmp_path / "golden")[1]] == ticks
    assert f"tick {ticks[-1]}: " in find_golden_difference(tmp_path / "changed", tmp_path / "golden")

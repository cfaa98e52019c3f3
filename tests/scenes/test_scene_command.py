"""`wcsim scene`: a scene of one's own from the first file to its golden trace, and what a wrong file is told."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from wcsim.cli.main import main
from wcsim.config.scene import SceneExpectations
from wcsim.core.own_folder import WORK_PREFIX
from wcsim.errors import TownError
from wcsim.scenes.run import _run_scene
from wcsim.scenes.template import write_scene
from wcsim.towns.scene_folders.build import GOLDEN, find_scene

BROKEN = {
    "no nodes": ("street.nod.xml", None, "", r"has 0 files \*\.nod\.xml"),
    "no routes": ("street.rou.xml", None, "", r"has 0 files \*\.rou\.xml"),
    "torn nodes": ("street.nod.xml", r"</nodes>", "", r"street.nod.xml: is not well-formed XML"),
    "no such edge": ("street.rou.xml", "EC CW", "EC XX", r"'XX'.*is not known"),
    "no such thing": ("street.add.xml", r"wcsim\.sign", "wcsim.sgn", r"unknown type 'wcsim.sgn'"),
    "no such user": (
        "scene.toml",
        r"^script = .*",
        'goal_m = [0.0, 5.0]\nprofile = "hero"',
        r"unknown user profile 'hero'",
    ),
    "off the ground": ("scene.toml", r"^start_m = .*", "start_m = [0.0, -90.0]", r"on no ground"),
    "two drivers": ("scene.toml", r"^script", "joystick = [0.0, 0.0]\nscript", r"exactly one of goal_m"),
    "no driver": ("scene.toml", r"^script = .*", "", r"exactly one of goal_m"),
    "times that fall": ("scene.toml", r"\[10\.8", "[0.0", r"times of script must rise"),
    "empty window": ("scene.toml", r"^gave_way = .*", "gave_way = [2, 1]", r"lower bound first"),
    "unknown key": ("scene.toml", r"^crashed", "crushed", r"unknown key 'expect.crushed'"),
}


@pytest.fixture
def here(monkeypatch):
    """Scenes run in the process of the test, where hashes are comparable with one another alone."""
    monkeypatch.setattr("wcsim.scenes.run.run_in_child", _run_scene)


@pytest.mark.usefixtures("here")
def test_a_new_scene_runs_is_blessed_and_then_kept(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["scene", "new", "mine"]) == 0
    told = capsys.readouterr().out
    assert all(word in told for word in ("wcsim scene run mine", "wcsim scene bless mine", "netedit -n"))
    assert main(["scene", "run", "mine"]) == 1
    assert "scene bless mine" in re.sub(r"\s*│\s*│\s*│\s*", " ", capsys.readouterr().out)
    assert main(["scene", "bless", "mine"]) == 0
    assert "blessed, no golden trace before" in capsys.readouterr().out
    assert main(["scene", "run", "mine", "--json", "told.json"]) == 0
    assert json.loads(Path("told.json").read_text())["mine"]["gave_way"] == 1


def test_commands_that_are_told_can_be_typed_as_they_stand(tmp_path, capsys):
    folder = tmp_path / "my scenes"
    assert main(["scene", "new", "mine", "--out", str(folder)]) == 0
    typed = [shlex.split(line) for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    assert [words[:3] for words in typed[::2]] == [["wcsim", "scene", "run"], ["wcsim", "scene", "bless"]]
    assert all(words[3] == str(folder / "mine") for words in typed[::2])
    assert all(Path(word).is_file() for word in typed[1][2::2])


@pytest.mark.proof
def test_a_changed_scene_fails_and_is_blessed_again(tmp_path, capsys):
    folder = tmp_path / "mine"
    shutil.copytree(find_scene("kerb-drop"), folder)
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text.replace('name = "kerb-drop"', 'name = "mine"').replace("0.6]", "0.5]"))
    assert main(["scene", "run", str(folder)]) == 1
    assert "golden" in capsys.readouterr().out
    assert main(["scene", "bless", str(folder)]) == 0
    assert "blessed" in capsys.readouterr().out
    (folder / "scene.toml").write_text((folder / "scene.toml").read_text().replace("crashed = true", "crashed = false"))
    assert main(["scene", "bless", str(folder)]) == 0
    assert "unchanged" in (told := capsys.readouterr().out)
    assert "its [expect] fails: crashed is True" in told


@pytest.mark.usefixtures("here")
def test_a_scene_of_a_family_is_made_and_runs(tmp_path, capsys):
    folder = tmp_path / "look" / "back"
    assert main(["scene", "make", "reversing-off-kerb", "--seed", "2", "--out", str(folder)]) == 0
    told = capsys.readouterr().out
    assert f"wcsim scene run {folder} --film back.webm" in told
    assert f"-n {folder / 'street.nod.xml'}" in told
    assert main(["scene", "run", str(folder), "--json", str(tmp_path / "told.json")]) == 1
    told = json.loads((tmp_path / "told.json").read_text())["back"]  # the folder's name
    assert told["crashed"]
    assert len(told["faults"]) == 1, "only the golden trace is missing"
    assert main(["scene", "make", "reversing", "--out", str(tmp_path / "other")]) == 2
    assert "expected one of: bus-at-corner" in capsys.readouterr().err


def test_a_film_of_a_scene(tmp_path, capsys):
    film = tmp_path / "film.webm"
    assert main(["scene", "run", "kerb-drop", "--film", str(film)]) == 0
    assert film.stat().st_size > 1000
    assert main(["scene", "run", "--film", str(film)]) == 2
    assert "name the scene to film" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["a/b", "..", "", "mit Leerzeichen"])
def test_names_that_are_no_folder_are_refused(tmp_path, name):
    with pytest.raises(TownError, match="cannot be named"):
        write_scene(tmp_path, name)
    assert list(tmp_path.iterdir()) == []


def test_a_scene_that_is_there_stays(tmp_path):
    folder = write_scene(tmp_path, "mine")
    (folder / "scene.toml").write_text("mine")
    with pytest.raises(TownError, match="already exists"):
        write_scene(tmp_path, "mine")
    assert (folder / "scene.toml").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize("fault", BROKEN)
def test_what_is_wrong_with_a_scene_is_said(tmp_path, capsys, request, fault):
    if fault != "off the ground":  # what a process of its own says last comes through it
        request.getfixturevalue("here")
    name, pattern, instead, told = BROKEN[fault]
    folder = write_scene(tmp_path, "mine")
    path = folder / name
    if pattern is None:
        path.unlink()
    else:
        text, count = re.subn(pattern, instead, path.read_text(), flags=re.MULTILINE)
        assert count
        path.write_text(text)
    assert main(["scene", "run", str(folder)]) == 2
    error = capsys.readouterr().err
    assert re.search(told, error), error
    assert str(folder) in error
    assert "Traceback" not in error
    assert WORK_PREFIX not in error.replace(str(folder), "")
    assert not (folder / GOLDEN).exists()


def test_a_town_command_says_what_a_scene_is(tmp_path, capsys):
    folder = write_scene(tmp_path, "mine")
    assert main(["snapshot", str(folder), "--out", str(tmp_path / "x.png")]) == 2
    assert "wcsim scene run" in capsys.readouterr().err


def test_one_broken_scene_does_not_hide_the_others(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = write_scene(tmp_path / "scenarios" / "sumo" / "scenes", "mine")
    (folder / "scene.toml").write_text("name = 3")
    assert main(["scene", "list"]) == 2
    told = capsys.readouterr()
    assert "two-chairs" in told.out
    assert "mine/scene.toml" in told.err


def test_scenes_are_told_by_their_folders_by_which_they_are_found(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = write_scene(tmp_path / "scenarios" / "sumo" / "scenes", "mine")
    text = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(text.replace('name = "mine"', 'name = "nobodys"'))
    assert main(["scene", "list"]) == 0
    assert "mine" in (told := capsys.readouterr().out) and "nobodys" not in told
    facts = dict.fromkeys(SceneExpectations.model_fields, 0)
    monkeypatch.setattr("wcsim.scenes.run.run_in_child", lambda folder, trace: facts)
    assert main(["scene", "run", "mine", "--json", "told.json"]) == 1
    assert list(json.loads(Path("told.json").read_text())) == ["mine"]
    for where in ("a", "b"):
        shutil.copytree(folder, Path(where) / "mine")
    assert main(["scene", "run", "a/mine", "b/mine", "--json", "told.json"]) == 1
    assert list(json.loads(Path("told.json").read_text())) == ["a/mine", "b/mine"]

"""The policy that comes with wcsim: written by a tool, found by its name, refused when it is not what was shipped."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from tests.agents.export.test_danger_graph import CONFIG, network, ride
from tests.support.tracked import ROOT
from wcsim.agents.danger.policy import save_danger
from wcsim.agents.evaluation.suite.run import _identity_of
from wcsim.agents.opening.named_policy import open_named_policy, resolve_policy_config
from wcsim.agents.rounds.train_rounds import LEARNED
from wcsim.agents.runs import policy_file, run_folder
from wcsim.agents.runs.data_folder import write_data_manifest
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest, open_run, policy_folder_from_name
from wcsim.config import CameraConfig, resolve
from wcsim.config.run_file import DangerRuleSettings
from wcsim.core import files
from wcsim.errors import PolicyError
from wcsim.server.specs import RunInfo

TOOL = runpy.run_path(str(ROOT / "tools" / "ship_policy.py"), run_name="tool")
OWN = resolve(CONFIG, "learn.head=danger")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("shipped")
    info = RunInfo(seed=3, town="helsinki", town_sha256="a" * 64, command=("wcsim", "train", "--seed", "3"))
    run = create_run_folder(place / "run", OWN, make_run_manifest(OWN, info))
    save_danger(run.policy("final"), network(), DangerRuleSettings(), OWN)
    rows = {"rows": [{"policy": "own", "crashes_own": 2, "km": 1.5}], "pooled": []}
    (place / "result.json").write_text(json.dumps(rows))
    (place / "here").mkdir()
    (place / "here" / "README.md").write_text("kept\n")
    folder: Path = TOOL["ship"](open_run(place / "run"), ride(4), [place / "result.json"], place / "here", 0.3)
    return folder


@pytest.fixture
def there(made: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(policy_file, "get_shipped_policy_path", lambda: made)
    return made


def test_a_folder_that_was_dropped_there_is_the_policy_of_that_name(there):
    assert {path.name for path in there.iterdir()} == {*policy_file.HELD, policy_file.FILES, "README.md"}
    assert policy_folder_from_name("shipped") == policy_folder_from_name("shipped@0.2") == there
    assert parse_policy_name("shipped").kind == "shipped" and _identity_of("shipped@0.2", "quick")[-1] == 0.2
    policy = open_named_policy("shipped@0.2", resolve_policy_config("shipped", "quick"), 0)
    policy.begin()
    policy.reset()
    assert 0 <= policy.act(ride(1)[0]) < 81


def test_its_card_says_how_it_was_made_and_measured(made):
    card = (made / "MODEL_CARD.md").read_text()
    for word in ("helsinki", "wcsim train --seed 3", "street map", "crashes_own", "| 2 |", "seed | 3", "old 0.3"):
        assert word in card
    assert "No results" in TOOL["card"](open_run(made.parent / "run"), [], 0.3)


def test_its_card_says_where_the_camera_sits_and_its_noise_in_words(made):
    limits = (made / "MODEL_CARD.md").read_text().partition("## Limits")[2]
    assert "the positions above" in limits
    typical = CameraConfig.model_validate({"p_BC_m": [0.3, 0.1, 1.2], "noise": "typical"})
    told = TOOL["camera_told"](typical)
    assert "at x 0.3, y 0.1, z 1.2 m of the chair" in told and "-15 deg up" in told and "noise typical," in told
    own = CameraConfig.model_validate({"noise": {"classes": {"grain_px": 3}}})
    assert "classes.grain_px 3" in TOOL["noise_told"](own) and "Config(" not in TOOL["noise_told"](own)
    card = (ROOT / "wcsim" / "agents" / "shipped" / "MODEL_CARD.md").read_text()
    assert "Config(" not in card and " m of the chair" in card


def test_driving_is_told_by_the_run_that_it_is_of_or_as_it_was_collected(made, tmp_path, monkeypatch):
    words = ("collect.segments=0", "collect.made_towns=4")
    info = RunInfo(seed=3, town="helsinki", command=("wcsim", "train", "--out", "/home/me/a"))
    in_rounds = resolve(OWN, "collect.rounds=2")
    driven = create_run_folder(tmp_path / "a", in_rounds, make_run_manifest(in_rounds, info)).path / "data"
    collected = tmp_path / "mine"
    names = ("1-000-0000", "1-000-0001", "2-000-0000")
    write_data_manifest(driven, in_rounds, {"helsinki": "a" * 64}, {})
    met = resolve(OWN, 'collect.profiles=["slow", "ataxic"]')
    towns = {"corner": "b" * 64, "monaco": "c" * 64}
    write_data_manifest(collected, met, towns, {f"{name}.npz.zst": "d" * 64 for name in names})
    own = resolve(OWN, (*words, f"collect.data={json.dumps([str(driven), str(collected)])}"))
    run = create_run_folder(tmp_path / "b", own, make_run_manifest(own, info))
    collect = "wcsim collect --town corner,monaco --out data/mine"
    told = "  # with the settings in its data.json; SHA-256 of the data "
    first, *by_seed, last = TOOL["commands"](run)
    assert first == last == "wcsim train --out runs/a"
    assert [line.split(told)[0] for line in by_seed] == [
        f"{collect} --seed 1 --segments 2",
        f"{collect} --seed 2 --segments 1",
    ]
    card = TOOL["card"](run, [], 0.3)
    assert "| trained in | helsinki, corner, monaco (streets" in card and "| data | 3 segments" in card
    assert "switch, ataxic; recorded is held out |" in card
    began_with = {str(collected): {f"{names[0]}.npz.zst": "d" * 64}}
    files.write_json(run.path / LEARNED, {"schema_version": 1, "folders": began_with})
    assert [line.split(told)[0] for line in TOOL["commands"](run)[:-1]] == [f"{collect} --seed 1 --segments 1"]
    assert "| data | 1 segments" in TOOL["card"](run, [], 0.3)


def test_what_cannot_be_told_is_known_before_anything_is_exported(tmp_path):
    own = resolve(OWN, f'collect.data=["{tmp_path / "gone"}"]')
    run = create_run_folder(tmp_path / "run", own, make_run_manifest(own, RunInfo(seed=3, town="helsinki")))
    with pytest.raises(PolicyError, match=r"gone/data\.json"):
        TOOL["ship"](run, ride(4), [], tmp_path / "here", 0.3)


@pytest.mark.parametrize("name", policy_file.HELD)
def test_a_file_that_is_not_what_was_shipped_is_refused(there, name):
    kept = (there / name).read_bytes()
    (there / name).write_bytes(kept[:-1] + b"x")
    with pytest.raises(PolicyError, match=f"{name} damaged or replaced"):
        policy_folder_from_name("shipped")
    (there / name).unlink()
    with pytest.raises(PolicyError, match=f"{name} missing"):
        policy_folder_from_name("shipped")
    (there / name).write_bytes(kept)
    assert policy_folder_from_name("shipped") == there


def test_where_none_came_with_wcsim_the_name_is_refused_in_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr(policy_file, "get_shipped_policy_path", lambda: tmp_path)
    with pytest.raises(PolicyError, match=r"this wcsim comes without a policy.*tools/ship_policy\.py RUN"):
        run_folder.policy_folder_from_name("shipped")


def test_what_the_example_says_of_it_is_what_the_page_quotes():
    example, place = ROOT / "examples" / "exported_policy.py", ROOT / "wcsim" / "agents" / "shipped"
    done = subprocess.run([sys.executable, example, place], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    quoted = re.findall(r"`(\d+ of \d+ actions as recorded[^`]*)`", (ROOT / "docs" / "export.md").read_text())
    assert quoted == [done.stdout.strip()]


def test_what_lies_in_this_checkout_is_whole_or_not_there():
    place = ROOT / "wcsim" / "agents" / "shipped"
    if (place / policy_file.FILES).is_file():
        assert policy_file.find_shipped_policy(place) == place
    else:
        assert [path.name for path in place.iterdir()] == ["README.md"]

"""Whatever a user gets wrong: exit code 2, one or two lines that say what to do, and nothing half-written."""

import json
import re
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK, Result, files_in
from tests.cli.towns import FAULTS, TINY_BBOX, broken, tiny_osm

SHORT_TRAINING = (*QUICK, "--set", "learn.total_steps=8", "--set", "learn.phase1_steps=4")
"""A place that cannot be written: below a file. (A folder without write permission stops nobody who is root.)"""


STAGES = ("reading ", "building the ", "street of ", "starting SUMO")


def refused(result: Result, *message: str) -> None:
    """The command ended as it must after a mistake of its user."""
    assert result.code == 2, result
    lines = [line for line in result.err.strip().splitlines() if not line.startswith(STAGES)]
    assert 1 <= len(lines) <= 2, result.err
    assert lines[0].startswith("wcsim: ")
    assert "Traceback" not in result.err
    assert result.out == ""
    for text in message:
        assert text in result.err, result.err


def joined(words: str) -> str:
    return words.replace(" ", "_")


# --- options ---

OPTIONS = {
    "nonsense": ("unknown command 'nonsense'", "demo, train"),
    "town": ("needs a command", "import, make, list, check"),
    "town sell": ("'sell'", "import, make, list, check"),
    "town make x --seed -1": ("--seed -1", "0 to 2147483647"),
    "town make x --seed 2147483648": ("--seed 2147483648",),
    "town make ../x": ("'../x'", "letters, digits"),
    "town make /x": ("'/x'", "letters, digits"),
    "town make scenes": ("'scenes'", "reserved"),
    "town make x --size 20": ("size of 20 m", "300 to 1500"),
    "town make x --size nan": ("size of nan m", "300 to 1500"),
    "town make x --size 1e9": ("size of 1e+09 m", "300 to 1500"),
    "town make x --traffic -1": ("traffic -1", "0 to 10"),
    "town make x --parked 2": ("parked 2", "0 to 1"),
    "town make x --hill 999": ("hill of 999 m", "0 to 200"),
    "train --network fig6": ("version 0.1", "wcsim train-q --network"),
    "replay run --mcap=x": ("version 0.1", "wcsim log convert LOG FILE.mcap"),
    "bench chair": ("version 0.1", "wcsim chair check"),
    "bench camera": ("version 0.1", "python -m benchmarks"),
    "scene dance": ("'dance'", "run, list, bless"),
    "scene bless": ("no scene is named", "wcsim scene bless NAME"),
    "train --seed -1": ("--seed -1", "0 to 2147483647"),
    "train --seed 2147483648": ("--seed 2147483648",),
    "train --worlds 0": ("--worlds 0", "1 to 256"),
    "test --seed -7": ("--seed -7",),
    "snapshot --seed -1": ("--seed -1",),
    "doctor --seed -1": ("--seed -1",),
    "train --preset huge": ("unknown preset 'huge'", "dqn, laptop, paper, quick"),
    "test --preset huge": ("unknown preset 'huge'", "dqn, laptop, paper, quick"),
    "train-q --network huge": ("unknown network 'huge'", "patch"),
    "train-q --network nowhere:Net": ("'nowhere'", "not found"),
    "train-q --reward nowhere": ("'nowhere'", "module:Class"),
    "train --set learn": ("'learn'", "section.key=value"),
    "train --set learn.speed=3": ("unknown key 'learn.speed'",),
    "train --set lern.gamma=0.9": ("unknown key 'lern'",),
    "train --set learn.gamma=1.5": ("learn.gamma", "less than 1", "got 1.5"),
    "train --set learn.total_steps=0": ("learn.total_steps", "got 0"),
    "train --set world.substeps=1": ("world.substeps",),
    "train --set cameras.3.width_px=64": ("cameras",),
    "train-q --set learn.device=tpu": ("learn.device", "expected cpu"),
    "train --set env.profile=ataxic": ("ataxic", "held out"),
    'collect --set collect.profiles=["slow","recorded"]': ("collect.profiles: profile recorded is held out",),
    "train --town helsinki,made:5953": ("--town: town made:5953 is held out", "no network has met"),
    "train --set env.profile=saint": ("unknown user profile 'saint'", "competent"),
    "train --set env.profile=slow": ("""--set 'collect.profiles=["slow"]'""", "wcsim train-q"),
    'train --set collect.profiles=["saint"]': ("unknown user profile 'saint'", "competent"),
    "users record helsinki --out a.drive --set env.profile=slow": ("env.profile", "--profile NAME"),
    "demo --set env.profile=slow": ("""--set 'collect.profiles=["slow"]'""",),
    "collect --set env.profile=slow": ("""--set 'collect.profiles=["slow"]'""",),
    'collect --set collect.profiles=["none.toml"]': ("none.toml",),
    "train --preset dqn": ("learn.head=residual", "preset quick, laptop, best or reward, or wcsim train-q"),
    "train-q --preset quick": ("learn.head=danger", "preset dqn or paper, or wcsim train"),
    "train-clients fig6,patch --set learn.head=danger": ("learn.head=danger", "preset dqn or paper"),
    "train-clients fig6,patch --worlds 2": ("--worlds 2: no clients are tested", "--select-by LIST"),
    "train-clients fig6 --lease 0": ("--lease 0.0", "1.0 to 86400.0"),
    "train-clients ,": ("clients ','", "separated by commas"),
    "train-clients fig6,a/b": ("'a/b'", "module:Class"),
    "train-clients fig6,nonesuch": ("unknown network 'nonesuch'", "patch"),
    "train-clients fig6 --steps 0": ("--steps 0", "1 or more"),
    "train-clients fig6 --config-for patch=x.toml": ("--config-for", "fig6"),
    "train-clients fig6 --config-for fig6=none.toml": ("none.toml", "cannot be read"),
    "train-clients fig6 --set env.profile=ataxic": ("ataxic", "held out"),
    "train-clients fig6 --town monaco": ("test town", "--allow-test-town"),
    "train-clients fig6,patch --steps 9 --select-by nonesuch": ("there is no such list",),
    "train-clients fig6,patch --select-by dev --set learn.phase1_steps=0": (
        "less than 1 steps: set learn.phase1_steps",
    ),
    "train-clients fig6,patch --steps 9 --select-by v1": ("v1: profile ataxic is held out",),
    "train-clients fig6,patch --select-by kpi1 --set learn.phase1_steps=99": ("less than 100 steps",),
    "train-clients fig6,patch --select-by kpi1 --worlds 2": ("tests nothing; leave --worlds out",),
    "train-clients fig6,patch --select-by fig6 --worlds 2": ("tests nothing; leave --worlds out",),
    "serve --seats 0": ("--seats 0", "1 to 64"),
    "serve --seats 2 --expected 3": ("--expected 3", "1 to 2"),
    "serve --listen tcp://192.0.2.1:5555": ("192.0.2.1", "--keys"),
    "serve --listen udp://x": ("tcp://HOST:PORT",),
    "serve --keys k": ("--listen",),
    "serve --make-keys a": ("--keys FOLDER",),
    "serve --listen tcp://127.0.0.1:0 --keys k --make-keys a/b": ("'a/b'",),
    "join ipc:///x --steps 0": ("--steps 0",),
    "join ipc:///x --seat -1": ("--seat -1",),
    "join ipc:///x --set env.profile=ataxic": ("held out",),
    "join ipc:///x --wait 0": ("--wait 0.0",),
    "town run CORNER --seconds 0": ("--seconds 0",),
    "town run CORNER --chairs -1": ("--chairs -1",),
    "town run CORNER --out x --outputs fdc": ("no such output",),
    "town run CORNER --out x --hook nothing": ("not module:Class",),
    "join ipc:///x --preset quick": ("learn.head=danger", "preset dqn or paper"),
    "train --cluster nowhere": ("--cluster", "expected"),
    "collect --cluster nowhere": ("--cluster", "expected"),
    "test --suite dev2 --cluster nowhere": ("--cluster", "expected"),
    "resume nowhere": ("nowhere is not a run", "wcsim train"),
    "test --set world.tick_s=nan": ("world.tick_s",),
    "test --set env.profile=tremor": ("--set env.profile", "--profile NAME"),
    "test --set env={max_steps=5}": ("--set env.max_steps", "--max-steps N"),
    "test --suite dev2 --set env.profile=tremor": ("--set env.profile", "its own user"),
    "test --suite dev2 --set env.max_steps=5": ("--set env.max_steps", "its own step limit"),
    "test --episodes 0": ("--episodes 0", "1 or more"),
    "test --episodes -3": ("--episodes -3",),
    "test --max-steps 0": ("--max-steps 0",),
    "test --profile saint": ("unknown user profile 'saint'", "competent"),
    "test --profile ,": ("--profile ','", "separated by commas"),
    "test --town ,": ("--town ','", "separated by commas"),
    "test nobody": ("nobody is not a run", "wcsim train"),
    "test nobody:final": ("nobody is not a run",),
    "test follow:early": ("module 'follow' was not found", "follow.py"),
    "test follow --profile recorded:none.csv": ("none.csv", "cannot be read"),
    "chair check --plants hover": ("'hover'", "mwd, rwd"),
    "chair check --plants ,": ("--plants",),
    "chair check --hz 95": ("--hz 95", "100 to 1000"),
    "chair check --hz 245": ("--hz 245", "multiple of 10"),
    "chair check --rows flight --workers 1": ("'flight'", "start of a row's name"),
    "chair check --compare-hz 240": ("'240'", "two different rates"),
    "chair check --compare-hz fast": ("'fast'", "whole numbers"),
    "chair check --set learn.gamma=0.9": ("learn.gamma", "[chair] or [imu]"),
    "chair check --set chair.plant=mwd": ("chair.plant", "--plants"),
    "chair check --set chair.v_mx=1": ("unknown key 'chair.v_mx'",),
    "chair check --workers 0": ("--workers 0",),
    "snapshot --width 9": ("9 pixels", "64 to 1920"),
    "snapshot --seconds nan": ("--seconds nan",),
    "snapshot --seconds -1": ("--seconds -1",),
    "snapshot --out picture.jpg": ("picture.jpg", ".png"),
    "video --seconds 0": ("--seconds 0",),
    "video --seconds inf": ("--seconds inf",),
    "video --out film.mp4": ("film.mp4", ".webm"),
    "video --policy nobody": ("nobody is not a run",),
    "video --policy follow --profile saint": ("unknown user profile 'saint'",),
    "video --profile saint": ("unknown user profile 'saint'",),
    "video --set env.profile=slow": ("--set env.profile", "--profile NAME"),
    "look --set env.profile=slow": ("--set env.profile", "wcsim video --profile NAME"),
    "snapshot --set env.profile=slow": ("--set env.profile", "wcsim video --profile NAME"),
    "export nobody --onnx x": ("nobody is not a run",),
    "scene run nowhere": ("unknown scene 'nowhere'", "pedestrian-crossing"),
    "replay nowhere": ("nowhere: is no finished test", "wcsim log play"),
    "log": ("log needs a command", "play, verify, compare, convert"),
    "log verify a": ("a: is not there", "journal"),
    "log convert a x.xml": ("a: is not there", "a run folder, a trace, a journal"),
    "log convert a x.png": ("x.png", ".xml (FCD) or .mcap (ROS 2)"),
    "log play nofolder": ("nofolder: is not there",),
    "log verify nofolder --epoch -1": ("--epoch -1",),
    "demo --suite nowhere": ("there is no such list", "demo, dev"),
    "demo --suite dev2": ("helsinki is a town of the list dev2", "another --train-town"),
}


@pytest.mark.parametrize("words", OPTIONS, ids=joined)
def test_wrong_options_are_refused_at_once(wcsim, folder, corner, words):
    refused(wcsim(*words.replace("CORNER", str(corner)).split()), *OPTIONS[words])
    assert files_in(folder) == set()


REPLAYS = {
    "replay run": ("run: is no finished test", "wcsim test --suite", "wcsim log play"),
    "log verify a --from 3 --to 2": ("--from 3", "0 to 2"),
    "log verify a --from -1": ("--from -1", "0 or more"),
    "watch nowhere": ("nowhere: is not there", "wcsim train-clients"),
    "watch . --port -1": ("--port -1", "0 to 65535"),
    "log convert a x.xml": ("has no trace",),
    "serve --run .": ("not empty", "journal"),
    "log play a": ("a: has no trace and no journal", "a run folder"),
    "log play a --port 99999": ("--port 99999", "0 to 65535"),
    "log verify a --epoch -1": ("--epoch -1", "0 or more"),
}


@pytest.mark.parametrize("words", REPLAYS, ids=joined)
def test_wrong_options_for_runs_that_are_there_are_refused(wcsim, folder, words):
    for name in ("run", "a", "b"):
        Path(name).mkdir()
    refused(wcsim(*words.split()), *REPLAYS[words])
    assert files_in(folder) == {"run", "a", "b"}


@pytest.mark.parametrize(
    "words",
    [
        *("train --steps 9", "train-q --data x", "resume a --seed 1", "train-clients", "train-q --lease=120"),
        *("town import --name x --osm y --lefthand --righthand", "town import --name x --osm y --dem a.tif --hill 5"),
        *("town import --name x --sumocfg y --hill 5", "town import --name x --sumocfg y --seed 3"),
        *("train --bogus 1", "train --seed abc", "train --seed", "test --episodes many", "town check", "town list x"),
        *(
            "town import --name x",
            "town import --name x --sumocfg y --hill 5",
            "town make",
            "town make x --kind star",
            "snapshot a b",
            "doctor --json",
        ),
        *("log compare a", "log compare a b --epoch 1", "log verify a --block 3", "log convert a x.xml --from 3"),
        *("log verify a b", "log play a --json x", "replay a --hook x"),
    ],
)
def test_what_the_parser_refuses_ends_with_2_too(wcsim, folder, words):
    result = wcsim(*words.split())
    assert result.code == 2
    assert "wcsim" in result.err
    assert "Traceback" not in result.err
    assert files_in(folder) == set()


# --- towns ---


@pytest.mark.parametrize("fault", FAULTS)
def test_broken_towns_are_refused_whoever_opens_them(wcsim, folder, corner, fault):
    town = broken(corner, fault, folder.parent / "broken")
    for words in (("train", "--town"), ("test", "--town"), ("snapshot",), ("town", "check")):
        refused(wcsim(*words, town), FAULTS[fault][1])
    assert files_in(folder) == set()


def test_training_and_test_towns_are_kept_apart(wcsim, folder):
    refused(wcsim("train", "--town", "monaco"), "monaco is a test town", "--allow-test-town")
    refused(wcsim("test", "--town", "helsinki"), "helsinki is a training town", "--allow-train-town")
    assert files_in(folder) == set()


def test_a_scenario_of_ones_own_is_tested_in_unless_it_is_a_copy_of_a_training_town(wcsim, folder, corner):
    own = shutil.copytree(corner, folder.parent / "own")
    (own / "town.toml").unlink()
    scenario = next(own.glob("*.sumocfg"))
    words = ("--only", "--episodes", "1", "--max-steps", "3", *QUICK)
    result = wcsim("test", "--town", scenario, *words)
    assert result.code == 0
    assert "1 episode a policy" in result.err and "zero" not in result.out
    known = shutil.copytree(corner, folder / "scenarios/sumo/known")
    text = (known / "town.toml").read_text()
    for split in ("test", "train"):
        (known / "town.toml").write_text(re.sub(r'split = "\w+"', f'split = "{split}"', text))
        result = wcsim("test", "--town", scenario, *words)
        assert result.code == (2 if split == "train" else 0)
    refused(result, "own is a training town: it has the streets of", "--split test", "--allow-train-town")


@pytest.mark.proof
def test_the_town_of_a_run_is_refused_under_any_name(wcsim, corner, tmp_path):
    assert wcsim("train-q", "--town", corner, "--out", "run", *SHORT_TRAINING).code == 0
    renamed = broken(corner, "unknown-key", tmp_path / "renamed")
    (renamed / "town.toml").write_text('name = "elsewhere"\nsplit = "test"\n')
    refused(wcsim("test", "run", "--town", renamed), "was trained in elsewhere", "--allow-train-town")


def test_two_towns_of_one_name_are_not_mixed_up(wcsim, folder, corner, tmp_path):
    other = broken(corner, "unknown-key", tmp_path / "other")
    (other / "town.toml").write_text((corner / "town.toml").read_text())
    refused(wcsim("test", "--town", f"{corner},{other}"), "both named")
    assert files_in(folder) == set()


# --- files ---


def test_configuration_files_are_checked(wcsim, folder, corner):
    for text, message in (
        ("[learn]\nspeed = 3\n", "unknown key 'learn.speed'"),
        ("[learn]\ngamma = 2.0\n", "learn.gamma"),
        ("[learn\n", "is not TOML"),
        ("learn = 3\n", "learn"),
    ):
        Path("own.toml").write_text(text)
        refused(wcsim("train", "--town", corner, "--config", "own.toml"), "own.toml", message)
    refused(wcsim("train", "--town", corner, "--config", "missing.toml"), "missing.toml", "cannot be read")
    assert files_in(folder) == {"own.toml"}


def test_a_run_that_never_began_leaves_no_folder(wcsim, folder, corner):
    words = ("--out", "run", *SHORT_TRAINING, "--set", "learn.mirror=true", "--set", "cameras.0.yaw_deg=9")
    refused(wcsim("train-q", "--town", corner, *words), "set learn.mirror=false")
    assert files_in(folder) == set()


def test_a_run_folder_that_is_none_is_refused(wcsim, folder, corner):
    Path("notes").mkdir()
    Path("notes/manifest.json").write_text("{}")
    Path("list").mkdir()
    Path("list/manifest.json").write_text("[]")
    Path("list/config.json").write_text("{}")
    before = files_in(folder)
    for name in ("notes", "list", "notes:phase1"):
        refused(wcsim("test", name, "--town", corner))
    assert files_in(folder) == before


def test_training_never_writes_over_anything(wcsim, folder, corner):
    Path("full").mkdir()
    Path("full/thesis.tex").write_text("irreplaceable")
    Path("plain").write_text("a file")
    for out in ("full", "plain"):
        refused(wcsim("train-q", "--town", corner, "--out", out, *SHORT_TRAINING), out)
    refused(wcsim("resume", "new"), "new")
    assert files_in(folder) == {"full", "full/thesis.tex", "plain"}
    assert Path("full/thesis.tex").read_text() == "irreplaceable"


@pytest.mark.parametrize(
    "words",
    [
        "train --town {town} --out file/run",
        "train --town {town} --json file/x.json",
        "test --town {town} --json file/x.json",
        "town check {town} --json file/x.json",
        "town check {town} --json .",
        "doctor --town {town} --json file/x.json",
        "snapshot {town} --out file/x.png",
        "video {town} --out file/x.webm",
        "town import --osm file --bbox 1,1,2,2 --name x --out file/x",
    ],
)
def test_places_that_cannot_be_written_are_named_before_the_work(wcsim, folder, corner, words):
    Path("file").write_text("a file, not a folder")
    refused(wcsim(*words.format(town=corner).split()), "--out" if "--out" in words else "--json")
    assert files_in(folder) == {"file"}


def test_a_place_that_turns_out_to_be_closed_is_named_after_the_work(wcsim, folder, corner):
    """/proc says that root may write, and refuses it."""
    for words in (
        ("snapshot", corner, "--seconds", "0", "--width", "64", "--out", "/proc/nowhere/x.png"),
        ("video", corner, "--seconds", "0.1", "--width", "64", "--out", "/proc/nowhere/x.webm"),
    ):
        refused(wcsim(*words), "/proc/nowhere")
    assert files_in(folder) == set()


# --- imports ---


def test_an_import_needs_a_file_and_a_plain_name(wcsim, folder):
    rest = ("--bbox", TINY_BBOX)
    refused(wcsim("town", "import", "--osm", "missing.osm", *rest, "--name", "tiny"), "missing.osm", "no such file")
    Path("tiny.osm").write_text(tiny_osm())
    refused(wcsim("town", "import", "--osm", "tiny.osm", *rest, "--name", "../up"), "'../up'", "letters")
    Path("tiny.osm.pbf").write_bytes(b"\0\0")
    refused(wcsim("town", "import", "--osm", "tiny.osm.pbf", *rest, "--name", "tiny"), "osmium")
    assert files_in(folder) == {"tiny.osm", "tiny.osm.pbf"}


def test_an_import_never_replaces_what_is_no_town(wcsim, folder):
    Path("tiny.osm").write_text(tiny_osm())
    Path("home").mkdir()
    Path("home/thesis.tex").write_text("irreplaceable")
    words = ("town", "import", "--osm", "tiny.osm", "--bbox", TINY_BBOX, "--name", "tiny", "--out", "home")
    refused(wcsim(*words), "home is not empty")
    assert json.dumps(sorted(files_in(folder))) == '["home", "home/thesis.tex", "tiny.osm"]'


@pytest.mark.parametrize(
    "words, message",
    [
        ("", ("needs a source", "--osm FILE", "--bbox", "--sumocfg")),
        ("--osm tiny.osm --bbox=25,60,25.1", ("west,south,east,north",)),
        ("--osm tiny.osm --bbox=a,b,c,d", ("west,south,east,north",)),
        ("--osm tiny.osm --bbox=25.1,60,25,60.1", ("west < east",)),
        ("--osm tiny.osm --bbox=25,60.1,25.1,60", ("south < north",)),
        ("--osm tiny.osm --bbox=nan,nan,nan,nan", ("--bbox",)),
        ("--osm tiny.osm --bbox=-190,60,25.1,61", ("globe",)),
        ("--osm tiny.osm --bbox=4.9,59.9,5.0,60.1", ("bounding box",)),  # somewhere else
        ("--osm tiny.osm --url http://localhost/", ("--url", "download")),
        ("--osm tiny.osm --dem a.tif", ("a.tif", "GeoTIFF")),
        ("--osm tiny.osm --dem tiny.osm", ("tiny.osm", "GeoTIFF")),
        ("--osm tiny.osm --traffic -1", ("--traffic",)),
        ("--osm tiny.osm --parked 2", ("--parked",)),
        ("--osm tiny.osm --hill nan", ("--hill",)),
        ("--osm tiny.osm --hill 5 --max-grade 0.9", ("--max-grade",)),
        ("--osm tiny.osm --per-hour cars=5", ("'cars'", "passenger")),
        ("--osm tiny.osm --per-hour passenger", ("CLASS=NUMBER",)),
        ("--osm tiny.osm --per-hour bicycle=nan", ("CLASS=NUMBER",)),
        ("--osm tiny.osm --per-hour bicycle=-5", ("bicycle",)),
        ("--bbox 24,60,25,61", ("at most 12 km",)),
        ("--bbox 25,60,25.01,60.01 --url ftp://localhost/", ("--url", "http")),
        ("--bbox 25,60,25.01,60.01 --url http://127.0.0.1:9/", ("127.0.0.1:9", "--osm FILE")),
    ],
)
def test_wrong_options_of_an_import_are_refused(wcsim, folder, words, message):
    Path("tiny.osm").write_text(tiny_osm())
    refused(wcsim("town", "import", *words.split(), "--name", "tiny"), *message)
    assert files_in(folder) == {"tiny.osm"}

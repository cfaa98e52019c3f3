"""What the commands do when all is well, in a folder of the user's own."""

import gzip
import json
import math
import re
import shutil
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import cv2
import pytest

from tests.cli.conftest import QUICK, Result, files_in
from tests.cli.towns import TINY_BBOX, tiny_osm
from tests.view.films import frames_of
from wcsim.agents.evaluation.suite.make import town_list
from wcsim.agents.opening.list_file import write_list
from wcsim.cli import doctor
from wcsim.physics import engine
from wcsim.towns.scenario.town import find_town
from wcsim.view.street_pictures import StillPictures

BASELINES = ("follow", "random", "zero", "stop", "dwa", "oracle-visible", "oracle")
TOWN_KEYS = {
    *("town", "crossings", "walkingareas", "walkable_largest_share", "classes", "unroutable"),
}
COLUMNS = 80
NEW = "note: made the folder new\n"
STAGES = ["reading", "building", "adding", "building", "checking", "testing", "testing"]  # an import's lines


def read(path: str | Path) -> Any:
    """A JSON file; a NaN in it is a fault."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in {path}")

    return json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=refuse)


def done(result: Result, note: str = "") -> None:
    """All went well, and nothing else was said."""
    assert (result.code, result.err) == (0, note)


def well(result: Result) -> None:
    """All went well and quietly, and the table can be read."""
    done(result)
    assert fits(result.out)


def fits(text: str) -> bool:
    """Whether a table can be read at 80 columns: nothing wider, nothing cut off."""
    return max(len(line.rstrip()) for line in text.splitlines()) <= COLUMNS and "…" not in text


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the town of `tiny` is kept once it has been imported."""
    return tmp_path_factory.mktemp("imported") / "tiny"


@pytest.fixture
def tiny(wcsim, imported) -> Path:
    """A test town imported from a tiny extract."""
    town = Path("towns/tiny")
    if imported.is_dir():
        return Path(shutil.copytree(imported, town))
    Path("tiny.osm.gz").write_bytes(gzip.compress(tiny_osm().encode()))
    words = ("--bbox", TINY_BBOX, "--name", "tiny", "--split", "test", "--out", "towns/tiny")
    made = wcsim("town", "import", "--osm", "tiny.osm.gz", *words)
    assert made.code == 0
    assert [line.split()[0] for line in made.err.splitlines() if " after " not in line] == STAGES
    assert "sumo-gui -c towns/tiny/tiny.sumocfg" in made.out
    shutil.copytree(town, imported)
    return town


def test_town_list_shows_the_shipped_towns_and_ones_own(wcsim, corner):
    result = wcsim("town", "list")
    done(result)
    shown = re.findall(r"(\w[\w-]*) +│ (train|test|scene) ", result.out)
    assert shown == [("helsinki", "train"), ("karhula", "train"), ("manhattan", "test"), ("monaco", "test")]
    assert fits(result.out)
    Path("scenarios/sumo").mkdir(parents=True)
    Path("scenarios/sumo/bay-corner").symlink_to(corner)
    assert "bay-corner" in wcsim("town", "list").out


def test_town_check_reports_and_writes_its_keys(wcsim, folder, corner):
    result = wcsim("town", "check", corner, "--json", "new/check.json")
    done(result, NEW)
    # A note has a command to be typed, which is not wrapped.
    table, _, notes = result.out.partition("note: ")
    assert fits(table) and "SUMO warns" in notes
    report = read("new/check.json")
    assert set(report) >= TOWN_KEYS
    assert (report["town"], report["unroutable"]) == ("pedestrian-crossing", 0)
    assert report["crossings"] >= 1 <= report["walkingareas"]
    assert 0.0 < report["walkable_largest_share"] <= 1.0
    assert "pedestrian" in report["classes"]
    assert files_in(folder) == {"new", "new/check.json"}
    Path("plain").touch()
    assert Path("new/check.json").stat().st_mode == Path("plain").stat().st_mode, "no more private than other files"


def test_scene_list_says_what_each_shows(wcsim):
    result = wcsim("scene", "list")
    well(result)
    assert {"kerb-drop", "pedestrian-crossing"} <= set(re.findall(r"│ ([\w-]+)", result.out))


def test_test_writes_what_is_promised(wcsim, folder, corner):
    words = ("--episodes", "2", "--max-steps", "8", "--profile", "slow,tremor", "--seed", "4", "--json", "t.json")
    ended = wcsim("test", "follow", "--town", corner, *words, *QUICK)
    assert ended.code == 0
    assert fits(ended.out)
    words_shown = ("score", "asked", "crash", "95 %")
    for text in ("seed-4: pedestrian-crossing, slow user", "tremor user", "SIMULATION ONLY", *words_shown):
        assert text in ended.out
    result = read("t.json")
    assert (result["suite"], result["set"]) == ("pedestrian-crossing", "seed-4")
    rows = result["rows"]
    parts = [f"pedestrian-crossing, {user} user" for user in ("slow", "tremor")]
    assert [(row["policy"], row["part"]) for row in rows] == [(name, part) for name in BASELINES for part in parts]
    for row in rows:
        assert row["episodes"] == 2
        assert row["kpi2"] <= 8
        assert 0.0 <= row["kpi1"] <= math.sqrt(8.0)
        assert row["false_warnings_per_km"] is None, "a few metres say nothing about a kilometre"
    follow, random = rows[0], rows[2]
    assert follow["followed"] > 0.9 > random["followed"]
    assert wcsim("test", "random", "--town", corner, "--only", *words, *QUICK).code == 0
    again = [row for row in rows if row["policy"] in ("follow", "random")]
    assert read("t.json")["rows"] == again, "equal seeds give equal results"
    assert files_in(folder) == {"t.json"}


def test_a_test_of_a_town_that_is_kept_is_a_list_of_its_own(wcsim, corner):
    """It goes on, is driven again and reported as any list."""
    words = ("--town", corner, "--episodes", "2", "--max-steps", "8", "--only", "--out", "kept")
    assert wcsim("test", *words, *QUICK).code == 0
    kept = read("kept/episodes.json")["follow"]
    assert [(record["block"], record["steps"], record["status"]) for record in kept] == [
        *((number, 8, "timed_out") for number in (0, 1))
    ]
    assert "--resume" in wcsim("test", *words, *QUICK).err
    again = wcsim("test", *words, *QUICK, "--resume")
    assert again.code == 0 and "blocks" not in again.err and read("kept/episodes.json")["follow"] == kept
    played = wcsim("test", "follow", "--suite", "kept/list.json", "--play", "1.0", "--out", "kept")
    assert played.code == 0 and "the same as the saved one" in " ".join(played.out.split())
    assert "--out FOLDER" in wcsim("test", "--town", corner, "--resume", "--only").err


def test_long_names_of_policies_are_shown_whole(wcsim, corner, tmp_path):
    run = tmp_path / "a-run-with-a-long-name-in-a-deep-folder" / "helsinki-paper-1"
    small = ("--set", "learn.total_steps=8", "--set", "learn.phase1_steps=4", *QUICK)
    trained = wcsim("train-q", "--town", corner, "--out", run, "--json", "train.json", *small)
    assert trained.code == 0
    assert read("train.json") == {"run": str(run), "town": "pedestrian-crossing", "seed": 0}
    words = ("--town", corner, "--allow-train-town", "--only", "--episodes", "1", "--max-steps", "5", *QUICK[:2])
    result = wcsim("test", run, f"{run}:phase1", run / "policies" / "final", *words, "--json", "t.json")
    assert result.code == 0
    assert fits(result.out)
    shown = "".join(re.sub(r"(\s+[\d.%-]+){9}\s*$", "", line).strip() for line in result.out.splitlines())
    for name in (str(run), f"{run}:phase1", str(run / "policies" / "final")):
        assert name in shown
    assert len(read("t.json")["pooled"]) == 3 + len(("follow",))


HOW = ("low", "high", "method", "source", "ok", "note", "judged")


def test_chair_check_gives_rows_beside_their_ranges(wcsim):
    result = wcsim("chair", "check", "--rows", "mass,stopping_6", "--workers", "1", "--json", "chair.json")
    well(result)
    plants = read("chair.json")["plants"]
    assert set(plants) == {"rwd", "mwd"}
    for plant in plants.values():
        assert [row["name"] for row in plant["rows"]] == ["mass", "stopping_6kmh"]
        for row in plant["rows"]:
            assert set(row) == {"name", "value", "unit", "bound", *HOW}
            assert row["low"] <= row["value"] <= row["high"] and row["ok"]


def test_chair_check_takes_settings_and_leaves_out_what_is_too_fast(wcsim):
    plant = str(Path(__file__).parents[2] / "examples" / "fwd.toml")
    words = ("--set", "chair.yaw_rate_max_radps=1.0", "--rows", "turn_in,cruise_road", "--workers", "1", "--json", "x")
    result = wcsim("chair", "check", "--plants", plant, *words)
    assert result.code == 0 and fits(result.out.partition("\n")[2])
    assert "left out" in result.err and "cruise_road" in result.err
    (row,) = read("x")["plants"][plant]["rows"]
    assert row["value"] == pytest.approx(1.0, rel=0.03) and row["bound"] == "stick"


def test_chair_check_ends_with_1_when_a_row_is_red(wcsim, monkeypatch):
    monkeypatch.setattr(engine, "GRAVITY_MPS2", 9.0)
    result = wcsim("chair", "check", "--plants", "rwd", "--rows", "mass", "--workers", "1")
    assert result.code == 1 and "RED" in result.out


def test_chair_check_compares_rates(wcsim):
    words = ("--plants", "rwd", "--rows", "mass", "--workers", "1", "--compare-hz", "120,240", "--json", "rates.json")
    result = wcsim("chair", "check", *words)
    well(result)
    (row,) = read("rates.json")["plants"]["rwd"]["rows"]
    assert row["ok"] and row["change"] < 0.001 and len(row["values"]) == 2


def test_chair_check_draws_the_plants(wcsim):
    result = wcsim("chair", "check", "--plants", "mwd", "--pictures", "drawn")
    done(result)
    picture = cv2.imread("drawn/plant_mwd.png")
    assert picture.shape[0] > 800 and len({tuple(pixel) for pixel in picture[::7, ::7].reshape(-1, 3)}) > 5


def test_snapshot_is_a_picture_of_the_right_size(wcsim, folder, corner):
    result = wcsim("snapshot", corner, "--seed", "2", "--seconds", "1", "--width", "96", "--out", "new/shot.png")
    done(result, NEW)
    assert result.out.startswith("new/shot.png: ")
    picture = cv2.imread("new/shot.png")
    assert picture.shape == (72, 3 * 96, 3)
    assert picture.std() > 5.0
    assert files_in(folder) == {"new", "new/shot.png"}


def test_video_holds_all_its_frames(wcsim, folder, corner):
    result = wcsim("video", corner, "--seconds", "1.5", "--width", "80", "--out", "new/film.webm")
    done(result, NEW)
    frames = frames_of("new/film.webm")
    assert len(frames) == 15
    assert frames[0].shape == (60, 80 + 60, 3)
    assert (frames[0] != frames[-1]).any()
    assert files_in(folder) == {"new", "new/film.webm"}


def test_a_video_without_a_policy_shows_the_user_who_was_asked_for(wcsim, corner):
    for words, who in (((), "competent"), (("--profile", "slow"), "slow")):
        result = wcsim("video", corner, "--seconds", "0.2", "--width", "80", *words)
        assert result.code == 0 and result.out.endswith(f"0.2 s, the user {who}\n")


def test_settings_are_laid_over_those_of_pictures_and_films(wcsim, folder, corner):
    wrong, slow = ("--set", "chair.plant=none-of-these.toml"), ("--set", "chair.v_max_mps=0.2")
    shows = {"snapshot": ("--width", "80"), "look": (), "video": ("--width", "80"), "video --policy follow": ()}
    for words, more in shows.items():
        result = wcsim(*words.split(), corner, *more, *wrong, "--seconds", "0.3")
        assert result.code == 2 and "none-of-these.toml" in result.err
    assert files_in(folder) == set()
    for words in ("video", "video --policy follow"):
        result = wcsim(*words.split(), corner, "--width", "80", *slow, "--seconds", "0.5", "--out", "slow.webm")
        assert result.code == 0
        assert len(frames_of("slow.webm")) == 5


def test_look_takes_a_picture_and_a_video_of_a_town(wcsim, folder, corner):
    result = wcsim("look", corner, "--seconds", "0.3", "--out", "new")
    done(result, NEW)
    name = find_town(str(corner)).name
    made = [f"new/{name}-street.png", f"new/{name}.png", f"new/{name}.webm"]
    assert [line.split(": ")[0] for line in result.out.splitlines()] == made
    assert files_in(folder) == {"new", *made}
    street = cv2.imread(made[0])
    assert street.shape == (540, 960, 3) and street.std() > 20.0


def test_look_shows_no_chair_that_still_turns_towards_its_way(wcsim, corner, monkeypatch):
    faces = chain([False, False], repeat(True))  # at the beginning, and after each tick
    monkeypatch.setattr(StillPictures, "on_way", property(lambda stills: next(faces)))
    result = wcsim("look", corner, "--seconds", "0.3")
    assert result.code == 0 and not re.search(r"after 0\.[01] s", result.out)


def test_doctor_finds_this_machine_well(wcsim, corner, monkeypatch):
    monkeypatch.setattr(doctor, "TICK_SECONDS", 0.2)
    result = wcsim("doctor", "--town", corner, "--json", "d.json")
    well(result)
    found = read("d.json")
    assert [*found] == ["python", "packages", "sumo", "threads", "shared memory", "tick rate", "cache"]
    assert not found["cache"]["says"].startswith("0 streets"), "that of the town is in it by now"
    assert all(item["ok"] for item in found.values())


def test_doctor_says_what_fails(wcsim):
    result = wcsim("doctor", "--town", "atlantis")
    assert result.code == 2
    assert "FAILS" in result.out
    assert "unknown town 'atlantis'" in result.out


def test_demo_trains_tests_and_films_it(wcsim, folder, corner, tiny):
    small = ("collect.segments=1", "collect.ticks=20", "collect.chairs=2", "collect.scene_share=0", "danger.updates=4")
    words = [word for text in (*small, "world.warmup_s=5", "cameras.0.width_px=40") for word in ("--set", text)]
    write_list(town_list([find_town(str(tiny))], ("ataxic",), 2, 10, 0), folder / "two.json")
    done = wcsim("demo", "--train-town", corner, "--suite", "two.json", *words)
    assert done.code == 0
    result = read("runs/demo/test/result.json")
    assert [row["policy"] for row in result["rows"]] == ["follow", "zero", "runs/demo"]
    for message in ("1 round of 1 x 20 ticks with 2 chairs", "4 updates", "2 drives: by the user alone", "--policy"):
        assert message in " ".join(done.out.split())
    assert fits("\n".join(line for line in done.out.splitlines() if "/" not in line))
    assert not re.search(r"[^\n\x20-\x7e\u2500-\u257f]", done.out + done.err), "piped, so nothing that a terminal obeys"
    assert "minutes" not in done.out, "it takes what its settings make it take"
    assert len(re.findall(r"^\S+: [12] of 2 blocks.*left$", done.err, re.MULTILINE)) >= 3
    film = cv2.VideoCapture("runs/demo/alone_and_with_help.webm")
    assert (film.get(cv2.CAP_PROP_FRAME_COUNT), film.get(cv2.CAP_PROP_FRAME_WIDTH)) == (10 + 20, 2 * 560)
    page = Path("runs/demo/demo.html").read_text(encoding="utf-8")
    assert "runs/demo/demo.html" in done.out and "data:video/webm;base64," in page
    assert page.count("<tr>") == 1 + 3, "of one table"
    assert "Of 2 drives, the user crashed in" in page and "Of 2 drives, the user crashed in" in done.out


def test_a_video_of_a_policy_holds_all_its_frames(wcsim, folder, corner):
    words = ("--seconds", "0.8", "--width", "80", "--policy", "follow", "--out", "film.webm")
    result = wcsim("video", corner, *words)
    assert result.code == 0 and "follow assists the user inattentive" in result.out
    assert len(frames_of("film.webm")) == 8
    later = wcsim("video", corner, *words, "--start", "0.5")
    assert later.code == 0 and "0.8 s after 0.5 s, follow" in later.out
    assert len(frames_of("film.webm")) == 8
    assert wcsim("video", corner, *words, "--start", "-1").code == 2

"""`wcsim users fit`: a profile is written that other commands take, and drives that cannot be fitted are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import parsed
from tests.cli.test_bad_input import refused
from tests.log.drives import write_drive
from tests.support.samples import write_recording
from tests.users.recordings.plane_drives import plane_drive
from tests.users.recordings.test_fit_sticks import driven
from wcsim.users.profiles import _read_profile, find_builtin_profile


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    made = plane_drive(replace(find_builtin_profile("slow"), reaction_s=0.8), 45.0, 3)
    return write_drive(tmp_path_factory.mktemp("drives") / "slow.drive", list(made.ticks))


def test_a_drive_is_fitted_and_its_profile_taken(wcsim, drive):
    result = wcsim("users", "fit", drive, "--out", "my user.toml", "--base", "slow", "--json", "told.json")
    assert result.code == 0, result
    assert "reaction_s" in result.out
    hint = result.out.rpartition("try it: ")[2].strip()
    assert hint == "wcsim test --profile 'my user.toml' --only --episodes 1 --max-steps 600", "a minute, not an hour"
    assert "only 4" in result.err and "tremor" in result.out
    written = parsed("told.json")
    assert written["estimates"]["reaction_s"]["value"] == pytest.approx(0.8, abs=0.05)
    assert written["estimates"]["reaction_s"]["told"] is True
    made = _read_profile(Path("my user.toml"))
    assert (made.name, made.lookahead_m, made.spread) == ("my-user", 0.9, 0.0)
    assert made.reaction_s == pytest.approx(0.8, abs=0.05)
    assert "# 95 %: " in Path("my user.toml").read_text()


def test_a_folder_of_stick_tables_is_a_person(wcsim):
    for number, name in enumerate(("ann", "bob", "eve")):
        Path(name).mkdir()
        stick = driven(replace(find_builtin_profile("competent"), noise=0.01), number, 45.0)
        write_recording(Path(name) / "drive.csv", 0.02 * np.arange(len(stick)), stick)
    result = wcsim("users", "fit", "ann", "bob", "eve/drive.csv", "--out", "us.toml", "--json", "told.json")
    assert result.code == 0, result
    written, made = parsed("told.json"), _read_profile(Path("us.toml"))
    assert (made.name, made.reaction_s) == ("us", 0.25) and made.lag_s == pytest.approx(0.12, rel=0.2)
    assert written["estimates"]["lag_s"]["n"] == 3 and "noise" not in written["habits"]["tremor"]
    assert all(who in result.out for who in ("fitted", "inattentive")) and "person eve/drive.csv" in written["habits"]
    Path("none").mkdir()
    refused(wcsim("users", "fit", "none", "--out", "a.toml"), "none: 0 s in .csv or .csv.gz files; expected 30 s")
    refused(wcsim("users", "fit", "ann", "no.csv", "--out", "a.toml"), "no.csv: cannot be read")


def test_what_cannot_be_fitted_is_refused(wcsim, drive):
    write_drive(Path("short.drive"), list(plane_drive(find_builtin_profile("competent"), 2.0, 1).ticks))
    Path("notes.txt").write_text("hello")
    Path("mine.toml").write_text("changed by hand")
    before = sorted(Path().iterdir())
    for words, message in (
        (("short.drive", "--out", "a.toml"), ("no episode of 5 s or more", "drive longer")),
        (("notes.txt", "--out", "a.toml"), ("notes.txt: is not a log",)),
        (("none.drive", "--out", "a.toml"), ("none.drive: cannot be read",)),
        ((drive, "--out", "a.txt"), ("expected a file name that ends in .toml",)),
        ((drive, "--out", "mine.toml"), ("--out mine.toml exists; expected the name of a new file",)),
        ((drive, "--out", "a.toml", "--base", "drunk"), ("unknown user profile 'drunk'",)),
        ((drive, "--out", "a.toml", "--without-intents"), ("unknown town 'nowhere'",)),
    ):
        refused(wcsim("users", "fit", *words), *message)
    assert sorted(Path().iterdir()) == before and Path("mine.toml").read_text() == "changed by hand"

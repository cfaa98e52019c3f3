"""What a page may ask for: what it was offered, and no file of its own choice."""

from dataclasses import replace
from pathlib import Path

import pytest

from wcsim.drive.starting import DriveStart, check_offered
from wcsim.errors import ConfigError

BEGUN = DriveStart(town="/home/me/own/own.sumocfg", profile="recorded:mine.drive", suite="/home/me/list.json")


@pytest.mark.parametrize(
    "asked",
    [
        BEGUN,
        DriveStart(town="helsinki", profile="tremor", seed=4),
        DriveStart(town="monaco", profile="", suite="guard", block=2),
    ],
)
def test_what_is_on_the_page_and_what_the_drive_began_with_may_be_asked_for(asked: DriveStart) -> None:
    assert check_offered(asked, BEGUN) == asked


@pytest.mark.parametrize(
    "key, file",
    [
        ("profile", "recorded:/etc/passwd"),
        ("profile", "/home/other/own.toml"),
        ("town", "/home/other/own.sumocfg"),
        ("town", "../../somewhere"),
        ("suite", "/home/other/list.json"),
    ],
)
def test_a_page_names_no_file_and_does_not_hear_whether_it_is_there(tmp_path: Path, key: str, file: str) -> None:
    (tmp_path / "there.toml").write_text("")
    told = []
    for name in (file, str(tmp_path / "there.toml"), str(tmp_path / "not-there.toml")):
        with pytest.raises(ConfigError, match="is not one that the page offers") as caught:
            check_offered(replace(DriveStart(), **{key: name}), DriveStart())
        told.append(str(caught.value).replace(name, "NAME"))
    assert told[1].split("is not one")[1] == told[2].split("is not one")[1]

"""Hostile files about people: studies, users' profiles, and drives that somebody recorded."""

from pathlib import Path

from tests.attack.files.family import Family, modelled
from tests.attack.files.files import logged
from tests.attack.scenarios.twists import toml_text, without_none
from tests.log.drives import tick, write_drive
from tests.support.framing import write_log
from wcsim.config import parse_json, read_toml
from wcsim.config.study import StudyFile
from wcsim.log.drive import DriveRecording, read_drive
from wcsim.log.reader import is_log_file, read_header
from wcsim.log.records import Note, header_to_bytes, record_to_bytes
from wcsim.users.profiles import _read_profile, profile_to_toml

STUDY = {
    "name": "a-study",
    "title": "Two ways",
    "told": ["What it is about."],
    "policy": "dwa",
    "pause_s": 2.0,
    "places": [{"town": "helsinki", "seed": 3}, {"suite": "guard", "block": 2, "seat": 0}],
    "blocks": [
        {"name": "alone", "title": "Alone", "told": ["Drive."], "assistance": False, "minutes": 1.0},
        {"name": "helped", "title": "Helped", "assistance": True, "level": 1.5, "minutes": 2.0, "arrivals": 3},
    ],
    "questions": [
        {"name": "safe", "asks": "Was it safe?", "kind": "scale", "low": "no", "high": "yes", "steps": 5},
        {"name": "again", "asks": "Again?", "kind": "yes_no", "after": "end"},
        {"name": "which", "asks": "Which one?", "kind": "choice", "choices": ["one", "two"]},
    ],
}
PROFILE = {"base": "ataxic", "reaction_s": 0.4, "noise": 0.1, "tremor_hz": 4.0, "gain": [0.9, 1.1], "bias": [0.0, 0.05]}


def families(work: Path) -> list[Family]:
    """All kinds of files about people."""
    return [
        modelled("study", "study.toml", STUDY, _take_study),
        modelled("profile", "u.toml", PROFILE, _take_profile),
        logged("drive", "a.drive", sound_drive(work / "sound.drive"), _take_drive),
    ]


def _take_study(path: Path) -> bool:
    study = read_toml(path, StudyFile)
    path.write_text(toml_text(without_none(study.model_dump(mode="json"))), encoding="utf-8")
    return read_toml(path, StudyFile) == study == parse_json(StudyFile, study.model_dump_json(), "again")


def _take_profile(path: Path) -> bool:
    user = _read_profile(path)
    path.write_text(profile_to_toml(user, {}), encoding="utf-8")
    return _read_profile(path) == user


def _take_drive(path: Path) -> bool:
    """What is read and recorded again is the same; what is no drive for one reader is none for the others."""
    drive = read_drive(path)
    if not is_log_file(path) or read_header(path) != drive.header:
        return False
    path.unlink()
    again = read_drive(write_log(path, drive.header, (*drive.events, *drive.ticks)))
    return _payloads(again) == _payloads(drive)


def _payloads(drive: DriveRecording) -> list[bytes]:
    return [header_to_bytes(drive.header), *map(record_to_bytes, (*drive.events, *drive.ticks))]


def sound_drive(path: Path) -> bytes:
    events = (Note(tick=2, time_s=0.2, kind="help", detail="the user asks for help"),)
    data = write_drive(path, [tick(number) for number in range(1, 5)], events).read_bytes()
    path.unlink()
    return data

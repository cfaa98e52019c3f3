"""Hostile files about people: studies, users' profiles, and drives that somebody recorded."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

from tests.attack.files.damage import swollen
from tests.attack.files.family import Family, model_twist
from tests.attack.scenarios.twists import Rng, integer, json_text, spoiled, toml_text, twisted, without_none
from tests.support.framing import chained
from tests.users.recording.drives import tick, write_drive
from wcsim.config import parse_json, read_toml
from wcsim.config.study import StudyFile
from wcsim.users.profiles import profile_text, read_profile
from wcsim.users.recording.drive_bytes import event_payload, header_payload, tick_payload
from wcsim.users.recording.drive_reader import is_drive, read_drive, read_drive_header
from wcsim.users.recording.drive_recorder import DriveRecorder
from wcsim.users.recording.drive_types import DriveRecording, RecordedEvent
from wcsim.users.recording.framing import framed, whole_records

STUDY = {
    "name": "a-study",
    "title": "Two ways",
    "told": ["What it is about."],
    "policy": "dwa",
    "pause_s": 2.0,
    "places": [{"town": "helsinki", "seed": 3}, {"suite": "dev", "block": 2, "seat": 0}],
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
    drive = sound_drive(work / "sound.drive")
    return [
        Family(name="study", file="study.toml", sound=toml_text(STUDY).encode(), twist=model_twist(STUDY, toml_text),
               take=_take_study),
        Family(name="profile", file="u.toml", sound=toml_text(PROFILE).encode(), twist=model_twist(PROFILE, toml_text),
               take=_take_profile),
        Family(name="drive", file="a.drive", sound=drive, twist=drive_twist(drive), take=_take_drive),
    ]  # fmt: skip


def _take_study(path: Path) -> bool:
    study = read_toml(path, StudyFile)
    path.write_text(toml_text(without_none(study.model_dump(mode="json"))), encoding="utf-8")
    return read_toml(path, StudyFile) == study == parse_json(StudyFile, study.model_dump_json(), "again")


def _take_profile(path: Path) -> bool:
    user = read_profile(path)
    path.write_text(profile_text(user, {}), encoding="utf-8")
    return read_profile(path) == user


def _take_drive(path: Path) -> bool:
    """What is read and recorded again is the same; what is no drive for one reader is none for the others."""
    drive = read_drive(path)
    if not is_drive(path) or read_drive_header(path) != drive.header:
        return False
    path.unlink()
    with DriveRecorder(path, drive.header) as recorder:
        for event in drive.events:
            recorder.note(event)
        for item in drive.ticks:
            recorder.record(item)
    return _payloads(read_drive(path)) == _payloads(drive)


def _payloads(drive: DriveRecording) -> list[bytes]:
    return [header_payload(drive.header), *map(event_payload, drive.events), *map(tick_payload, drive.ticks)]


def sound_drive(path: Path) -> bytes:
    events = (RecordedEvent(tick=2, time_s=0.2, kind="help", detail="the user asks for help"),)
    data = write_drive(path, [tick(number) for number in range(1, 5)], events).read_bytes()
    path.unlink()
    return data


def drive_twist(sound: bytes) -> Callable[[Rng], tuple[bytes, str]]:
    """Fields of the header or of an event, or bytes of a tick, with lengths and checksums made to fit."""
    records = list(whole_records(io.BytesIO(sound), 0))
    payloads, last = [record.payload for record in records], records[-1].crc

    def twist(rng: Rng) -> tuple[bytes, str]:
        if integer(rng, 5) == 0:
            return swollen(sound, rng, lambda payload: framed(payload, last)), "swollen"
        at = integer(rng, len(payloads))
        kind, rest = payloads[at][:1], payloads[at][1:]
        if kind == b"T":
            changed, told = spoiled(rest, rng)
            payload = kind + changed
        else:
            data, told = twisted(json.loads(rest if kind == b"E" else payloads[at]), rng)
            payload = (b"E" if kind == b"E" else b"") + json_text(data).encode()
        return chained([*payloads[:at], payload, *payloads[at + 1 :]]), f"record {at}: {told}"

    return twist

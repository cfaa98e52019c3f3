"""Small drives for tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from wcsim import __version__
from wcsim.config import resolve
from wcsim.types import Joystick
from wcsim.users.profiles import profile, profile_json
from wcsim.users.recording.drive_recorder import DriveRecorder
from wcsim.users.recording.drive_types import DriveHeader, RecordedEvent, RecordedTick

TICK_S = 0.1


def drive_header(**changes: object) -> DriveHeader:
    """The header of a drive that never was."""
    header = DriveHeader(
        wcsim=__version__,
        fingerprint="numpy-0",
        town="nowhere",
        town_address="/nowhere",
        town_sha256="ab" * 32,
        seed=7,
        tick_s=TICK_S,
        config=resolve("quick").model_dump_json(),
        profile="competent",
        user=profile_json(profile("competent")),
        policy="dwa",
        level="1",
        episode="dev 3.1",
    )
    return replace(header, **changes)


def tick(number: int, **changes: object) -> RecordedTick:
    """One tick of a chair that drives east, its stick a little to the right of before."""
    made = RecordedTick(
        tick=number,
        episode=0,
        time_s=TICK_S * number,
        stick=Joystick(0.001 * (number - 1), 0.5),
        intent=Joystick(0.01, 0.6),
        sticks=np.array([[0.001 * number - 0.0005, 0.5], [0.001 * number, 0.5]]),
        commanded=Joystick(0.0, 0.5),
        chosen=Joystick(0.25, 0.5),
        action=40,
        p_WB_m=np.array([0.1 * number, 2.0, 0.05]),
        yaw_rad=0.0,
        speed_mps=1.0,
    )
    return replace(made, **changes)


def write_drive(
    path: Path, ticks: list[RecordedTick], events: tuple[RecordedEvent, ...] = (), **header: object
) -> Path:
    """A drive on disk."""
    with DriveRecorder(path, drive_header(**header)) as recorder:
        for event in events:
            recorder.note(event)
        for item in ticks:
            recorder.record(item)
    return path

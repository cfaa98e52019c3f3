"""Small drives for tests."""

from pathlib import Path

import numpy as np

from tests.support.framing import write_log
from wcsim import __version__
from wcsim.config import resolve
from wcsim.log.records import DriveHeader, DriveTick, Header, Note, with_fields
from wcsim.types import Joystick

TICK_S = 0.1


def drive_header(**changes: object) -> Header:
    """The header of a drive that never was."""
    about = DriveHeader(
        wcsim=__version__,
        profile="competent",
        policy="dwa",
        level="1",
        episode="dev 3.1",
    )
    header = Header(
        fingerprint="numpy-0",
        town="/nowhere",
        town_name="nowhere",
        town_sha256="ab" * 32,
        seed=7,
        seats=1,
        tick_s=TICK_S,
        config=resolve("quick").model_dump_json(),
        drive=with_fields(about, **{key: value for key, value in changes.items() if key in about.__struct_fields__}),
    )
    return with_fields(header, **{key: value for key, value in changes.items() if key in header.__struct_fields__})


def tick(number: int, **changes: object) -> DriveTick:
    """One tick of a chair that drives east, its stick a little to the right of before."""
    made = DriveTick(
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
    return with_fields(made, **changes)


def write_drive(path: Path, ticks: list[DriveTick], events: tuple[Note, ...] = (), **header: object) -> Path:
    """A drive on disk."""
    return write_log(path, drive_header(**header), (*events, *ticks))

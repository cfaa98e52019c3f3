"""Drives of simulated users over a plane with turns and stops: minutes of them in seconds, to fit without a world."""

import math
from dataclasses import replace

import numpy as np

from tests.log.drives import drive_header
from tests.support.samples import USUAL_OUTLINE
from tests.users.kinematics import SUBSTEPS, TICK_S, Chair, Sim, polyline
from wcsim.config import ChairConfig
from wcsim.core.seeding import make_rng
from wcsim.log.drive import DriveRecording
from wcsim.log.records import DriveTick, with_fields
from wcsim.types import Joystick
from wcsim.users.profiles import UserProfile
from wcsim.users.user import SimulatedUser

_LEGS = 10


def plane_drive(user: UserProfile, seconds: float, seed: int) -> DriveRecording:
    """A drive of one user along ways with turns of all sizes, one way an episode."""
    rng, ticks = np.random.default_rng(seed), []
    for episode in range(1000):
        ticks += _way(user, make_rng(seed, "plane", episode), rng, len(ticks), episode)
        if len(ticks) * TICK_S >= seconds:
            break
    records = tuple(ticks[: round(seconds / TICK_S)])
    header = drive_header()
    return DriveRecording(name="plane", header=header, records=records, has_truncated_end=False)


def thinned(drive: DriveRecording, samples: int) -> DriveRecording:
    """The same, with the stick so many times a tick; with 0 only at its beginning."""
    every = SUBSTEPS // samples if samples else 1
    ticks = (with_fields(t, sticks=t.sticks[every - 1 :: every] if samples else np.zeros((0, 2))) for t in drive.ticks)
    return replace(drive, records=tuple(ticks))


def _way(user: UserProfile, chance, rng: np.random.Generator, before: int, episode: int) -> list[DriveTick]:
    corners, heading = [(0.0, 0.0)], 0.0
    for _ in range(_LEGS):
        heading += float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.3, 1.7))
        length = float(rng.uniform(4.0, 14.0))
        x, y = corners[-1]
        corners.append((x + length * math.cos(heading), y + length * math.sin(heading)))
    driver = SimulatedUser(user, chance, ChairConfig(), USUAL_OUTLINE)
    first = math.atan2(corners[1][1], corners[1][0])
    sim, made = Sim(driver, polyline(*corners), Chair(yaw=first), quantised=True), []
    while sim.time_s < 200.0 and not (driver.arrived or driver.gave_up):
        stick, intent = driver.joystick, driver.intent
        sim.tick()
        chair = sim.chair
        made.append(
            DriveTick(
                tick=before + len(made) + 1,
                episode=episode,
                time_s=TICK_S * (before + len(made) + 1),
                stick=stick,
                intent=intent,
                sticks=driver.sticks,
                commanded=Joystick(stick.x, stick.y),
                chosen=Joystick(stick.x, stick.y),
                p_WB_m=np.array([chair.x, chair.y, 0.0]),
                yaw_rad=chair.yaw,
                speed_mps=chair.v,
            )
        )
    return made

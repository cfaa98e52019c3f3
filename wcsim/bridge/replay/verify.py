"""A log compared with its world made again, tick by tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from wcsim.bridge.replay.replayed import Log, replayed
from wcsim.bridge.world import World
from wcsim.log.drive import DriveRecording
from wcsim.log.records import DriveTick, EpochBegun, Input, WorldTick
from wcsim.types import ClientSnapshot, Joystick


@dataclass(frozen=True, slots=True, kw_only=True)
class Verified:
    """How a comparison of all ticks ended."""

    ticks: int = 0  # compared
    mismatches: int = 0
    first: WorldTick | None = None  # the first record that differs
    farthest_m: float = 0.0  # of a drive: between the two places of a tick


def verify(
    log: Log,
    epoch: int | None = None,
    first_tick: int = 0,
    last_tick: int | None = None,
    progress: Callable[[int], object] = lambda ticks: None,
    hook: str = "",
) -> Verified:
    """Compare the ticks from `first_tick` to `last_tick` of one or all epochs; raises what `replayed` raises.

    Of a journal their hashes; of a drive place, heading, speed and ends, and the stick of who was simulated.
    `progress` hears the number of ticks so far.
    """
    result, asked = Verified(), list[Joystick]()
    of_person = isinstance(log, DriveRecording) and not log.about.profile

    def before(world: World | None, _: Input) -> None:
        if world is not None:
            asked[:] = [(client.first or client).user for client in world.snapshot.clients]

    with closing(replayed(log, epoch, last_tick, hook, before)) as steps:
        for world, record in steps:
            if isinstance(record, EpochBegun) and isinstance(log, DriveRecording):
                world.go_blind()
            if not isinstance(record, WorldTick) or record.tick < first_tick:
                continue
            if isinstance(record, DriveTick):
                client = world.snapshot.clients[0]
                same = _is_same(record, client, None if of_person and record.by_person else asked[0])
                gap_m = math.dist(client.plant.p_WB_m.tolist(), record.p_WB_m.tolist())
            else:
                same, gap_m = record.state_hash == world.snapshot.state_hash, 0.0
            result = replace(
                result,
                ticks=result.ticks + 1,
                mismatches=result.mismatches + (not same),
                first=record if result.first is None and not same else result.first,
                farthest_m=max(result.farthest_m, gap_m),
            )
            progress(result.ticks)
    return result


def _is_same(tick: DriveTick, client: ClientSnapshot, asked: Joystick | None) -> bool:
    """Whether a drive's tick left the seat as it is recorded; `asked` is the stick of who was simulated."""
    plant, events = client.plant, client.events
    ends = (events.arrived, events.gave_up, events.crashed, events.truncated)
    return (
        asked in (None, tick.stick)
        and ends == (tick.arrived, tick.gave_up, tick.crashed, tick.truncated)
        and np.array_equal(plant.p_WB_m, tick.p_WB_m)
        and (plant.yaw_rad, float(plant.v_B_mps[0])) == (tick.yaw_rad, tick.speed_mps)
    )

"""Let a simulated user drive, as the baseline `follow` lets everybody, and record it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from wcsim.bridge.drives.drive_header import drive_header
from wcsim.bridge.replay.drive_inputs import first_inputs
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.log.records import DriveTick
from wcsim.log.writer import LogWriter
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.towns.scenario.town import Town
from wcsim.types import F64, ClientSnapshot, Joystick, SeatSpec
from wcsim.users.profiles import UserProfile, profile_json, sample

FOLLOW = "follow"
ENDLESS = 1_000_000_000  # steps of an episode that only a crash ends


@dataclass(frozen=True, slots=True, kw_only=True)
class UserDriveOrder:
    """A drive of one simulated user, who stays the same from episode to episode."""

    town: Town
    config: RunConfig
    user: UserProfile  # as drawn
    ticks: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """What a chair was given in a tick, and by whom."""

    commanded: Joystick
    chosen: Joystick
    action: int


def drawn_user(base: UserProfile, seed: int) -> UserProfile:
    """One user of a profile, who is then nobody else in any episode."""
    return replace(sample(base, seeding.generator(seed, "drive", "user")), spread=0.0)


def record_user(order: UserDriveOrder, out: Path, progress: Callable[[int], object] = lambda ticks: None) -> int:
    """Drive and record; returns how many crashes there were. `progress` hears of every tick.

    Raises:
        ConfigError: The file is there already, or cannot be made.
        DiskFullError: It could not be written on.
        TownError: The town cannot be run.
    """
    crashes = 0
    spec = SeatSpec(profile=profile_json(order.user), max_steps=ENDLESS)
    header = drive_header(order.town, order.config, order.seed, profile=order.user.name, policy=FOLLOW)
    with LogWriter(out, header) as recorder, World(order.town, order.config, (spec,), order.seed) as world:
        for record in first_inputs(spec, order.seed):
            recorder.append(record)
        world.go_blind()
        follower = _Follower(world, action_set(order.config.env.actions))
        for number, step in enumerate(islice(rollout(world, {0: follower}), order.ticks), start=1):
            tick = follower.driven(step.after.clients[0])
            recorder.append(tick)
            crashes += tick.crashed
            progress(number)
    return crashes


class _Follower:
    """Gives the only chair the action nearest to its user's stick, and remembers what that answered."""

    def __init__(self, world: World, actions: ActionSet) -> None:
        self._world, self._actions = world, actions

    def __call__(self, now: ClientSnapshot) -> Joystick:
        """See `Driver`."""
        self._before, self._user = now, self._world.seats[0].user
        self._intent = self._user.intent
        action = self._actions.nearest((now.user.x, now.user.y))
        stick = Joystick(*self._actions.points[action].tolist())
        self._given = Given(commanded=stick, chosen=stick, action=action)
        return stick

    def driven(self, after: ClientSnapshot) -> DriveTick:
        """The tick that it drove, of which the chair is `after`."""
        tick_s = self._world.config.world.tick_s
        return _seat_tick(self._before, after, self._given, self._intent, self._user.sticks, tick_s)


def _seat_tick(
    before: ClientSnapshot, after: ClientSnapshot, given: Given, intent: Joystick | None, sticks: F64, tick_s: float
) -> DriveTick:
    """A tick of a seat as it is recorded.

    Args:
        before: The seat at the tick's beginning.
        after: At its end; when that ended the episode, what comes next is in its `first`.
        given: What the chair was given.
        intent: What its user wanted.
        sticks: (S, 2) the user's stick within the tick.
        tick_s: How long it took.
    """
    plant, events = after.plant, after.events
    return DriveTick(
        tick=after.tick,
        episode=events.episode,
        time_s=after.tick * tick_s,
        stick=before.user,
        intent=intent,
        sticks=sticks.astype(np.float32),  # half the bytes
        commanded=given.commanded,
        chosen=given.chosen,
        action=given.action,
        p_WB_m=plant.p_WB_m,
        yaw_rad=plant.yaw_rad,
        roll_rad=plant.roll_rad,
        pitch_rad=plant.pitch_rad,
        speed_mps=float(plant.v_B_mps[0]),
        arrived=events.arrived,
        gave_up=events.gave_up,
        crashed=events.crashed,
        truncated=events.truncated,
    )

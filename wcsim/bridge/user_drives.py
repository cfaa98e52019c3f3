"""Drives of simulated users: alone and recorded, or as the shadow of a recorded person.

To know what a person intended, the drive is made again with a simulated user beside the person. It
has the same route, knows of the same things, and has the person's delay. Its intent stands for the
person's.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from wcsim.bridge.replay.replayed import config_of, first_inputs, replayed
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig
from wcsim.core import seeding
from wcsim.log.drive import DriveRecording, read_wcsim_version
from wcsim.log.fingerprint import make_software_fingerprint
from wcsim.log.records import (
    DriveHeader,
    DriveTick,
    EpochBegun,
    Header,
    Input,
    end_fields_from_snapshot,
    with_fields,
)
from wcsim.log.writer import LogWriter
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.types import ClientSnapshot, Joystick, Outline, SeatSpec, Street, UserView
from wcsim.users.profiles import UserProfile, profile_to_json, sample_profile
from wcsim.users.recordings.recorded_user import find_user
from wcsim.users.user import SimulatedUser

_FOLLOW = "follow"
_ENDLESS = 1_000_000_000  # steps of an episode that only a crash ends


@dataclass(frozen=True, slots=True, kw_only=True)
class _SeenDrive:
    """A drive, and what there was to see at the start of each of its ticks."""

    drive: DriveRecording
    views: tuple[UserView, ...]
    street: Street
    outline: Outline


def seen_drive(drive: DriveRecording) -> _SeenDrive:
    """Make a drive again, with what its person saw. Raises what `replayed` raises."""
    views: list[UserView] = []
    held: list[tuple[Street, Outline]] = []

    def look(world: World | None, record: Input) -> None:
        if world is not None and isinstance(record, DriveTick):
            views.append(world.view_of(0))

    with closing(replayed(drive, before=look)) as steps:
        for world, record in steps:
            if isinstance(record, EpochBegun):
                world.go_blind()
                held.append((world.street, world.seats[0].chair.outline))
    street, outline = held[0]
    return _SeenDrive(drive=drive, views=tuple(views), street=street, outline=outline)


def with_shadow(seen: _SeenDrive, user: UserProfile) -> DriveRecording:
    """What the person drove, with the intents of an attentive user of the same delays.

    That user always corrects.
    """
    careful = replace(user, see_share=1.0, away_share=0.0, correct_every_s=0.0, give_up_s=3600.0)
    chair, shadow, before = config_of(seen.drive.header).chair, None, None
    intents: list[Joystick] = []
    for tick, view in zip(seen.drive.ticks, seen.views, strict=True):
        if shadow is None or before is None or tick.episode != before[0]:
            rng = seeding.make_rng(seen.drive.header.seed, "shadow", tick.episode)
            shadow = SimulatedUser(careful, rng, chair, seen.outline, seen.street)
            before = None
        if before is None or before[1] is not view.route:
            shadow.follow(view.route)
        shadow.look(view)
        intents.append(shadow.intent)
        before = (tick.episode, view.route)
    # Each stretch that the person drove is an episode: at times the user beside may have driven.
    records, episode, last = list[DriveTick](), -1, (-1, False)
    for tick, intent in zip(seen.drive.ticks, intents, strict=True):
        now = (tick.episode, tick.by_person)
        if seen.drive.about.profile:
            records.append(with_fields(tick, intent=intent))
        elif tick.by_person:
            episode += now != last
            records.append(with_fields(tick, intent=intent, episode=episode))
        last = now
    return replace(seen.drive, records=tuple(records))


def drive_header(town: Town, config: RunConfig, seed: int, **driven: str) -> Header:
    """The header of a drive.

    Args:
        town: Where.
        config: Of the world.
        seed: Of the world.
        driven: Of `DriveHeader`: profile, policy, level, episode and scene.
    """
    return Header(
        fingerprint=make_software_fingerprint(),
        town=town.address,
        town_name=town.name,
        town_sha256=content_hash(town),
        seed=seed,
        seats=1,
        tick_s=config.world.tick_s,
        config=config.model_dump_json(),
        drive=DriveHeader(wcsim=read_wcsim_version(), **driven),
    )


def drawn_user(base: UserProfile, seed: int) -> UserProfile:
    """One user of a profile, the same one in every episode."""
    return replace(sample_profile(base, seeding.make_rng(seed, "drive", "user")), spread=0.0)


def record_user(
    out: Path,
    town: Town,
    config: RunConfig,
    user: UserProfile,
    *,
    ticks: int,
    seed: int,
    progress: Callable[[int], object] = lambda ticks: None,
) -> int:
    """Drive and record `ticks` of one user, as drawn, who stays the same from episode to episode.

    Returns how many crashes there were. `progress` is called with each tick's number.

    Raises:
        ConfigError: The file is there already, or cannot be made.
        DiskFullError: It could not be written on.
        TownError: The town cannot be run.
    """
    crashes = 0
    spec = SeatSpec(profile=profile_to_json(user), max_steps=_ENDLESS)
    header = drive_header(town, config, seed, profile=user.name, policy=_FOLLOW)
    with (
        LogWriter(out, header) as recorder,
        World(town, config, (spec,), seed, find_user=find_user) as world,
    ):
        for record in first_inputs(spec, seed):
            recorder.append(record)
        world.go_blind()
        follower = _Follower(world, action_set(config.env.actions))
        for number, step in enumerate(islice(rollout(world, {0: follower}), ticks), start=1):
            tick = follower.driven(step.commands[0].joystick, step.after.clients[0])
            recorder.append(tick)
            crashes += tick.crashed
            progress(number)
    return crashes


class _Follower:
    """Drives the only chair by the action nearest to its user's stick, and remembers its frame."""

    def __init__(self, world: World, actions: ActionSet) -> None:
        self._world, self._actions = world, actions

    def __call__(self, now: ClientSnapshot) -> Joystick:
        """See `Driver`."""
        self._before, self._user = now, self._world.seats[0].user
        self._intent = self._user.intent
        self._action = self._actions.nearest((now.user.x, now.user.y))
        return Joystick(*self._actions.points[self._action].tolist())

    def driven(self, given: Joystick, after: ClientSnapshot) -> DriveTick:
        """The tick that it drove with this stick, of which the chair is `after`."""
        return DriveTick(
            tick=after.tick,
            episode=after.events.episode,
            time_s=after.tick * self._world.config.world.tick_s,
            stick=self._before.user,
            intent=self._intent,
            # Half the bytes.
            sticks=self._user.sticks.astype(np.float32),
            commanded=given,
            chosen=given,
            action=self._action,
            **end_fields_from_snapshot(after),
        )

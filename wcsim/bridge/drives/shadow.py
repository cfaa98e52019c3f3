"""What a person wanted, made by the user model: it looks at the same street, tick by tick, from the same chair.

The drive is made again, and somebody of the model sits beside the person: on the same route, knowing of the same
things, with the person's delay. What it would want is taken for what the person wanted.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace

from wcsim.bridge.replay.replayed import config_of, replayed
from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.log.drive import DriveRecording
from wcsim.log.records import DriveTick, EpochBegun, Input, changed
from wcsim.types import Joystick, Outline, Street, UserView
from wcsim.users.profiles import UserProfile
from wcsim.users.user import SimulatedUser


@dataclass(frozen=True, slots=True, kw_only=True)
class _SeenDrive:
    """A drive, and what there was to see at the beginning of each of its ticks."""

    drive: DriveRecording
    views: tuple[UserView, ...]
    street: Street
    outline: Outline


def seen_drive(drive: DriveRecording) -> _SeenDrive:
    """Make a drive again and keep what its person saw. Raises what `replayed` raises."""
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
    """What the person drove, with the intents of an attentive driver of these delays, who always corrects."""
    careful = replace(user, see_share=1.0, away_share=0.0, correct_every_s=0.0, give_up_s=3600.0)
    chair, shadow, before = config_of(seen.drive.header).chair, None, None
    wishes: list[Joystick] = []
    for tick, view in zip(seen.drive.ticks, seen.views, strict=True):
        if shadow is None or before is None or tick.episode != before[0]:
            rng = seeding.generator(seen.drive.header.seed, "shadow", tick.episode)
            shadow = SimulatedUser(careful, rng, chair, seen.outline, seen.street)
            before = None
        if before is None or before[1] is not view.route:
            shadow.follow(view.route)
        shadow.look(view)
        wishes.append(shadow.intent)
        before = (tick.episode, view.route)
    ticks = tuple(changed(tick, intent=wish) for tick, wish in zip(seen.drive.ticks, wishes, strict=True))
    return replace(seen.drive, records=_persons(seen.drive, ticks))


def _persons(drive: DriveRecording, ticks: tuple[DriveTick, ...]) -> tuple[DriveTick, ...]:
    """The ticks that the person drove, each stretch an episode: at times the simulated user beside may have."""
    if drive.about.profile:
        return ticks
    kept, episode, before = list[DriveTick](), -1, (-1, False)
    for was, tick in zip(drive.ticks, ticks, strict=True):
        now = (was.episode, was.by_person)
        if now[1]:
            episode += now != before
            kept.append(changed(tick, episode=episode))
        before = now
    return tuple(kept)

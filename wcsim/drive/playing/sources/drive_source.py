"""A recorded drive as a film: the same drive made again, with what its recording says of person and policy."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Final

from wcsim.agents.policy_api import UNAIDED
from wcsim.bridge.drives.beside import by_person
from wcsim.bridge.drives.remake import config_of_drive, remade, town_of_drive
from wcsim.bridge.world import World
from wcsim.drive.driven import DriverKind, EventKind
from wcsim.drive.playing.film_states import FilmAbout, FilmLine, FilmNames, Flag, Said
from wcsim.drive.playing.sources.frame_maker import FrameMaker, TickSays
from wcsim.log.drive import DriveRecording, read_drive
from wcsim.log.records import DriveTick, Note

NOT_IN_DRIVES: Final = (
    "Unsafe positions: a drive records what the policy chose, not why.",
    "Sensor errors of the camera: its picture is drawn without them.",
)
_SAYS: Final = (
    (Flag.WARNING, "warning"),
    (Flag.INTERVENING, "intervening"),
    (Flag.OVERRULED, "overruled"),
    (Flag.HELPED, "helped"),
)


def drive_film(path: Path) -> Iterator[Said]:
    """A drive from its first tick to its last.

    Raises:
        JournalError: It is no drive.
        TownError: The town is gone, or is not what it was.
        ConfigError: Its settings or its user cannot be used here.
    """
    drive = read_drive(path)
    header, about, worlds = drive.header, drive.about, list[World]()
    policy = f", assisted by {about.policy}" if about.policy else ""
    yield FilmAbout(
        title=f"drive in {header.town_name}: {about.profile}{policy}",
        town=town_of_drive(header).address,
        tick_s=header.tick_s,
        camera=config_of_drive(header).cameras[0].model_dump_json(),
        actions=config_of_drive(header).env.actions,
        unknown=list(NOT_IN_DRIVES),
        ticks=len(drive.ticks),
        warns=bool(about.policy),
        tells_who=True,
    )
    yield FilmNames(names={0: about.profile})
    maker, differs, decides = FrameMaker(), 0, _WhoDecides(drive)

    def before(world: World) -> None:
        worlds[:] = [world]
        maker.begin(world)

    with closing(remade(drive, before)) as steps:
        for tick, _, after in steps:
            differs += tuple(after.plant.p_WB_m.tolist()) != tuple(tick.p_WB_m.tolist())
            yield maker.step_of(worlds[0], {0: _said(tick, decides.flags(tick))})
    told = "The whole drive is loaded."
    if differs:
        told += f" {differs} ticks differ from the recording: it was made with other versions or on another machine."
    yield FilmLine(kind="end", told=told)


class _WhoDecides:
    """Whose say it is, tick by tick, as the events of a drive tell."""

    def __init__(self, drive: DriveRecording) -> None:
        about = drive.about
        self._events, self._hands_over = deque(drive.events), about.accompanied and bool(about.episode)
        self._assisted, self._simulated = True, False
        self._can_assist = about.policy not in ("", UNAIDED)

    def flags(self, tick: DriveTick) -> Flag:
        """Of the next tick. A simulated user who drives where the person was to does so before a handover.

        Handovers are in episodes of suites alone; elsewhere an older recording may not say that the user was to drive.
        """
        while self._events and self._events[0].tick < tick.tick:
            self._note(self._events.popleft())
        alone = self._hands_over and not self._simulated and not by_person(tick)
        return (Flag.ALONE if alone else Flag(0)) | (Flag(0) if self._can_assist and self._assisted else Flag.UNAIDED)

    def _note(self, event: Note) -> None:
        if event.kind == EventKind.ASSISTANCE:
            self._assisted = event.detail == "on"
        elif event.kind == EventKind.POLICY_FAILED:
            self._assisted = False
        elif event.kind == EventKind.DRIVER:
            self._simulated = event.detail == DriverKind.SIMULATED


def _said(tick: DriveTick, flags: Flag) -> TickSays:
    for flag, name in _SAYS:
        flags |= flag if getattr(tick, name) else Flag(0)
    return TickSays(stick=tick.stick, commanded=tick.commanded, flags=flags)

"""A log as a film: its world made again, blind, of a drive with what it says of person and policy; or its states.

The states of a trace are everybody's places as they were written down; nothing is driven again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.agents.policy_api import UNAIDED
from wcsim.bridge.replay.replayed import config_of, count_ticks, log_of, replayed, town_of_drive, town_of_folder
from wcsim.bridge.world import World
from wcsim.config import ChairConfig
from wcsim.core.reading import escaped
from wcsim.drive.driven import DriverKind, EventKind, is_intervention, xy_of
from wcsim.drive.playing.film_states import (
    FilmAbout,
    FilmChair,
    FilmFrame,
    FilmLine,
    FilmNames,
    FrameMaker,
    Said,
    TickSays,
    bodies_of,
)
from wcsim.errors import ConfigError, TownError
from wcsim.log.drive import DriveRecording
from wcsim.log.reader import read_header, read_states
from wcsim.log.records import Admitted, DriveTick, EpochBegun, Header, Input, Note, Ticked, WorldState, WorldTick
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.server.specs import town_of_epoch
from wcsim.towns.making.asked_town import asked_town
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import find_scene
from wcsim.types import Command, Joystick, Outline
from wcsim.view.filming import SIGHT_M

NOT_IN_JOURNALS: Final = (
    "Warnings, unsafe positions and who is in control: a journal records the commands of the chairs only.",
    "Sensor errors of the cameras: pictures are drawn without them.",
)
NOT_IN_DRIVES: Final = (
    "Unsafe positions: a drive records what the policy chose, not why.",
    "Sensor errors of the camera: its picture is drawn without them.",
)


def replay_about(header: Header, ticks: int, *, epoch: int | None = None, live: bool = False) -> FilmAbout:
    """What a journal or a drive shows: one epoch, or from its first one on."""
    about, maps, config = header.drive, list[str](), config_of(header)
    if about is not None:
        town = town_of_drive(header).address
        title = f"drive in {header.town_name}: {about.driver}"
        title += f", assisted by {about.policy}" if about.policy else ""
    else:
        town = header.town
        if header.more_towns:
            town = asked_town(town_of_epoch(town, header.more_towns, epoch or 0)).address
            maps = [f"Maps of other towns than {Path(town).name}: the run's worlds change towns."]
        title = f"{header.name or 'journal'}, {Path(town).name}"
    return FilmAbout(
        title=title,
        town=town,
        tick_s=header.tick_s,
        camera=config.cameras[0].model_dump_json(),
        actions=config.env.actions,
        unknown=[*(NOT_IN_JOURNALS if about is None else NOT_IN_DRIVES), *maps],
        ticks=ticks,
        warns=about is not None and bool(about.policy),
        tells_who=about is not None,
        live=live,
    )


def replay_film(path: Path, epoch: int | None = None, hook: str = "") -> Iterator[Said]:
    """A journal or a drive from its first tick to its last, of one epoch or of all; raises what `replayed` raises."""
    log, header = log_of(path), read_header(path)
    yield replay_about(header, count_ticks(log, epoch), epoch=epoch)
    scene = RecordScene(log if isinstance(log, DriveRecording) else None)
    with closing(replayed(log, epoch, None, hook)) as steps:
        for world, record in steps:
            yield from scene.said(world, record)
    yield FilmLine(kind="end", told=scene.told(f"The whole {header.kind} is loaded."))


class RecordScene:
    """What the records of a log show, one after the other; `drive` where they are made of one."""

    def __init__(self, drive: DriveRecording | None = None) -> None:
        self.differs = 0  # ticks that gave another state than the log says
        self._drive, self._decides = drive, None if drive is None else _WhoDecides(drive)
        self._maker = FrameMaker()
        self._names: dict[int, str] = {}
        self._asked: dict[int, Joystick] = {}

    def said(self, world: World, record: Input) -> Iterator[Said]:
        """What there is to say after one."""
        match record:
            case EpochBegun():
                world.go_blind()
                if self._drive is None:
                    yield FilmLine(kind="mark", told=f"World {record.epoch} starts.")
                else:
                    yield FilmNames(names={0: self._drive.about.driver})
            case Admitted() if self._drive is None:
                if self._names.get(record.seat) != record.name:
                    self._names[record.seat] = record.name
                    yield FilmNames(names=dict(self._names))
            case Ticked() | DriveTick():
                yield self._frame(world, record)
        self._maker.begin(world)
        self._asked = {client.seat: (client.first or client).user for client in world.snapshot.clients}

    def told(self, told: str) -> str:
        """A line, with what went another way."""
        if not self.differs:
            return told
        return f"{told} {self.differs} ticks differ: it was made with other versions or on another machine."

    def _frame(self, world: World, record: WorldTick) -> FilmFrame:
        now = world.snapshot
        self._maker.look(world)
        if isinstance(record, DriveTick):
            self.differs += not np.array_equal(now.clients[0].plant.p_WB_m, record.p_WB_m)
            said = TickSays() if self._decides is None else self._decides.says(record)
            return self._maker.frame(now, {0: said})
        self.differs += record.state_hash != now.state_hash
        return self._maker.frame(now, {command.seat: self._says(command) for command in record.commands})

    def _says(self, command: Command) -> TickSays:
        asked, given = self._asked.get(command.seat), command.joystick
        return TickSays(
            stick=None if asked is None else xy_of(asked),
            commanded=xy_of(given),
            intervening=asked is not None and is_intervention(asked, given),
        )


class _WhoDecides:
    """Whose say it is, tick by tick, as the events of a drive tell."""

    def __init__(self, drive: DriveRecording) -> None:
        about = drive.about
        self._events, self._hands_over = deque(drive.events), not about.profile and bool(about.episode)
        self._assisted, self._simulated = True, False
        self._can_assist = about.policy not in ("", UNAIDED)

    def says(self, tick: DriveTick) -> TickSays:
        """Of the next tick. A simulated user who drives where the person was to does so before a handover.

        Handovers are in episodes of suites alone; elsewhere an older recording may not say that the user was to drive.
        """
        while self._events and self._events[0].tick < tick.tick:
            self._note(self._events.popleft())
        return TickSays(
            stick=xy_of(tick.stick),
            commanded=xy_of(tick.commanded),
            warning=tick.warning,
            intervening=tick.intervening,
            overruled=tick.overruled,
            helped=tick.helped,
            alone=self._hands_over and not self._simulated and not tick.by_person,
            unaided=not (self._can_assist and self._assisted),
        )

    def _note(self, event: Note) -> None:
        if event.kind == EventKind.ASSISTANCE:
            self._assisted = event.detail == "on"
        elif event.kind == EventKind.POLICY_FAILED:
            self._assisted = False
        elif event.kind == EventKind.DRIVER:
            self._simulated = event.detail == DriverKind.SIMULATED


NOT_IN_TRACES: Final = (
    "Sensors: a trace holds positions only, so there is no picture of the chair's camera.",
    "The user's stick, so there is no KPI 1 and no intervention.",
    "Crashes, arrivals and routes. A chair that jumps has started another episode.",
    "Traffic signals, brake lights and vehicle models.",
)

_EAST: Final = [0.0, 0.0, 0.0, 1.0]  # for no turn at all, which somebody may have written into a file


def state_film(path: Path, epoch: int | None = None, town: str = "") -> Iterator[Said]:
    """A trace from its first tick to its last.

    Args:
        path: The file.
        epoch: Which one; all when None.
        town: Name or folder of its town; "" for the one that the trace names.

    Raises:
        JournalError: It is no trace.
        TownError: The town is not there, or another one.
        ConfigError: There is no chair in it.
    """
    header, records = read_states(path)
    chosen = [record for record in records if epoch in (None, record.epoch) and len(record.plants)]
    if not chosen:
        raise ConfigError(f"{escaped(path)}: has no wheelchair to follow; expected a run with --chairs")
    place = _town(header, town)
    yield FilmAbout(
        title=f"trace of {place.name}, seed {header.seed}",
        town=place.address,
        tick_s=header.tick_s,
        unknown=list(NOT_IN_TRACES),
        ticks=len(chosen),
    )
    outline = _outline(header)
    for record in chosen:
        yield _frame(record, outline)
    yield FilmLine(kind="end", told="The whole trace is loaded.")


def _town(header: Header, name: str) -> Town:
    """The town of a trace. Raises TownError when it is not there, or has its origin elsewhere."""
    try:
        town = _town_or_scene(name or header.town)
    except TownError as error:
        if name:
            raise
        raise TownError(f"the trace is of a town {escaped(header.town, 80)!r}: {error}; name it with --town") from None
    if tuple(town.file.origin_m) != tuple(header.origin_m):
        raise TownError(
            f"the trace has its origin at {header.origin_m}, {town.name} at {town.file.origin_m}; expected the town "
            "that it was recorded in: name it with --town"
        )
    return town


def _town_or_scene(name: str) -> Town:
    try:
        return find_town(name)
    except TownError as no_town:
        try:
            scene = find_scene(name)
        except TownError:
            raise no_town from None
    return town_of_folder(scene)  # what is wrong with a scene that is there is its own fault, and told


def _outline(header: Header) -> Outline:
    usual = plant_spec(ChairConfig()).outline
    length_m, middle_x_m = header.chair_box_m or (usual.length_m, usual.middle_x_m)
    return replace(usual, length_m=length_m, middle_x_m=middle_x_m)


def _frame(record: WorldState, outline: Outline) -> FilmFrame:
    """A state, with those that are in sight of a chair."""
    gaps_m = np.hypot(*np.moveaxis(record.actors[:, None, :2] - record.plants[None, :, :2], -1, 0)).min(axis=1)
    near = np.flatnonzero(gaps_m < SIGHT_M).tolist() if record.bodies else []
    bodies = [record.bodies[number] for number in near]
    rows = [(*record.actors[number], *record.bodies[number].size_lwh_m) for number in near]
    return FilmFrame(
        epoch=record.epoch,
        tick=record.tick,
        time_s=record.time_s,
        bodies=bodies_of(bodies),
        rows=np.array(rows, "<f4").tobytes(),
        chairs=[
            FilmChair(
                seat=seat,
                p_WB_m=plant[:3],
                q_WB=plant[3:7] if any(plant[3:7]) else _EAST,
                outline=outline,
                speed_mps=plant[7],
                commanded=(given[0], given[1]),
            )
            for seat, plant, given in zip(
                record.seats or range(len(record.plants)), record.plants.tolist(), record.commands.tolist(), strict=True
            )
        ],
    )

"""A log as a film: the world of a journal or drive simulated again without cameras, or a trace.

The film of a drive also shows what its recording has of the person and the policy. A trace has
everybody's places; nothing is driven again. The journal of a run that goes on is read as it grows.
Its world is simulated a moment behind; the run does nothing for it and does not know of it. If the
film is slower than the run, it shows how far it is behind, and goes to the newest epoch as soon as
one begins.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.agents.policy_api import UNAIDED
from wcsim.bridge.replay.player import LogPlayer
from wcsim.bridge.replay.replayed import (
    config_of,
    log_of,
    replayed,
    town_of_drive,
    town_of_folder,
    worlds_of,
)
from wcsim.bridge.world import World
from wcsim.config import ChairConfig
from wcsim.core.reading import METRICS, escape, open_regular_file
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
from wcsim.errors import ConfigError, PolicyError, TownError
from wcsim.log.drive import DriveRecording
from wcsim.log.reader import LogFollower, iter_journal_inputs, read_header, read_trace_states
from wcsim.log.records import (
    Admitted,
    DriveTick,
    Ended,
    EpochBegun,
    Header,
    Input,
    Ticked,
    WorldState,
    WorldTick,
)
from wcsim.log.writer import JOURNAL
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.server.host.opening import EPOCH_OVER
from wcsim.server.specs import town_name_for_epoch
from wcsim.towns.making.asked_town import requested_town
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.scene_folders.build import find_scene
from wcsim.types import Command, Joystick, Outline
from wcsim.view.filming import SIGHT_M

NOT_IN_JOURNALS: Final = (
    "Warnings, unsafe positions and who is in control: "
    "a journal records the commands of the chairs only.",
    "Sensor errors of the cameras: pictures are drawn without them.",
)
NOT_IN_DRIVES: Final = (
    "Unsafe positions: a drive records what the policy chose, not why.",
    "Sensor errors of the camera: its picture is drawn without them.",
)
NOT_IN_TRACES: Final = (
    "Sensors: a trace holds positions only, so there is no picture of the chair's camera.",
    "The user's stick, so there is no KPI 1 and no intervention.",
    "Crashes, arrivals and routes. A chair that jumps has started another episode.",
    "Traffic signals, brake lights and vehicle models.",
)

# For no turn at all, which somebody may have written into a file.
_EAST: Final = [0.0, 0.0, 0.0, 1.0]
# If more ticks than this are left of an epoch, a newer one is shown at once.
SKIPS_TICKS: Final = 100
_MOST_WAITING: Final = 200_000  # records
_POLL_S: Final = 0.05
_TOLD_S: Final = 0.5
_QUIET_S: Final = 3.0  # without a tick, before something is said of it
_BEHIND: Final = 10  # ticks from which on they are told of
_LAST_BYTES: Final = 4096
_STEP_DIGITS: Final = 15

Gone = Callable[[float], bool]  # waits so many seconds; whether nobody listens any more
Clock = Callable[[], float]


def replay_film(path: Path, epoch: int | None = None, hook: str = "") -> Iterator[Said]:
    """A journal or drive from first to last tick, of one epoch or all.

    Raises:
        JournalError: It is neither journal nor drive.
        WcsimError: As of `replayed`.
    """
    log, header = log_of(path), read_header(path)
    if isinstance(log, DriveRecording):
        ticks = len(log.ticks)
        scene = _RecordScene(log)
    else:
        ticks = sum(
            isinstance(record, Ticked) and epoch in (None, record.epoch)
            for record in iter_journal_inputs(log)
        )
        scene = _RecordScene()
    yield _replay_about(header, ticks, epoch=epoch)
    with closing(replayed(log, epoch, None, hook)) as steps:
        for world, record in steps:
            yield from scene.said(world, record)
    yield FilmLine(kind="end", told=scene.told(f"The whole {header.kind} is loaded."))


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
    header, records = read_trace_states(path)
    chosen = [record for record in records if epoch in (None, record.epoch) and len(record.plants)]
    if not chosen:
        raise ConfigError(
            f"{escape(path)}: has no wheelchair to follow; expected a run with --chairs"
        )
    place = _town(header, town)
    yield FilmAbout(
        title=f"trace of {place.name}, seed {header.seed}",
        town=place.address,
        tick_s=header.tick_s,
        unknown=list(NOT_IN_TRACES),
        ticks=len(chosen),
    )
    usual = plant_spec(ChairConfig()).outline
    length_m, middle_x_m = header.chair_box_m or (usual.length_m, usual.middle_x_m)
    outline = replace(usual, length_m=length_m, middle_x_m=middle_x_m)
    for record in chosen:
        yield _frame(record, outline)
    yield FilmLine(kind="end", told="The whole trace is loaded.")


def follow_film(
    run: Path, hook: str, say: Callable[[Said], object], gone: Gone, clock: Clock = time.monotonic
) -> None:
    """Follow a run until nobody listens any more.

    Args:
        run: Its folder.
        hook: The step hook that it was started with, which a journal alone does not load.
        say: Receives the film.
        gone: See `Gone`.
        clock: Monotonic seconds.

    Raises:
        JournalError: The journal is none, or damaged.
        TownError, ConfigError: Its world cannot be made here.
        WcsimError: Its records do not follow from each other.
    """
    with LogFollower(run / JOURNAL) as tail:
        first = tail.read()
        while tail.header is None:
            say(FilmLine(kind="now", told="The run has not started yet."))
            if gone(_TOLD_S):
                return
            first = tail.read()
        say(_replay_about(tail.header, 0, live=True))
        following = _Following(run, tail.header, hook, say)
        try:
            following.hear(first)
            while following.turn(tail, gone, clock):
                pass
        finally:
            following.close()


def _replay_about(
    header: Header, ticks: int, *, epoch: int | None = None, live: bool = False
) -> FilmAbout:
    """What a journal or a drive shows: one epoch, or from its first one on."""
    about, maps, config = header.drive, list[str](), config_of(header)
    if about is not None:
        town = town_of_drive(header).address
        title = f"drive in {header.town_name}: {about.driver}"
        title += f", assisted by {about.policy}" if about.policy else ""
    else:
        town = header.town
        if header.more_towns:
            town = requested_town(town_name_for_epoch(town, header.more_towns, epoch or 0)).address
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


class _RecordScene:
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
        self._asked = {
            client.seat: (client.first or client).user for client in world.snapshot.clients
        }

    def told(self, told: str) -> str:
        """A line, with what went another way."""
        if not self.differs:
            return told
        return (
            f"{told} {self.differs} ticks differ: "
            "it was made with other versions or on another machine."
        )

    def _frame(self, world: World, record: WorldTick) -> FilmFrame:
        now = world.snapshot
        self._maker.look(world)
        if isinstance(record, DriveTick):
            self.differs += not np.array_equal(now.clients[0].plant.p_WB_m, record.p_WB_m)
            said = TickSays() if self._decides is None else self._decides.says(record)
            return self._maker.frame(now, {0: said})
        self.differs += record.state_hash != now.state_hash
        return self._maker.frame(
            now, {command.seat: self._says(command) for command in record.commands}
        )

    def _says(self, command: Command) -> TickSays:
        asked, given = self._asked.get(command.seat), command.joystick
        return TickSays(
            stick=None if asked is None else xy_of(asked),
            commanded=xy_of(given),
            intervening=asked is not None and is_intervention(asked, given),
        )


class _WhoDecides:
    """Who is in control in each tick, by the events of a drive."""

    def __init__(self, drive: DriveRecording) -> None:
        about = drive.about
        self._events = deque(drive.events)
        self._hands_over = not about.profile and bool(about.episode)
        self._assisted, self._simulated = True, False
        self._can_assist = about.policy not in ("", UNAIDED)

    def says(self, tick: DriveTick) -> TickSays:
        """What the next tick shows of sticks and policy.

        If a simulated user drives in the person's place, it is before a handover. Only episodes of
        suites have handovers; elsewhere an older recording may not name the user as driver.
        """
        while self._events and self._events[0].tick < tick.tick:
            event = self._events.popleft()
            if event.kind == EventKind.ASSISTANCE:
                self._assisted = event.detail == "on"
            elif event.kind == EventKind.POLICY_FAILED:
                self._assisted = False
            elif event.kind == EventKind.DRIVER:
                self._simulated = event.detail == DriverKind.SIMULATED
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


def _town(header: Header, name: str) -> Town:
    """The town of a trace. Raises TownError when it is not there, or has its origin elsewhere."""
    try:
        town = _town_or_scene(name or header.town)
    except TownError as error:
        if name:
            raise
        raise TownError(
            f"the trace is of a town {escape(header.town, 80)!r}: {error}; name it with --town"
        ) from None
    if tuple(town.file.origin_m) != tuple(header.origin_m):
        raise TownError(
            f"the trace has its origin at {header.origin_m}, {town.name} at {town.file.origin_m}; "
            "expected the town that it was recorded in: name it with --town"
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
    # If there is a scene, its own errors are told.
    return town_of_folder(scene)


def _frame(record: WorldState, outline: Outline) -> FilmFrame:
    """A state, with those that are in sight of a chair."""
    gaps_m = np.hypot(
        *np.moveaxis(record.actors[:, None, :2] - record.plants[None, :, :2], -1, 0)
    ).min(axis=1)
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
                record.seats or range(len(record.plants)),
                record.plants.tolist(),
                record.commands.tolist(),
                strict=True,
            )
        ],
    )


class _Following:
    """The records that are read and not yet replayed, and the world that replays them."""

    def __init__(self, run: Path, header: Header, hook: str, say: Callable[[Said], object]) -> None:
        self._run, self._say = run, say
        self._player = LogPlayer[World](worlds_of(header, hook), header.seats)
        self._scene = _RecordScene()
        self._queue = deque[Input]()
        self._ended = ""
        self._heard_s = self._told_s = self._asked_s = 0.0
        self._told, self._differed = "", False
        self._names, self._named = dict[int, str](), dict[int, str]()

    def hear(self, records: list[Input]) -> None:
        """Queue new records. Where a newer epoch has begun, many older ticks are left out."""
        self._queue.extend(records)
        begun = (at for at, record in enumerate(self._queue) if isinstance(record, EpochBegun))
        newest = max(begun, default=0)
        left = sum(isinstance(record, Ticked) for record in list(self._queue)[:newest])
        if left > SKIPS_TICKS:
            for _ in range(newest):
                self._player.seats.note(self._queue.popleft())
            self._say(
                FilmLine(kind="mark", told=f"{left} ticks were skipped to reach the newest world.")
            )

    def turn(self, tail: LogFollower, gone: Gone, clock: Clock) -> bool:
        """Replay the next record, or wait for one; False when nobody listens any more."""
        now_s = clock()
        if not self._queue or now_s - self._asked_s > _POLL_S:
            self._asked_s = now_s
            while len(self._queue) < _MOST_WAITING and (records := tail.read()):
                self._heard_s = now_s
                self.hear(records)
        if self._queue:
            record = self._queue.popleft()
            self._ended = record.reason if isinstance(record, Ended) else ""
            world = self._player.play(record)
            for said in self._scene.said(world, record):
                if isinstance(said, FilmNames):
                    self._names = dict(said.names)
                self._say(said)
            if self._scene.differs and not self._differed:
                self._differed = True
                told = "The film differs from the run: its version or machine is another."
                self._say(FilmLine(kind="bad", told=told))
        if now_s - self._told_s > _TOLD_S:
            self._told_s = now_s
            self._tell(self._status(tail, now_s))
        return not gone(0.0 if self._queue else _POLL_S)

    def close(self) -> None:
        """End the world."""
        self._player.close()

    def _tell(self, told: str) -> None:
        """Now and then: how the run stands, and the steps of its learners."""
        if told != self._told:
            self._told = told
            self._say(FilmLine(kind="now", told=told))
        named = {seat: _with_step(self._run, name) for seat, name in self._names.items()}
        if named != self._named:
            self._named = named
            self._say(FilmNames(names=named))

    def _status(self, tail: LogFollower, now_s: float) -> str:
        """What goes on with the run."""
        behind = sum(isinstance(record, Ticked) for record in self._queue)
        if behind > _BEHIND:
            return f"{behind} ticks behind the run"
        if self._ended.startswith(EPOCH_OVER):
            return "This world has ended; the next one is starting."
        if self._ended:
            told = f"The run has ended ({self._ended})."
            return f"{told} This page continues when the run is resumed."
        quiet_s = now_s - self._heard_s
        if quiet_s < _QUIET_S:
            return "live"
        if tail.is_written() is False:
            return "No process runs this world now: the run was killed, or its world is restarting."
        return f"No tick for {quiet_s:.0f} s: the world waits for a client."


def _with_step(run: Path, name: str) -> str:
    """A client, with its learner's step at the end of its last episode, if its folder has it."""
    try:
        with open_regular_file(run / name / "metrics.csv", METRICS) as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - _LAST_BYTES))
            lines = file.read(_LAST_BYTES).split(b"\n")
    except PolicyError:
        return name
    step = lines[-2].split(b",")[0] if len(lines) > 1 else b""
    return f"{name}, step {int(step)}" if step.isdigit() and len(step) <= _STEP_DIGITS else name

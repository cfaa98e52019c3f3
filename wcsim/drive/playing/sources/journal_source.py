"""A journal as a film: its world made again, blind, record by record."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from wcsim.bridge.world import World
from wcsim.config import RunConfig, parse_json
from wcsim.drive.playing.film_states import FilmAbout, FilmLine, FilmNames, FilmStep, Said
from wcsim.drive.playing.sources.frame_maker import FrameMaker, TickSays, asked_before, intervening
from wcsim.log.reader import read_header
from wcsim.log.records import Admitted, EpochBegun, Header, Input, Ticked
from wcsim.server.replay import count_ticks, replayed
from wcsim.server.specs import town_of_epoch
from wcsim.towns.making.asked_town import asked_town
from wcsim.types import Joystick

NOT_IN_JOURNALS = (
    "Warnings, unsafe positions and who is in control: a journal records the commands of the chairs only.",
    "Sensor errors of the cameras: pictures are drawn without them.",
)


def journal_about(header: Header, ticks: int, *, epoch: int | None = None, live: bool = False) -> FilmAbout:
    """What a journal shows: one epoch, or from its first one on."""
    town, maps = header.town, list[str]()
    if header.more_towns:
        town = asked_town(town_of_epoch(town, header.more_towns, epoch or 0)).address
        maps = [f"Maps of other towns than {Path(town).name}: the run's worlds change towns."]
    config = parse_json(RunConfig, header.config, "the configuration in the journal")
    return FilmAbout(
        title=f"{header.name or 'journal'}, {Path(town).name}",
        town=town,
        tick_s=header.tick_s,
        camera=config.cameras[0].model_dump_json(),
        actions=config.env.actions,
        unknown=[*NOT_IN_JOURNALS, *maps],
        ticks=ticks,
        live=live,
    )


def journal_film(path: Path, epoch: int | None, hook: str) -> Iterator[Said]:
    """A journal from its first tick to its last, of one epoch or of all.

    Raises:
        TownError: The town is not there, or has other streets than it had.
        WcsimError: It is no journal, has no such epoch, or its records do not follow from each other.
    """
    header = read_header(path)
    yield journal_about(header, count_ticks(path, epoch), epoch=epoch)
    scene = RecordScene()
    with closing(replayed(path, epoch, None, hook, scene.before)) as steps:
        for world, record in steps:
            yield from scene.said(world, record)
    yield FilmLine(kind="end", told=scene.told("The whole journal is loaded."))


class RecordScene:
    """What the records of a journal show, one after the other."""

    def __init__(self) -> None:
        self.differs = 0  # ticks that gave another state than the journal says
        self._maker = FrameMaker()
        self._names: dict[int, str] = {}
        self._asked: dict[int, Joystick] = {}

    def before(self, world: World | None, record: Input) -> None:
        """What is so before a record is done."""
        if isinstance(record, Ticked) and world is not None:
            self._maker.begin(world)
            self._asked = asked_before(world.snapshot.clients)

    def said(self, world: World, record: Input) -> Iterator[Said]:
        """What there is to say after it."""
        match record:
            case EpochBegun():
                world.go_blind()
                yield FilmLine(kind="mark", told=f"World {record.epoch} starts.")
            case Admitted():
                if self._names.get(record.seat) != record.name:
                    self._names[record.seat] = record.name
                    yield FilmNames(names=dict(self._names))
            case Ticked():
                self.differs += record.state_hash != world.snapshot.state_hash
                yield self._step(world, record)
            case _:
                return

    def told(self, told: str) -> str:
        """A line, with what went another way."""
        if not self.differs:
            return told
        return (
            f"{told} {self.differs} ticks differ from the run: it was made with other versions or on another machine."
        )

    def _step(self, world: World, record: Ticked) -> FilmStep:
        said = {}
        for command in record.commands:
            stick, given = self._asked.get(command.seat), command.joystick
            said[command.seat] = TickSays(stick=stick, commanded=given, flags=intervening(stick, given))
        return self._maker.step_of(world, said)

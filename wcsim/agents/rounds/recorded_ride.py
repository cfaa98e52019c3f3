"""A recorded drive, or one seat of a journal, as observations: the world is made again, with the cameras it had."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wcsim.agents.envs.episode_view import delay_ticks
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation
from wcsim.bridge.drives.remake import remade
from wcsim.bridge.world import World
from wcsim.config import RunConfig, parse_json
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError
from wcsim.log.drive import read_drive
from wcsim.log.reader import read_header
from wcsim.log.records import Header, Input, Respawned, Ticked
from wcsim.log.writer import JOURNAL
from wcsim.server.replay import replayed
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.judge import observation_of


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRide:
    """Successive ticks of one episode."""

    seen: tuple[Observation, ...]
    actions: tuple[int, ...]  # what the policy of then chose in each, whichever it was
    delay_ticks: int  # from a command to the chair that obeys it


def recorded_with(path: Path) -> tuple[RunConfig, str]:
    """The settings of a recording, and the policy that drove it; "" of a journal, which names none.

    Raises what `recorded_ride` raises.
    """
    path = _file_of(path)
    header = read_header(path)
    return _config_of(header), "" if header.drive is None else header.drive.policy


def recorded_ride(path: Path, steps: int, seat: int = 0) -> RecordedRide:
    """The first episode of a recording, so many steps at the most.

    Args:
        path: A drive, a journal, or the run folder with one.
        steps: The most.
        seat: Of a journal.

    Raises:
        TownError: Its town is gone, or is not what it was.
        ConfigError: Its settings cannot be used here, or that seat drove nowhere.
        JournalError: It is neither, or damaged.
    """
    path = _file_of(path)
    ride = _of_drive(path, steps) if read_header(path).kind == "drive" else _of_journal(path, steps, seat)
    if not ride.seen:
        raise ConfigError(f"{escaped(path)}: seat {seat} has no tick; expected another --seat")
    return ride


def _file_of(path: Path) -> Path:
    return path / JOURNAL if path.is_dir() else path


def _config_of(header: Header) -> RunConfig:
    return parse_json(RunConfig, header.config, "the configuration in the recording")


def _of_drive(path: Path, steps: int) -> RecordedRide:
    drive = read_drive(path)
    config, seen, actions = _config_of(drive.header), list[Observation](), list[int]()
    delays: list[int] = []

    def look(world: World) -> None:
        client = world.snapshot.clients[0]
        client = client.first or client
        seen.append(observation_of(client, config))
        delays.append(delay_ticks(config, client.drawn))

    with closing(remade(drive, look, blind=False)) as ticks:
        for tick, _, _ in ticks:
            if tick.episode != drive.ticks[0].episode or len(actions) == steps:
                break
            seen[-1] = {**seen[-1], JOYSTICK_KEY: np.array([tick.stick.x, tick.stick.y], np.float32)}
            actions.append(tick.action)
    return _ridden(seen[: len(actions)], actions, delays)


def _of_journal(path: Path, steps: int, seat: int) -> RecordedRide:
    watch = _SeatWatch(_config_of(read_header(path, "journal")), seat, steps)
    with closing(replayed(path, None, None, "", watch.look)) as records:
        for _ in records:
            if watch.over:
                break
    return _ridden(watch.seen, watch.actions, watch.delays)


def _ridden(seen: list[Observation], actions: list[int], delays: list[int]) -> RecordedRide:
    """The first tick's delay is that of the episode."""
    return RecordedRide(seen=tuple(seen), actions=tuple(actions), delay_ticks=delays[0] if delays else 0)


class _SeatWatch:
    """Keeps what one seat sees and is given in its first episode."""

    def __init__(self, config: RunConfig, seat: int, steps: int) -> None:
        self._config, self._seat, self._steps = config, seat, steps
        self._points = action_set(config.env.actions)
        self.seen: list[Observation] = []
        self.actions: list[int] = []
        self.delays: list[int] = []
        self.over = False

    def look(self, world: World | None, record: Input) -> None:
        """Is shown the world before each record."""
        given = [each for each in record.commands if each.seat == self._seat] if isinstance(record, Ticked) else []
        if world is None or not given:
            self.over = self.over or (bool(self.actions) and isinstance(record, Ticked | Respawned))
            return
        client = next(each for each in world.snapshot.clients if each.seat == self._seat)
        self.over = self.over or len(self.actions) == self._steps or (client.first is not None and bool(self.actions))
        if self.over:
            return
        client = client.first or client
        self.seen.append(observation_of(client, self._config))
        self.delays.append(delay_ticks(self._config, client.drawn))
        self.actions.append(self._points.nearest((given[0].joystick.x, given[0].joystick.y)))

"""A recorded drive, or one seat of a journal, as observations: the world is made again, with the cameras it had."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wcsim.agents.envs.episode_view import delay_ticks
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation
from wcsim.bridge.replay.replayed import Log, config_of, log_of, replayed
from wcsim.bridge.world import World
from wcsim.config import RunConfig
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError
from wcsim.log.reader import read_header
from wcsim.log.records import Dismissed, DriveTick, Header, Input, Respawned, WorldTick
from wcsim.log.writer import JOURNAL
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.judge import observation_of
from wcsim.types import ClientSnapshot, Joystick


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRide:
    """Successive ticks of one episode."""

    seen: tuple[Observation, ...]
    actions: tuple[int, ...]  # what the policy of then chose in each, whichever it was
    delay_ticks: int  # from a command to the chair that obeys it


def header_of(path: Path) -> Header:
    """What a recording says of itself: of a drive, a journal, or the run folder with one. Raises JournalError."""
    return read_header(_file_of(path))


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
    watch = _SeatWatch(log_of(path), config_of(read_header(path)), seat, steps)
    with closing(replayed(watch.log, before=watch.look)) as records:
        for _ in records:
            if watch.over:
                break
    if not watch.seen:
        raise ConfigError(f"{escaped(path)}: seat {seat} has no tick; expected another --seat")
    delay = watch.delays[0]  # that of the episode
    return RecordedRide(seen=tuple(watch.seen), actions=tuple(watch.actions), delay_ticks=delay)


def _file_of(path: Path) -> Path:
    return path / JOURNAL if path.is_dir() else path


class _SeatWatch:
    """Keeps what one seat sees and is given in its first episode."""

    def __init__(self, log: Log, config: RunConfig, seat: int, steps: int) -> None:
        self.log, self._config, self._seat, self._steps = log, config, seat, steps
        self._points = action_set(config.env.actions)
        self.seen: list[Observation] = []
        self.actions: list[int] = []
        self.delays: list[int] = []
        self.over = False

    def look(self, world: World | None, record: Input) -> None:
        """Is shown the world before each record."""
        if world is None or not isinstance(record, WorldTick):
            self.over = self.over or (bool(self.actions) and self._leaves(record))
            return
        given = next((each.joystick for each in record.commands if each.seat == self._seat), None)
        client = next((each for each in world.snapshot.clients if each.seat == self._seat), None)
        if given is None or client is None:
            self.over = self.over or bool(self.actions)
            return
        self.over = self.over or len(self.actions) == self._steps or (client.first is not None and bool(self.actions))
        if not self.over:
            self._keep(client.first or client, given, record)

    def _leaves(self, record: Input) -> bool:
        return isinstance(record, Respawned | Dismissed) and record.seat == self._seat

    def _keep(self, client: ClientSnapshot, given: Joystick, record: WorldTick) -> None:
        seen, action = observation_of(client, self._config), self._points.nearest((given.x, given.y))
        if isinstance(record, DriveTick):
            seen = {**seen, JOYSTICK_KEY: np.array([record.stick.x, record.stick.y], np.float32)}
            action = record.action
        self.seen.append(seen)
        self.actions.append(action)
        self.delays.append(delay_ticks(self._config, client.drawn))

"""Rides as observations, to compare policies on: a short new one, or a recorded one replayed."""

import math
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.agents.envs.episode_view import Info, find_episode_delay_ticks
from wcsim.agents.envs.seat_driver import AgentSeatDriver
from wcsim.agents.policy_api import (
    JOYSTICK_KEY,
    Observation,
    Policy,
    sense_settings,
    senses_of,
)
from wcsim.bridge.replay.replayed import config_of, log_of, replayed
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.core import seeding
from wcsim.core.reading import escape
from wcsim.errors import ConfigError
from wcsim.log.reader import read_header
from wcsim.log.records import Dismissed, DriveTick, Header, Input, Respawned, WorldTick
from wcsim.log.writer import JOURNAL
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import make_observation
from wcsim.towns.scenario.town import find_town
from wcsim.types import F32, SeatSpec
from wcsim.users.recordings.recorded_user import find_user

TRIES: Final = 5  # episodes, until one is long enough
_PUSH_TICKS: Final = 20  # of a push in one direction, and of the user's own stick before the next
_WIDEST_RAD: Final = 2.0  # of a push, from ahead


def reference_ride(
    town: str, config: RunConfig, steps: int, policy: Policy, seed: int = 0
) -> list[Observation]:
    """Observations of consecutive ticks of one episode, in which a policy drives one chair.

    A user who never errs would leave the policy nothing to do, and a blind policy would do as well.
    So the stick is by turns the simulated user's, and pushed to its end in a random direction.

    Args:
        town: A folder or a name.
        config: Of the policy's run.
        steps: The length of the ride. Where all of `TRIES` episodes end before, the longest counts.
        policy: Drives the chair.
        seed: Of the world and the pushes.

    Raises:
        TownError: The town cannot be opened.
    """
    sensing = resolve(config, sense_settings(config, senses_of(policy)))
    spec = SeatSpec(profile=config.env.profile, max_steps=steps + 1)
    # The pushed stick at each step, (steps, 2) in -1..1; NaN where it is the user's own.
    turns = steps // _PUSH_TICKS + 1
    angles_rad = seeding.make_rng(seed, "pushes").uniform(-_WIDEST_RAD, _WIDEST_RAD, turns)
    pushes = np.full((steps, 2), math.nan, np.float32)
    for step in range(steps):
        turn = step // _PUSH_TICKS
        if turn % 2:
            pushes[step] = math.sin(angles_rad[turn]), math.cos(angles_rad[turn])

    longest, tries = list[Observation](), 0
    with World(find_town(town), sensing, (spec,), seed, find_user=find_user) as world:
        policy.begin()
        agent = _PushedAgent(policy, pushes)
        driver = AgentSeatDriver(sensing, agent, world.snapshot.clients[0])
        for tick in rollout(world, {0: driver.choose}):
            (client,) = tick.after.clients
            driver.finish_step(client)
            if client.first is None and len(agent.seen) < steps:
                continue
            longest, tries = max(longest, agent.seen, key=len), tries + 1
            if len(longest) == steps or tries == TRIES:
                break
    return longest


@dataclass(frozen=True, slots=True, kw_only=True)
class _RecordedRide:
    """Consecutive ticks of one episode."""

    seen: tuple[Observation, ...]
    actions: tuple[int, ...]  # that the recorded driver chose
    delay_ticks: int  # from a command to the chair that obeys it


def read_ride_header(path: Path) -> Header:
    """The header of a drive, a journal, or the run folder with one. Raises JournalError."""
    return read_header(_recording_file(path))


def recorded_ride(path: Path, steps: int, seat: int = 0) -> _RecordedRide:
    """The first episode of a seat in a recording, with `steps` ticks at most.

    Args:
        path: A drive, a journal, or the run folder with one.
        steps: The most ticks.
        seat: Of a journal.

    Raises:
        TownError: Its town is missing, or has changed.
        ConfigError: Its settings cannot be used here, or the seat has no tick.
        JournalError: It is no recording, or damaged.
    """
    path = _recording_file(path)
    log = log_of(path)
    reader = _EpisodeReader(config_of(read_header(path)), seat, steps)
    with closing(replayed(log, before=reader.read)) as records:
        for _ in records:
            if reader.ended:
                break
    if not reader.seen:
        raise ConfigError(f"{escape(path)}: seat {seat} has no tick; expected another --seat")
    return _RecordedRide(
        seen=tuple(reader.seen), actions=tuple(reader.actions), delay_ticks=reader.delay_ticks
    )


class _PushedAgent:
    """A policy whose stick is pushed; `seen` is what it observed in this episode."""

    def __init__(self, policy: Policy, pushes: F32) -> None:
        """`pushes`: (N, 2) the stick at each step, NaN where it is the user's own."""
        self.seen: list[Observation] = []
        self._policy, self._pushes = policy, pushes

    def reset(self, info: Info) -> None:
        """Start an episode; the policy assumes the configured delay, as its export does."""
        self.seen = []
        self._policy.reset()

    def act(self, observation: Observation, info: Info) -> int:
        """The policy's action."""
        push = self._pushes[len(self.seen)]
        if not np.isnan(push).any():
            observation = {**observation, JOYSTICK_KEY: push}
        self.seen.append(observation)
        return self._policy.act(observation)


class _EpisodeReader:
    """Collects the observations and actions of a seat's first episode.

    Args:
        config: Of the recorded world.
        seat: Which seat.
        steps: The most ticks.
    """

    def __init__(self, config: RunConfig, seat: int, steps: int) -> None:
        self._config, self._seat, self._steps = config, seat, steps
        self._positions = action_set(config.env.actions)
        self.seen: list[Observation] = []
        self.actions: list[int] = []
        self.delay_ticks = 0
        self.ended = False

    def read(self, world: World | None, record: Input) -> None:
        """Take in a record, with the world before it, until the episode has ended."""
        started = bool(self.actions)
        if world is None or not isinstance(record, WorldTick):
            leaves = isinstance(record, Respawned | Dismissed) and record.seat == self._seat
            self.ended = started and leaves
            return
        stick = next((each.joystick for each in record.commands if each.seat == self._seat), None)
        client = next((each for each in world.snapshot.clients if each.seat == self._seat), None)
        if stick is None or client is None:
            self.ended = started
            return
        if len(self.actions) == self._steps or (started and client.first is not None):
            self.ended = True
            return

        frame = client.first or client
        seen = make_observation(frame, self._config)
        action = self._positions.nearest((stick.x, stick.y))
        # A drive also has the stick that the policy answered, and the policy's own choice.
        if isinstance(record, DriveTick):
            seen = {**seen, JOYSTICK_KEY: np.array([record.stick.x, record.stick.y], np.float32)}
            action = record.action
        if not started:
            self.delay_ticks = find_episode_delay_ticks(self._config, frame.drawn)
        self.seen.append(seen)
        self.actions.append(action)


def _recording_file(path: Path) -> Path:
    return path / JOURNAL if path.is_dir() else path

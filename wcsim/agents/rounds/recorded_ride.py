"""One drive as observations, for policies to be compared on: a short new one, or a recorded one made again."""

import math
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from wcsim.agents.envs.episode_view import Info, find_episode_delay_ticks
from wcsim.agents.envs.seat_driver import AgentSeatDriver
from wcsim.agents.policy_api import JOYSTICK_KEY, Observation, Policy, sense_settings, senses_of
from wcsim.bridge.replay.replayed import Log, config_of, log_of, replayed
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
from wcsim.types import F32, ClientSnapshot, Joystick, SeatSpec
from wcsim.users.recordings.recorded_user import find_user

PUSH_TICKS: Final = 20  # so long the stick is held somewhere, and so long the user has it again
TRIES: Final = 5  # episodes, until one is long enough
_WIDEST_RAD: Final = 2.0  # of a push, from ahead


def reference_ride(town: str, config: RunConfig, steps: int, policy: Policy, seed: int = 0) -> list[Observation]:
    """Observations of so many successive ticks of one chair that a policy drives, all of one episode.

    By turns the stick is the simulated user's, and pushed to its end in one direction, towards whatever is there: a
    user who never errs would give a policy nothing to do, and a blind one would do as well. Where the episode ends it
    begins anew; where each one ends it is the longest, with fewer steps. Raises TownError.
    """
    sensing = resolve(config, sense_settings(config, senses_of(policy)))
    spec = SeatSpec(profile=config.env.profile, max_steps=steps + 1)
    pushes, longest = _pushed_sticks(steps, seed), list[Observation]()
    with World(find_town(town), sensing, (spec,), seed, find_user=find_user) as world:
        policy.begin()
        agent, tries = _Pushed(policy, pushes), 0
        driver = AgentSeatDriver(sensing, agent, world.snapshot.clients[0])
        for step in rollout(world, {0: driver.choose}):
            (client,) = step.after.clients
            driver.finish_step(client)
            if client.first is None and len(agent.seen) < steps:
                continue
            longest, tries = max(longest, agent.seen, key=len), tries + 1
            if len(longest) == steps or tries == TRIES:
                break
    return longest


class _Pushed:
    """Around a policy: the stick is pushed where it is not the user's own; `seen` is what it saw in this episode."""

    def __init__(self, policy: Policy, pushes: F32) -> None:
        self.seen: list[Observation] = []
        self._policy, self._pushes = policy, pushes

    def reset(self, info: Info) -> None:
        """Begin an episode; the policy reckons with the configured delay, as its export does."""
        self.seen = []
        self._policy.reset()

    def act(self, observation: Observation, info: Info) -> int:
        """Ask the policy."""
        push = self._pushes[len(self.seen)]
        self.seen.append(observation if np.isnan(push).any() else {**observation, JOYSTICK_KEY: push})
        return self._policy.act(self.seen[-1])


def _pushed_sticks(steps: int, seed: int) -> F32:
    """The stick at each step, (steps, 2) in -1..1; NaN where it is the user's own."""
    angles_rad = seeding.make_rng(seed, "pushes").uniform(-_WIDEST_RAD, _WIDEST_RAD, steps // PUSH_TICKS + 1)
    rows = [
        (math.sin(angles_rad[step // PUSH_TICKS]), math.cos(angles_rad[step // PUSH_TICKS]))
        if step // PUSH_TICKS % 2
        else (math.nan, math.nan)
        for step in range(steps)
    ]
    return np.array(rows, np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class _RecordedRide:
    """Successive ticks of one episode."""

    seen: tuple[Observation, ...]
    actions: tuple[int, ...]  # what the policy of then chose in each, whichever it was
    delay_ticks: int  # from a command to the chair that obeys it


def header_of(path: Path) -> Header:
    """What a recording says of itself: of a drive, a journal, or the run folder with one. Raises JournalError."""
    return read_header(_file_of(path))


def recorded_ride(path: Path, steps: int, seat: int = 0) -> _RecordedRide:
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
        raise ConfigError(f"{escape(path)}: seat {seat} has no tick; expected another --seat")
    delay = watch.delays[0]  # that of the episode
    return _RecordedRide(seen=tuple(watch.seen), actions=tuple(watch.actions), delay_ticks=delay)


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
        seen, action = make_observation(client, self._config), self._points.nearest((given.x, given.y))
        if isinstance(record, DriveTick):
            seen = {**seen, JOYSTICK_KEY: np.array([record.stick.x, record.stick.y], np.float32)}
            action = record.action
        self.seen.append(seen)
        self.actions.append(action)
        self.delays.append(find_episode_delay_ticks(self._config, client.drawn))

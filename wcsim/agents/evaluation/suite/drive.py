"""One block of a suite.

A fresh world, a policy in each of its chairs, one record for each episode.
"""

import signal
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final, Protocol, Self, runtime_checkable

from wcsim.agents.envs.episode_view import EnvStepResult, Info
from wcsim.agents.envs.seat_driver import AgentSeatDriver, ChairAgent, PolicyAgentAdapter
from wcsim.agents.evaluation.suite.alarms import Alarms, crash_alone_s
from wcsim.agents.evaluation.suite.records import (
    CRASHED,
    FINISHED,
    GAVE_UP,
    NOT_REACHED,
    POLICY_FAILED,
    REFUSED,
    TIMED_OUT,
    EpisodeRecord,
    Records,
)
from wcsim.agents.opening.list_file import BlockSetup, make_episode_seat_spec
from wcsim.agents.policies.dwa import VetoPolicy
from wcsim.agents.policy_api import Observation, Policy, Warns
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.config.suite import SuiteBlock
from wcsim.core.plugins import describe_user_code_error
from wcsim.errors import PolicyError, WcsimError
from wcsim.supervisor.actions import ActionSet, action_set
from wcsim.supervisor.kpi import KpiStep, make_crash_fields, sum_kpi_steps
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE
from wcsim.types import ClientSnapshot, Joystick
from wcsim.types.episode import RunPlace
from wcsim.users.recordings.recorded_user import find_user

LATE_S: Final = 10.0  # of processor time: a policy that needs longer for an answer has failed
# So much longer by the wall clock, for a policy that waits or a machine that is busy.
STARVED: Final = 5.0
# So much longer it has for the first one of an episode: it may load and compile.
FIRST_SHARE: Final = 6.0
# A user who overrules takes over after so many needless interventions, for so long.
_PATIENCE: Final = 2
_OVERRULED_S: Final = 20.0

MakePolicy = Callable[[], Policy]


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """What a process drives: one block with one policy; everything in it can be sent."""

    index: int  # of the block in its list
    block: SuiteBlock
    town: str = ""  # a folder or a name
    settings: tuple[str, ...] = ()
    policy: str = ""
    # `policy` and others, which take turns in the seats; () for it alone.
    together: tuple[str, ...] = ()
    network: str = ""
    preset: str = "quick"
    judged: bool = False  # forks say whether an intervention was needed
    late_s: float = LATE_S
    hook: str = ""  # the user's own step hook, module:Class
    overrules: bool = False  # users take over for 20 s after two needless interventions


class Watch(Protocol):
    """Somebody who looks on while a block is driven, and changes nothing.

    It ends when `seats` have ended.
    """

    @property
    def seats(self) -> frozenset[int]:
        """Those that are looked at."""

    def see(self, seat: int, step: EnvStepResult, world: World, policy: Policy) -> None:
        """A step of one of them is done; `policy` is who drives it."""

    def ended(self, seat: int, world: World) -> None:
        """An episode has ended; its chair is about to leave the street."""


def drive_block(
    piece: Piece, place: BlockSetup, make_policy: MakePolicy, watch: Watch | None = None
) -> Records:
    """Drive all episodes of a block, each to its end; records in the order of the block.

    With somebody to watch, those alone that have ended when the last of the watched ones has.

    Raises:
        TownError: The town cannot be opened.
        PolicyError: `make_policy` made none.
    """
    block = piece.block
    # Whatever a network learned in: it is judged in the engine.
    config = resolve(place.config, (*block.settings, "world.draw_threads=1", "world.rolling=false"))
    policies = [make_policy() for _ in block.episodes]
    specs = tuple(
        make_episode_seat_spec(place, *each) for each in zip(block.episodes, policies, strict=True)
    )
    with World(
        place.town, config, specs, place.seed, RunPlace(hook=piece.hook), find_user=find_user
    ) as world:
        seats = [
            _Seat(piece, config, world, number, policy) for number, policy in enumerate(policies)
        ]
        watched = seats
        if watch is not None:
            watched = [seat for seat in seats if seat.number in watch.seats]
            for seat in watched:
                seat.watch = watch
        for step in rollout(world, {seat.number: seat.choose for seat in seats}):
            for client in step.after.clients:
                seats[client.seat].take(client)
            if all(seat.record is not None for seat in watched):
                break
            _judge_together(seats)
    return tuple(seat.record for seat in seats if seat.record is not None)


@runtime_checkable
class _JudgesTogether(Policy, Protocol):
    """A policy whose network is called once for all chairs that it drives."""

    def judge_together(self, seen: Sequence[tuple[Self, Observation]]) -> None:
        """Take in what those of one network see now; each of them chooses for that next."""


def _judge_together(seats: Sequence["_Seat"]) -> None:
    """Before a tick: one call of the network for all seats that one drives by now."""
    groups = defaultdict[str, list[tuple[_JudgesTogether, Observation]]](list)
    for seat in seats:
        policy = seat.policy.inner if isinstance(seat.policy, VetoPolicy) else seat.policy
        if seat.is_taken_over and isinstance(policy, _JudgesTogether):
            groups[policy.name].append((policy, seat.observation))
    for group in groups.values():
        # Who fails here fails again when it chooses, and alone: the others of the block go on.
        with suppress(Exception):
            group[0][0].judge_together(group)


class _Seat:
    """One episode while it lasts.

    `record` is there once it has ended, and the chair has left the street.
    """

    def __init__(
        self, piece: Piece, config: RunConfig, world: World, number: int, policy: Policy
    ) -> None:
        self.number, self.record = number, None  # type: int, EpisodeRecord | None
        self.watch: Watch | None = None
        self._piece, self._config, self._world = piece, config, world
        self._episode = piece.block.episodes[number]
        self.policy = policy
        self._steps: list[KpiStep] = []  # from the handover on
        self._alarms = Alarms(config.world.tick_s)
        self._step = 0  # of the episode
        self._done_m = self._before_m = 0.0
        self._needless = 0  # since the user overruled
        self._actions = action_set(config.env.actions)
        agent = PolicyAgentAdapter(policy, self._actions, config.world.users_help_ticks)
        self._handover = _Handover(agent, self._episode.handover_step, self._actions)
        self._driver = AgentSeatDriver(config, self._handover, world.snapshot.clients[number])

    @property
    def is_taken_over(self) -> bool:
        """Whether the policy drives, and has chosen once."""
        return self.record is None and self._handover.left < 0

    @property
    def observation(self) -> Observation:
        """The newest one."""
        return self._driver.observation

    def choose(self, now: ClientSnapshot) -> Joystick | None:
        """The stick of the policy, or of the user before the handover.

        None when it fails, which ends the episode.
        """
        driven = self._step - self._episode.handover_step
        try:
            with _at_most(self._piece.late_s * (FIRST_SHARE if driven <= 0 else 1.0)):
                stick = self._driver.choose(now)
        except Exception as error:  # whatever a policy does wrong, the others of the block go on
            self._end(
                POLICY_FAILED,
                str(error) if isinstance(error, WcsimError) else describe_user_code_error(error),
            )
            return None
        if driven >= 0:
            self._look_at(self._driver.action, driven)
        return stick

    def take(self, client: ClientSnapshot) -> None:
        """What came of the tick."""
        alone = self._step < self._episode.handover_step
        step = self._driver.finish_step(client)
        self._step += 1
        if alone:
            self._before_m += step.info["progress_m"]
        else:
            self._done_m += step.info["progress_m"]
            self._steps.append(KpiStep.of(step.info))
        if self.watch is not None:
            self.watch.see(self.number, step, self._world, self.policy)
        events = client.events
        if events.crashed:
            tick_s, reward = self._config.world.tick_s, self._config.reward
            self._end(
                CRASHED, **make_crash_fields(events, client.contacts, self._steps, tick_s, reward)
            )
        # One that draws its goals goes on to the next.
        elif events.arrived and self._episode.goal_m is not None:
            self._end(FINISHED)
        elif events.gave_up and self._episode.goal_m is not None:
            self._end(GAVE_UP)
        elif events.truncated:
            self._end(TIMED_OUT)

    def _look_at(self, action: int, driven: int) -> None:
        """Note an intervention and a warning of a step; the first tick of each is judged."""
        stick = self._driver.observation["joystick"]
        far = self._actions.distance(action, (float(stick[0]), float(stick[1])))
        taken = far > self._config.reward.max_follow_distance + DISTANCE_TOLERANCE
        warned = self.is_taken_over and isinstance(self.policy, Warns) and self.policy.warning
        begins = self._alarms.begin(driven, taken, warned)
        if not begins or not (self._piece.judged or self._piece.overrules):
            return
        tick_s = self._config.world.tick_s
        crash_s = crash_alone_s(self._world, self.number, self._actions, tick_s)
        self._alarms.alone_s[driven] = crash_s
        if taken and crash_s is None and driven == self._alarms.taken[-1][0]:
            self._needless += 1
        if self._piece.overrules and self._needless == _PATIENCE:
            self._needless = 0
            self._handover.left = round(_OVERRULED_S / tick_s)

    def _end(self, status: str, reason: str = "", **more: Any) -> None:
        # A neighbour who was taken over before may have changed the street: nobody is
        # charged with what came of it.
        if self._step <= self._episode.handover_step and status != POLICY_FAILED:
            status, more = (
                NOT_REACHED,
                {name: more[name] for name in ("reason", "crash") if name in more},
            )
        tick_s = self._config.world.tick_s
        sums = sum_kpi_steps(self._steps, tick_s)
        crash, own = sums["steps"] if status == CRASHED else None, more.get("fault") == "own"
        warned, to_warn, false = self._alarms.warnings(
            crash if own else None, None if own else crash
        )
        (plant,) = (
            client.plant for client in self._world.snapshot.clients if client.seat == self.number
        )
        x_m, y_m, _ = plant.p_WB_m.tolist()
        left_m = max(0.0, self._episode.route_m - self._before_m)
        self.record = _record(
            self._piece,
            self.number,
            status,
            reason,
            time_s=round(sums["steps"] * tick_s, 6),
            route_m=round(left_m, 6),
            done_m=round(left_m if status == FINISHED else max(0.0, self._done_m), 6),
            missed=own and self._alarms.missed(crash or 0),
            warned=warned,
            to_warn=to_warn,
            false_warnings=false,
            interventions=self._alarms.interventions(),
            judged=self._piece.judged,
            end_m=(round(x_m, 3), round(y_m, 3)),
            **sums,
            **more,
        )
        if self.watch is not None:
            self.watch.ended(self.number, self._world)
        self._world.dismiss(self.number)


class _Handover:
    """Around an agent: for `left` steps the user drives alone, on the grid of actions."""

    def __init__(self, agent: ChairAgent, steps: int, actions: ActionSet) -> None:
        self._agent, self._actions = agent, actions
        self._steps = self.left = steps

    def reset(self, info: Info) -> None:
        """Begin an episode, in which the agent has one of its own from the handover on."""
        self.left = self._steps

    def act(self, observation: Observation, info: Info) -> object:
        """The action nearest to the user's stick, or the agent's."""
        self.left -= 1
        if self.left >= 0:
            return self._actions.nearest(observation["joystick"])
        if self.left == -1:
            self._agent.reset(info)
        return self._agent.act(observation, info)


@contextmanager
def _at_most(limit_s: float) -> Iterator[None]:
    """Raise PolicyError in the process's main thread after `limit_s` of its own time.

    On a busy machine a kernel that is compiled may take a multiple by the wall clock, and must not
    be interrupted.
    """
    started_s, started_cpu_s = time.monotonic(), time.process_time()

    def late(_number: int, _frame: FrameType | None) -> None:
        if (
            time.process_time() - started_cpu_s < limit_s
            and time.monotonic() - started_s < STARVED * limit_s
        ):
            signal.setitimer(signal.ITIMER_REAL, limit_s)
            return
        raise PolicyError(
            f"the policy gave no answer for {limit_s:g} s; expected one per tick: make it faster"
        )

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _record(piece: Piece, seat: int, status: str, reason: str, **more: Any) -> EpisodeRecord:
    """The record of a seat's episode; `more` is what was driven, by the names of its fields."""
    block = piece.block
    return EpisodeRecord(
        block=piece.index,
        seat=seat,
        part=block.part,
        town=block.town,
        profile=block.episodes[seat].profile,
        status=status,
        reason=reason[:400],
        **more,
    )


def refused(piece: Piece, reason: str) -> Records:
    """The records of a block whose policy cannot be used at all."""
    return tuple(
        _record(piece, seat, REFUSED, reason, route_m=episode.route_m)
        for seat, episode in enumerate(piece.block.episodes)
    )

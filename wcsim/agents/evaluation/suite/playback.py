"""Episodes of a suite driven once more, to look at how they ended.

What was seen, asked and given, and who was near.
"""

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, TypeVar

import numpy as np

from wcsim.agents.envs.episode_view import OBJECTS, EnvStepResult, env_to_policy_observation
from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.run import drive_piece
from wcsim.agents.policy_api import Policy
from wcsim.bridge.world import World
from wcsim.errors import ConfigError
from wcsim.physics.renderer.instances import ChairPose, chair_pose
from wcsim.supervisor.observation import Observation
from wcsim.types import F64, ActorState, Joystick, SignalState

NEAR_M: Final = 40.0  # who is farther from the chair is left out
# A playback makes no forks.
_OF_FORKS: Final = (
    "warned",
    "to_warn",
    "false_warnings",
    "interventions",
    "judged",
    "last_moment_s",
    "cause",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlayedStep:
    """A moment after a step; arrays are the observation's own."""

    seat: int
    step: int  # of the episode, the first is 1
    seen: Observation  # as the network gets it
    requested: Joystick  # by the user, before the step
    given: Joystick  # by the policy
    speed_mps: float
    motion: tuple[float, float]  # speed ahead, and turn rate in rad/s
    p_W_m: F64  # (3,) of the chair
    yaw_rad: float
    actors: tuple[ActorState, ...]  # within NEAR_M
    chairs: tuple[ChairPose, ...]  # all of the block that are in the street
    signals: tuple[SignalState, ...]


Draw = Callable[[World, Sequence[PlayedStep]], Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Played:
    """An episode that was driven once more."""

    record: EpisodeRecord
    steps: tuple[PlayedStep, ...]  # the last ones, oldest first
    drawn: Any  # what `draw` made of them, None where there was none


def play(
    piece: Piece, seats: Collection[int], steps: int, draw: Draw | None = None
) -> tuple[Played, ...]:
    """Drive a block until these seats have ended.

    Their last `steps` steps, in the order of the seats.

    Args:
        piece: The block and its policy; forks are left out.
        seats: Whose episodes.
        steps: How many are kept of each.
        draw: Is called with the world while the chair is still in it, and with what is kept.

    Raises:
        ConfigError: The block has no such seat.
        TownError, PolicyError: As in `drive_piece`.
    """
    there = range(len(piece.block.episodes))
    for seat in seats:
        if seat not in there:
            raise ConfigError(f"block {piece.index} has no seat {seat}; expected 0 to {there[-1]}")
    watch = _LastSteps(frozenset(seats), steps, draw)
    return tuple(
        Played(
            record=record,
            steps=tuple(watch.last.get(record.seat, ())),
            drawn=watch.drawn.get(record.seat),
        )
        for record in drive_piece(piece, watch)
        if record.seat in watch.seats
    )


def require_same(record: EpisodeRecord, last: EpisodeRecord) -> None:
    """Compare an episode with one that a result holds; what forks say is left out.

    Raises:
        ConfigError: They differ.
    """
    names = [field.name for field in fields(EpisodeRecord) if field.name not in _OF_FORKS]
    wrong = [name for name in names if getattr(record, name) != getattr(last, name)]
    if _spans(record) != _spans(last):
        wrong.append("interventions")
    if wrong:
        name = wrong[0]
        actual, expected = (str(getattr(item, name))[:60] for item in (record, last))
        raise ConfigError(
            f"episode {record.block}.{record.seat} differs from the saved one: {name} is "
            f"{actual}, expected {expected}; wcsim, the policy, its settings or the list "
            "has changed since the test: run the test again"
        )


def _spans(record: EpisodeRecord) -> list[tuple[int, int]]:
    return [(item.first, item.last) for item in record.interventions]


Placed = TypeVar("Placed", ActorState, ChairPose)


def _own(item: Placed) -> Placed:
    """A copy with arrays of its own: a snapshot's are good until the next tick."""
    arrays = ("p_W_m", "v_W_mps") if isinstance(item, ActorState) else ("p_WB_m", "q_WB")
    return replace(item, **{name: getattr(item, name).copy() for name in arrays})


class _LastSteps:
    """Keeps the last steps of some seats."""

    def __init__(self, seats: frozenset[int], steps: int, draw: Draw | None) -> None:
        self.seats, self._draw = seats, draw
        self.last: dict[int, deque[PlayedStep]] = {seat: deque(maxlen=steps) for seat in seats}
        self.drawn: dict[int, Any] = {}

    def see(self, seat: int, step: EnvStepResult, world: World, policy: Policy) -> None:
        """Keep a step."""
        info, snapshot = step.info, world.snapshot
        objects = info[OBJECTS]
        plant = objects.state
        p_W_m = np.array(plant.p_WB_m, np.float64)
        near = (
            _own(actor)
            for actor in snapshot.actors
            if np.hypot(*(actor.p_W_m - p_W_m)[:2]) <= NEAR_M
        )
        chairs = (
            _own(chair_pose(client.seat, client.plant, ego.chair.outline))
            for client, ego in zip(snapshot.clients, world.seats, strict=True)
        )
        self.last[seat].append(
            PlayedStep(
                seat=seat,
                step=objects.events.step,
                seen=env_to_policy_observation(step.observation),
                requested=objects.asked,
                given=objects.given,
                speed_mps=info["speed_mps"],
                motion=(float(plant.v_B_mps[0]), float(plant.w_B_radps[2])),
                p_W_m=p_W_m,
                yaw_rad=plant.yaw_rad,
                actors=tuple(near),
                chairs=tuple(chairs),
                signals=snapshot.signals,
            )
        )

    def ended(self, seat: int, world: World) -> None:
        """Draw what is to be drawn."""
        if self._draw is not None and self.last[seat]:
            self.drawn[seat] = self._draw(world, tuple(self.last[seat]))

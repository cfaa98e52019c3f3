"""Drives from a given start in which the user's stick is held, whatever comes; a policy answers it, or nobody."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np

from wcsim.agents.envs.seat_driver import AgentSeatDriver, PolicyAgentAdapter
from wcsim.agents.opening.named_policy import (
    list_policy_overrides,
    make_policy_seat_spec,
    open_named_policy,
    resolve_policy_config,
)
from wcsim.agents.policy_api import Warns
from wcsim.bridge.world import World
from wcsim.bridge.world_copy import in_copy
from wcsim.bridge.world_rollout import rollout
from wcsim.config import resolve
from wcsim.core.closing import ClosingContextBase
from wcsim.errors import ConfigError
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE, judge_crash_fault
from wcsim.supervisor.rollout import HOLD_S
from wcsim.towns.scenario.town import Town
from wcsim.types import ClientSnapshot, Joystick, Outline, StartSpec, UserView
from wcsim.users.user import User

LONGEST_S: Final = 8.0
STANDS_MPS: Final = 0.02


@dataclass
class StickHolder:
    """Whoever holds the stick in a seat: the same position until it is changed."""

    stick: Joystick = field(default_factory=lambda: Joystick(0.0, 0.0))

    def user(self, episode: int, outline: Outline) -> User:
        """See `_StickRecording`."""
        del episode, outline
        return _Held(self)

    def require_driven_here(self, town: str, town_sha256: Callable[[], str]) -> None:
        """It fits any town."""


class _Held(User):
    def __init__(self, hand: StickHolder) -> None:
        super().__init__(np.zeros((1, 2)))
        self._hand = hand

    @property
    def intent(self) -> Joystick:
        return self._hand.stick

    @property
    def joystick(self) -> Joystick:
        return self._hand.stick

    def move_hand(self, steps: int, dt_s: float) -> Joystick:
        del steps, dt_s
        return self._hand.stick

    def look(self, view: UserView) -> None:
        del view


Watch = Callable[[ClientSnapshot], object]
"""Looks on while a chair is driven: called with the frame of now when the policy has chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """What became of a drive; times in seconds from its start."""

    crash_s: float | None = None
    reason: str = ""
    fault: str = ""
    words: str = ""
    speed_mps: float = 0.0  # at its end
    warned_s: float | None = None
    taken_s: float | None = None  # when the policy first did otherwise than the stick
    taken_steps: int = 0
    steps: int = 0

    @property
    def own(self) -> bool:
        """Whether the chair crashed by its own fault."""
        return self.crash_s is not None and self.fault == "own"

    @property
    def ahead_s(self) -> float | None:
        """How long before the crash it warned; None without a crash or a warning."""
        return None if self.crash_s is None or self.warned_s is None else self.crash_s - self.warned_s


class HeldStreet(ClosingContextBase):
    """A world with one chair and one policy, which begins again wherever it is told to."""

    def __init__(self, town: Town, policy: str, plant: str, seed: int) -> None:
        """Open the town. Raises what a world and the opening of a policy raise."""
        rules = (f"chair.plant={plant}", "world.warmup_s=20.0")
        config = resolve_policy_config(policy, "quick", rules, in_list=True)
        self.policy = open_named_policy(policy, config, seed)
        self.config = resolve(config, list_policy_overrides(config, self.policy))
        self.hand = StickHolder()
        self.actions = action_set(self.config.env.actions)
        spec = replace(make_policy_seat_spec(self.policy, "held"), truth=True)
        self.world = World(town, self.config, (spec,), seed, find_user=lambda _name: self.hand)
        self._agent = PolicyAgentAdapter(self.policy, self.actions)
        self.driver: AgentSeatDriver

    @property
    def taken(self) -> bool:
        """Whether the newest command is otherwise than the stick."""
        stick, limit = self.hand.stick, self.config.reward.max_follow_distance
        return self.actions.distance(self.driver.action, (stick.x, stick.y)) > limit + DISTANCE_TOLERANCE

    def begin(self, start: StartSpec, stick: Joystick) -> bool:
        """Put the chair there; whether that could be, and it stands there while nobody drives it."""
        self.hand.stick = stick
        with suppress(ConfigError):
            self.driver = AgentSeatDriver(self.config, self._agent, self.world.respawn(0, start=start))
            _, end = json.loads(in_copy(self.world, partial(given, stick=Joystick(0.0, 0.0))))
            return not str(end)
        return False

    def drive(self, ticks: int, watch: Watch = lambda now: None) -> Driven:
        """Hold the stick for so many ticks, or until a crash."""
        tick_s, said = self.config.world.tick_s, Driven()

        def choose(now: ClientSnapshot) -> Joystick:
            chosen = self.driver.choose(now)
            watch(now)
            return chosen

        for step, done in zip(range(1, ticks + 1), rollout(self.world, {0: choose}), strict=False):
            (client,) = done.after.clients
            self.driver.finish_step(client)
            warns = isinstance(self.policy, Warns) and self.policy.warning
            now_s = (step - 1) * tick_s
            said = replace(
                said,
                steps=step,
                speed_mps=float(np.hypot(*client.plant.v_B_mps[:2])),
                taken_steps=said.taken_steps + self.taken,
                taken_s=now_s if self.taken and said.taken_s is None else said.taken_s,
                warned_s=now_s if warns and said.warned_s is None else said.warned_s,
            )
            if (events := client.events).crashed:
                whose = judge_crash_fault(events.crash_reason, client.contacts, self.config.reward)
                return replace(said, crash_s=step * tick_s, reason=events.crash_reason, fault=whose, words=events.crash)
        return said

    def close(self) -> None:
        """End the world."""
        self.world.close()


def given(world: World, stick: Joystick) -> bytes:
    """A command held for half a second and let go, in a copy: the seconds until it crashes or None, and how it ends."""
    world.go_blind()
    world.drop_step_limits()
    tick_s = world.config.world.tick_s
    held, last = round(HOLD_S / tick_s), round(LONGEST_S / tick_s)
    sticks = iter([stick] * held + [Joystick(0.0, 0.0)] * last)
    for tick, step in zip(range(1, last + 1), rollout(world, {0: lambda _now: next(sticks)}), strict=False):
        (client,) = step.after.clients
        if client.events.crashed:
            whose = judge_crash_fault(client.events.crash_reason, client.contacts, world.config.reward)
            return json.dumps((tick * tick_s, whose)).encode()
        speed = math.hypot(*client.plant.v_B_mps[:2].tolist()) + abs(float(client.plant.w_B_radps[2]))
        if tick > held and speed < STANDS_MPS:
            break
    return json.dumps((None, "hangs" if world.seats[0].chair.hanging else "")).encode()

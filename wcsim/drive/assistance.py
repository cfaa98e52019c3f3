"""The policy beside a person: switched on or off, set to a level, and overruled while it drives."""

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from wcsim.agents.envs.episode_view import OBJECTS, InfoObjects
from wcsim.agents.envs.seat_driver import PolicyAgentAdapter
from wcsim.agents.policy_api import HearsSent, Levelled, Observation, Policy, TellsUnsafe, Warns
from wcsim.errors import PolicyError, WcsimError
from wcsim.supervisor.actions import ActionSet
from wcsim.supervisor.kpi import FOLLOWED
from wcsim.types import Drawn

log = logging.getLogger("wcsim.drive")


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What came of one question to the policy."""

    chosen: int  # the policy's own action; where it is off, the action nearest to the stick
    sent: int  # the action that the chair is told
    warning: bool = False
    intervening: bool = False  # the action sent no longer follows the stick
    unsafe: tuple[int, ...] = ()


class Assistance:
    """A policy that may be off or overruled. It still sees every tick, so that it knows the street.

    After a request for help it assists for a while, even if it was off; see `Helping`.

    Args:
        policy: Drives; `reset` begins it with its first episode.
        actions: The joystick positions.
        help_ticks: How long it helps after a request.
    """

    def __init__(self, policy: Policy, actions: ActionSet, help_ticks: int = 0) -> None:
        self._on, self.failed = True, ""  # `failed`: why a policy that broke is off
        self._agent, self._actions = PolicyAgentAdapter(policy, actions, help_ticks), actions
        self._drawn: Drawn | None = None  # for the current episode
        self.own_level = self.level  # the level that the policy came with

    @property
    def name(self) -> str:
        """The name of the policy."""
        return self._agent.policy.name

    @property
    def on(self) -> bool:
        """Whether the policy decides, because it is switched on or helps."""
        return not self.failed and (self._on or self.help_left > 0)

    @property
    def help_left(self) -> int:
        """Ticks for which it still helps; 0 while no help is on."""
        return self._agent.help.left

    @property
    def levels(self) -> tuple[float, float] | None:
        """The levels that assist least and most; None for a policy without levels."""
        return self._agent.policy.levels if isinstance(self._agent.policy, Levelled) else None

    @property
    def level(self) -> float | None:
        """The current level; None for a policy without levels."""
        return self._agent.policy.level if isinstance(self._agent.policy, Levelled) else None

    @property
    def tells_unsafe(self) -> bool:
        """Whether the policy says of every action whether it is unsafe."""
        return isinstance(self._agent.policy, TellsUnsafe)

    def switch(self, on: bool) -> None:
        """Switch the policy on or off. Off ends help; on tries a policy that broke again."""
        if on and self.failed:
            self.failed = ""
            self._guarded(self._anew)
        if not on:
            self._guarded(self._agent.help.end)
        self._on = on and not self.failed

    def ask_for_help(self) -> None:
        """Help from now on, or for the full time again. A policy that broke does not help."""
        if not self.failed:
            self._guarded(self._agent.help.request)

    def end_tick(self) -> None:
        """A tick has been driven: the time of help runs down."""
        self._guarded(self._agent.help.tick)

    def set_level(self, level: float) -> None:
        """Set the level, which ends help.

        Raises:
            PolicyError: The policy has no levels, or this one is out of bounds.
        """
        if not isinstance(self._agent.policy, Levelled):
            raise PolicyError(
                f"policy {self.name!r} has no adjustable level; expected dwa or a danger network"
            )
        try:
            self._agent.help.end()
            self._agent.policy.set_level(level)
        except WcsimError:
            raise
        except Exception as error:
            self._broken(error)

    def reset(self, drawn: Drawn | None) -> None:
        """An episode begins with the draws `drawn`; a policy that broke does not see it."""
        self._drawn = drawn
        if not self.failed:
            self._guarded(self._anew)

    def close(self) -> None:
        """Close the policy, if it can be closed."""
        close = getattr(self._agent.policy, "close", None)
        if close is not None:
            close()

    def answer(self, seen: Observation, info: dict[str, Any], asked: bool) -> Answer:
        """What the chair is to do.

        A policy that raises is switched off, and the chair stands in that tick. `failed` says why.

        Args:
            seen: The observation, with the stick in it.
            info: Of the same moment.
            asked: The policy may decide: it is not overruled, and the user does not drive alone
                before a handover.
        """
        own = self._actions.nearest(seen["joystick"])
        if self.failed:
            return Answer(chosen=own, sent=own)
        try:
            return self._answered(seen, info, own, asked)
        except Exception as error:
            # Whatever a policy does wrong, the chair must not drive on with the person in it.
            self._broken(error)
            rest = self._actions.nearest((0.0, 0.0))
            return Answer(chosen=rest, sent=rest)

    def _answered(self, seen: Observation, info: dict[str, Any], own: int, asked: bool) -> Answer:
        policy = self._agent.policy
        chosen = self._agent.help.choice(self._agent.choose(seen, info))
        sent = chosen if self.on and asked else own
        if isinstance(policy, HearsSent):
            policy.sent(sent)
        far = self._actions.distance(sent, tuple(float(part) for part in seen["joystick"]))
        warns = isinstance(policy, Warns) and policy.warning
        return Answer(
            chosen=chosen if self.on else own,
            sent=sent,
            warning=bool(self.on and warns),
            intervening=self.on and asked and far > FOLLOWED,
            unsafe=tuple(policy.unsafe.nonzero()[0].tolist())
            if self.on and isinstance(policy, TellsUnsafe)
            else (),
        )

    def _anew(self) -> None:
        self._agent.help.end()
        self._agent.reset({OBJECTS: InfoObjects(drawn=self._drawn)})

    def _guarded(self, call: Callable[[], object]) -> None:
        try:
            call()
        except Exception as error:
            self._broken(error)

    def _broken(self, error: Exception) -> None:
        """Switch off a policy that raised."""
        self._on = False
        self.failed = (
            str(error) if isinstance(error, WcsimError) else f"{type(error).__name__}: {error}"
        )
        self.failed = self.failed or type(error).__name__
        with suppress(Exception):  # a second failure does not matter
            self._agent.help.end()
        log.warning("policy %s failed, assistance is off: %s", self.name, self.failed)

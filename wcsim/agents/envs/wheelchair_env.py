"""One wheelchair as a Gymnasium environment: `gymnasium.make("wcsim/Street-v1", town="helsinki")`.

The world behind it lives in this process when none does yet, otherwise in a process of its own; trajectories are the
same to the bit. A finished chair is respawned by the world within the tick that ended it, so `reset()` without a seed
only hands out the frame that is already there; `reset(seed=s)` makes the whole world anew.

With `join` the environment makes no world: it takes its seat in a running one, which other clients share.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt

from wcsim.agents.envs.env_spec import (
    RENDER_FPS,
    RENDER_MODES,
    SEED_LIMIT,
    EnvOptions,
    checked_seed,
    drawn_seed,
    make_face,
)
from wcsim.agents.envs.episode_view import Chair, Seen
from wcsim.core import seeding
from wcsim.errors import EvictedError, ProtocolError, ReplayMismatchError, WorldRestartedError
from wcsim.server.links.base import Seat, SeatGroup, Waits, open_group
from wcsim.server.specs import SeatRequest, WorldOrder
from wcsim.types import F32, ClientSnapshot

MOST_REPEATED = 100_000  # steps that a copy drives again, at most; they take 10 minutes or more


class WheelchairEnv(gymnasium.Env[Seen, np.int64 | F32]):
    """One wheelchair in a town, for Gymnasium.

    A copy of it, by `copy.deepcopy` or from bytes, makes a world of its own and drives again all that was driven since
    the last world was made. It is then where this one is, to the bit, and goes on alone.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}  # noqa: RUF012 (Gymnasium's own)

    def __init__(
        self,
        town: str = "helsinki",
        *,
        towns: Sequence[str] = (),
        join: SeatRequest | Seat | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Describe the environment; the world is made, or joined, by the first reset.

        Args:
            town: A town's name or folder.
            towns: Further towns. When an episode ends after `config.epoch_ticks` steps in a town, the next follows.
                The seed of a reset says which comes first.
            join: Take this seat in a running world instead, or go on with one that was taken before. The server sets
                town, seed, run and hook. Cameras and actions must match the server's. `join.spec` sets user and episode
                length.
            **options: config, preset, overrides, seed, reward_terms, render_mode, run, hook: see `EnvOptions`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        self._face = make_face(town, options, ("town", "towns", "join"))
        self.metadata = {**self.metadata, "render_fps": self._face.metadata["render_fps"]}
        self._join = join
        self._towns, self._root_seed, self._turn, self._steps = (town, *towns), 0, 0, 0
        self.on_town: Callable[[str], object] | None = None  # called with each town of several
        self._first_seed = checked_seed(options.get("seed"))
        self._driven: list[object] = []  # actions since the world was made; None for a reset
        self._own: SeatGroup | None = None  # the world, where no server has it
        self._link: Seat | None = None
        self._waits_no_more = False
        self.due_work: Callable[[], Callable[[], None] | None] | None = (
            None  # to be done while a step is waited for
        )
        terms = tuple(options.get("reward_terms", ()))
        with suppress(
            TypeError
        ):  # one that holds a file or the like cannot be copied, and is taken as it is
            terms = copy.deepcopy(terms)  # others may have these as well
        self._chair = Chair(self._face.config, terms)
        self.town, self.config, self.render_mode = town, self._face.config, self._face.render_mode
        # Gymnasium types the space of a dictionary as a dictionary of spaces, which a Dict space is not.
        self.observation_space = self._face.observation_space()  # type: ignore[assignment]
        self.action_space = self._face.action_space()  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Seen, dict[str, Any]]:
        """Begin an episode; with a seed, in a world made anew.

        In a joined world the first reset hands out the frame that the seat has, whatever the seed, for the world is
        the server's. A later one with a seed asks for the world to be begun again, which only the master may.

        Raises:
            ConfigError: The seed is no integer from 0 on.
            TownError: The town cannot be used.
            NotMasterError: Others share the world, and this client is not its master.
            LinkError: See `wcsim.errors` for what else a client can see.
        """
        seed = checked_seed(seed)
        super().reset(seed=seed)
        return self._chair.begin(self._first_frame(seed))

    def step(self, action: np.int64 | int | F32) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Drive for one tick; terminated by a crash only, truncated after `env.max_steps`.

        Truncated too when a shared world began again: with the last observation once more, reward 0 and
        `info["reason"] == "world_restarted"`; the next reset hands out the new epoch's first frame.

        Raises:
            BadActionError: There is no such action.
            ProtocolError: No episode is on.
            EvictedError: A server gave this client up; the next reset joins again.
            LinkError: See `wcsim.errors` for what else a client can see.
        """
        if (link := self._link) is None:
            raise ProtocolError("step() came before reset(); call reset() first")
        try:
            command = self._chair.command(action)
            link.send(command.tick, command.joystick)
            work = None if self.due_work is None else self.due_work()
            if work is not None:
                link.while_waiting(work)
            after, self._steps = link.receive(), self._steps + 1
            self._note(copy.copy(action))
            return self._chair.take(after)
        except WorldRestartedError:
            return self._chair.cut()
        except EvictedError:
            self.close()
            raise

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The first camera's picture (H, W, 3) uint8, in render mode "rgb_array"; a joined world must draw colours."""
        return self._chair.picture if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Leave the world; a second call does nothing."""
        held = self._own or self._held
        self._own = self._link = self._chair.now = None
        if held is not None:
            held.close()

    @property
    def epoch(self) -> int:
        """The epoch of the world that the last frame is of; -1 where there is none."""
        return -1 if self._link is None else self._link.epoch

    @property
    def waits(self) -> Waits:
        """Where the time in the link went so far."""
        return Waits() if self._link is None else self._link.waits

    def beat(self, progress: int) -> None:
        """Show a server that a long computation goes on, by a counter that rises."""
        if (link := self._held) is not None:
            link.beat(progress)

    def wait_less(self) -> None:
        """From now on a world that is silent for some seconds is gone; may be called by a signal's handler."""
        if (link := self._held) is not None:
            link.wait_less()

    def wait_no_more(self) -> None:
        """From now on waiting for the world is a ServerGoneError; may be called by a signal's handler."""
        self._waits_no_more = True
        if self._link is not None:
            self._link.wait_no_more()

    @property
    def _held(self) -> Seat | None:
        """The link; one that was taken before is held before the first reset too."""
        return self._join if self._link is None and isinstance(self._join, Seat) else self._link

    def _first_frame(self, seed: int | None) -> ClientSnapshot:
        """The first frame of the next episode; a world whose step was interrupted is made, or joined, anew."""
        if self._link is not None and self._link.interrupted:
            self.close()
        if self._link is not None and len(self._towns) > 1:
            if seed is None and 0 < self.config.epoch_ticks <= self._steps:
                self.close()
                return self._open(self._root_seed, self._turn + 1)
            if seed is not None:  # a world that is made anew by its link stays in its town
                self.close()
        link, now = self._link, self._chair.now
        if link is None:
            return self._open(seed if seed is not None else self._first_seed)
        if seed is not None:
            self._root_seed, self._driven = seed, []
            return link.rebuild(seed % SEED_LIMIT)
        if now is None:  # a new epoch has begun
            return link.join()
        self._note(None)
        if now.first is not None:
            return now.first
        try:
            return link.respawn()
        except WorldRestartedError:
            return link.join()

    def _open(self, seed: int | None, turn: int = 0) -> ClientSnapshot:
        if self._join is None:
            self._root_seed, self._turn, self._steps = (
                drawn_seed() if seed is None else seed,
                turn,
                0,
            )
            self._driven = []
            self._own = open_group(self._order())
            self._link = self._own.links[0]
        elif isinstance(self._join, Seat):
            self._link = self._join
        else:
            from wcsim.server.links.socket import (
                SocketSeat,
            )  # ZeroMQ is loaded only for a world of another process

            self._link = SocketSeat(self._join)
        if self._waits_no_more:  # requested before there was a link
            self._link.wait_no_more()
        try:
            return self._link.join()
        except BaseException:
            self.close()
            raise

    def _note(self, action: object) -> None:
        """Remember what was done, up to one more than a copy drives again."""
        if len(self._driven) <= MOST_REPEATED:
            self._driven.append(action)

    def __getstate__(self) -> dict[str, Any]:
        """All but the world, and what its owner has put in. Raises ProtocolError where it could not be made again."""
        if self._chair.now is not None and self._join is not None:
            raise ProtocolError(
                "a seat in a world that others share cannot be copied; call close() first"
            )
        if self._chair.now is not None and len(self._driven) > MOST_REPEATED:
            raise ProtocolError(
                f"a copy would drive more than {MOST_REPEATED} steps again; call reset(seed=...) or close() first"
            )
        return {**self.__dict__, "_own": None, "_link": None, "due_work": None, "on_town": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Be where the other one is, in a world of its own. Raises ReplayMismatchError where this machine differs."""
        self.__dict__.update(state)
        then, terms, driven = self._chair.now, self._chair.terms, self._driven
        if then is None:
            return
        self._chair.terms = ()  # they have seen it all
        try:
            self._chair.begin(self._open(self._root_seed, self._turn))
            for action in driven:
                if action is None:
                    self._chair.begin(self._first_frame(None))
                else:
                    self.step(action)  # type: ignore[arg-type]
            now = self._chair.now
            if now is None or (now.tick, now.plant, now.user) != (then.tick, then.plant, then.user):
                raise ProtocolError("it came elsewhere")
        except BaseException as error:
            self.close()
            if not isinstance(error, ProtocolError):
                raise
            told = "the copy is not where its original was; expected the same versions, town and processor model"
            raise ReplayMismatchError(f"{told}: {error}") from error
        self._chair.terms = terms

    def _order(self) -> WorldOrder:
        """The world of this turn: the seed says which of several towns comes first, and then they come in turn."""
        root, turn = self._root_seed, self._turn
        order = self._face.order(seeding.derive(root, "town", turn) if turn else root)
        if len(self._towns) == 1:
            return order
        self.town = self._towns[(seeding.derive(root, "towns") + turn) % len(self._towns)]
        if self.on_town is not None:
            self.on_town(self.town)
        return replace(order, town=self.town)

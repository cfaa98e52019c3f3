"""One wheelchair as a Gymnasium environment: `gymnasium.make("wcsim/Street-v1", town="helsinki")`.

Its world is in this process when none is yet, otherwise in a process of its own; trajectories are
the same to the bit. The world respawns a finished chair within the tick that ended its episode, so
`reset()` without a seed only returns the frame that is already there; `reset(seed=s)` makes a new
world.

With `join` the environment makes no world: it takes its seat in a running one, which other clients
share.
"""

import copy
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final, Unpack

import gymnasium
import numpy as np

from wcsim.agents.envs.env_spec import (
    RENDER_FPS,
    RENDER_MODES,
    SEED_LIMIT,
    TASK,
    TASK_DESCRIPTION,
    EnvOptions,
    draw_random_seed,
    make_env_settings,
    refuse_reset_options,
    validate_seed,
)
from wcsim.agents.envs.episode_view import EnvObservation, Info, SeatEnvAdapter
from wcsim.core import seeding
from wcsim.errors import EvictedError, ProtocolError, ReplayMismatchError, WorldRestartedError
from wcsim.server.links.base import LinkWaitTimes, SeatLink, SeatLinkGroup, open_seat_links
from wcsim.server.specs import SeatRequest, WorldBuildSpec
from wcsim.types import F32, U8, ClientSnapshot

MOST_REPEATED: Final = 100_000  # steps that a copy repeats; they take 10 minutes or more


class WheelchairEnv(gymnasium.Env[EnvObservation, np.int64 | F32]):
    """One wheelchair in a town, for Gymnasium.

    A copy of it, by `copy.deepcopy` or from bytes, makes its own world and repeats all steps since
    the last world was made. It then has the same state, to the bit.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}  # noqa: RUF012 (Gymnasium's own)
    task = TASK
    task_description = TASK_DESCRIPTION

    def __init__(
        self,
        town: str = "helsinki",
        *,
        towns: Sequence[str] = (),
        join: SeatRequest | SeatLink | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Describe the environment; the world is made, or joined, by the first reset.

        Args:
            town: A town's name or folder.
            towns: Further towns. When an episode ends after `config.epoch_ticks` steps in a town,
                the next follows. The seed of a reset determines the first one.
            join: Take this seat in a running world instead, or continue with one that was taken
                before. The server sets town, seed, run and hook. Cameras and actions must match the
                server's. `join.spec` sets user and episode length.
            **options: config, preset, overrides, seed, reward_terms, render_mode, run, hook: see
                `EnvOptions`.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        self._spec = make_env_settings(town, options, ("town", "towns", "join"))
        self.metadata = {**self.metadata, "render_fps": self._spec.metadata["render_fps"]}
        self._join = join
        self._towns = (town, *towns)
        self._root_seed = 0
        self._turn = 0  # which world of this seed
        self._steps = 0  # in this world
        self.on_town: Callable[[str], object] | None = None  # called with each town of several
        self._first_seed = validate_seed(options.get("seed"))
        self._driven: list[object] = []  # actions since the world was made; None for a reset
        self._own: SeatLinkGroup | None = None  # the world, where no server has it
        self._link: SeatLink | None = None
        self._waits_no_more = False
        # Returns work to be done while a step is awaited.
        self.due_work: Callable[[], Callable[[], None] | None] | None = None
        terms = tuple(options.get("reward_terms", ()))
        # Other environments may have the same terms. One that cannot be copied, as it holds a file,
        # is used as it is.
        with suppress(TypeError):
            terms = copy.deepcopy(terms)
        self._chair = SeatEnvAdapter(self._spec.config, terms)
        self.town = town
        self.config = self._spec.config
        self._max_episode_steps = self.config.env.max_steps  # as Gymnasium's TimeLimit has it
        self.render_mode = self._spec.render_mode
        # Gymnasium types the space of a dictionary as a dictionary of spaces, which a Dict is not.
        self.observation_space = self._spec.observation_space()  # type: ignore[assignment]
        self.action_space = self._spec.action_space()  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: Info | None = None
    ) -> tuple[EnvObservation, Info]:
        """Begin an episode; with a seed, in a new world.

        In a joined world the first reset returns the frame that the seat has, whatever the seed, as
        the world is the server's. A later one with a seed requests a restart of the world, which
        only the master may.

        Raises:
            ConfigError: The seed is no integer from 0 on, or there are options.
            TownError: The town cannot be used.
            NotMasterError: Others share the world, and this client is not its master.
            LinkError: See `wcsim.errors` for what else a client can see.
        """
        refuse_reset_options(options or ())
        seed = validate_seed(seed)
        super().reset(seed=seed)
        return self._chair.begin(self._first_frame(seed))

    def step(self, action: np.int64 | int | F32) -> tuple[EnvObservation, float, bool, bool, Info]:
        """Drive for one tick; terminated by a crash only, truncated after `env.max_steps`.

        Truncated also by the restart of a shared world: then with the last observation again,
        reward 0 and a true `info["world_restarted"]`; the next reset returns the first frame
        of the new epoch.

        Raises:
            BadActionError: There is no such action.
            ProtocolError: No episode is on.
            EvictedError: A server has removed this client; the next reset joins again.
            LinkError: See `wcsim.errors` for what else a client can see.
        """
        link = self._link
        if link is None:
            raise ProtocolError("step() came before reset(); call reset() first")
        try:
            command = self._chair.command(action)
            link.send(command.tick, command.joystick)
            work = None if self.due_work is None else self.due_work()
            if work is not None:
                link.while_waiting(work)
            after = link.receive()
            self._steps += 1
            self._record(copy.copy(action))
            return self._chair.finish_step(after)
        except WorldRestartedError:
            return self._chair.truncate()
        except EvictedError:
            self.close()
            raise

    def render(self) -> U8 | None:
        """The camera's picture (H, W, 3) uint8, in render mode "rgb_array".

        A joined world must draw colours.
        """
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
    def waits(self) -> LinkWaitTimes:
        """The times spent in the link so far."""
        return LinkWaitTimes() if self._link is None else self._link.waits

    def beat(self, progress: int) -> None:
        """Show a server that a long computation is running, by a counter that rises."""
        link = self._held
        if link is not None:
            link.beat(progress)

    def wait_less(self) -> None:
        """Give a silent world some seconds only, from now on; a signal's handler may call it."""
        link = self._held
        if link is not None:
            link.wait_less()

    def wait_no_more(self) -> None:
        """Make any wait for the world a ServerGoneError; a signal's handler may call it."""
        self._waits_no_more = True
        if self._link is not None:
            self._link.wait_no_more()

    @property
    def _held(self) -> SeatLink | None:
        """The link; a seat that was taken before is held before the first reset, too."""
        if self._link is None and isinstance(self._join, SeatLink):
            return self._join
        return self._link

    def _first_frame(self, seed: int | None) -> ClientSnapshot:
        """Go to the next episode; returns its first frame."""
        # 1. Leave a world whose step was interrupted, and a town whose turn is over.
        if self._link is not None and self._link.interrupted:
            self.close()
        if self._link is not None and len(self._towns) > 1:
            if seed is None and 0 < self.config.epoch_ticks <= self._steps:
                self.close()
                return self._open(self._root_seed, self._turn + 1)
            # Its link would make the new world in the same town.
            if seed is not None:
                self.close()
        # 2. A new world: opened, or restarted by its link.
        link = self._link
        if link is None:
            return self._open(self._first_seed if seed is None else seed)
        if seed is not None:
            self._root_seed = seed
            self._driven = []
            return link.rebuild(seed % SEED_LIMIT)
        # 3. The next episode in this world. Without a frame a new epoch has started.
        now = self._chair.now
        if now is None:
            return link.join()
        self._record(None)
        if now.first is not None:
            return now.first
        try:
            return link.respawn()
        except WorldRestartedError:
            return link.join()

    def _open(self, seed: int | None, turn: int = 0) -> ClientSnapshot:
        """Make a world, or take a seat in a running one; returns the first frame."""
        if self._join is None:
            self._root_seed = draw_random_seed() if seed is None else seed
            self._turn = turn
            self._steps = 0
            self._driven = []
            self._own = open_seat_links(self._enter_town())
            self._link = self._own.links[0]
        elif isinstance(self._join, SeatLink):
            self._link = self._join
        else:
            # ZeroMQ is loaded only for a world of another process.
            from wcsim.server.links.socket import SocketSeatLink

            self._link = SocketSeatLink(self._join)
        # Requested before there was a link.
        if self._waits_no_more:
            self._link.wait_no_more()
        try:
            return self._link.join()
        except BaseException:
            self.close()
            raise

    def _enter_town(self) -> WorldBuildSpec:
        """Set and announce the town of this turn; returns the order for its world.

        The seed determines the first of several towns; the others follow in turn.
        """
        seed = self._root_seed
        if self._turn:
            seed = seeding.derive_seed(self._root_seed, "town", self._turn)
        order = self._spec.order(seed)
        if len(self._towns) == 1:
            return order
        first = seeding.derive_seed(self._root_seed, "towns")
        self.town = self._towns[(first + self._turn) % len(self._towns)]
        if self.on_town is not None:
            self.on_town(self.town)
        return replace(order, town=self.town)

    def _record(self, action: object) -> None:
        """Store an action, up to one more than a copy repeats."""
        if len(self._driven) <= MOST_REPEATED:
            self._driven.append(action)

    def __getstate__(self) -> dict[str, Any]:
        """All but the world, and what its owner has put in.

        Raises ProtocolError where the world could not be made again.
        """
        if self._chair.now is not None and self._join is not None:
            raise ProtocolError(
                "a seat in a world that others share cannot be copied; call close() first"
            )
        if self._chair.now is not None and len(self._driven) > MOST_REPEATED:
            raise ProtocolError(
                f"a copy would drive more than {MOST_REPEATED} steps again; call reset(seed=...) "
                "or close() first"
            )
        return {**self.__dict__, "_own": None, "_link": None, "due_work": None, "on_town": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Repeat the original's steps in a new world.

        Raises ReplayMismatchError where they lead to another state on this machine.
        """
        self.__dict__.update(state)
        then = self._chair.now
        if then is None:
            return
        # The steps are replayed without reward terms, which have counted them already.
        terms = self._chair.terms
        driven = self._driven
        self._chair.terms = ()
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
            raise ReplayMismatchError(
                "the copy is not where its original was; expected the same versions, town and "
                f"processor model: {error}"
            ) from error
        self._chair.terms = terms

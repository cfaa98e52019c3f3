"""One wheelchair as an environment whose moments can be saved and gone back to, for search.

Its world lives in a process of its own. `save` makes a copy of that process where it stands
(`bridge/world_copy.py`), and `restore` goes on in a copy of the copy: the street, the chair, the
user and all chance, to the bit, at the price of no tick.
"""

import os
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Client, Connection, Listener
from typing import Unpack, cast

import gymnasium
import numpy as np

from wcsim.agents.envs.env_spec import EnvOptions
from wcsim.agents.envs.episode_view import EnvObservation, Info
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.bridge.world_copy import go_on_in_copy
from wcsim.core.closing import ClosingContextBase
from wcsim.core.processes import start_piped_process
from wcsim.errors import ProtocolError
from wcsim.types import F32, U8


class SavedMoment(ClosingContextBase):
    """A moment of a `SavingEnv`. It can be gone back to until it is closed."""

    def __init__(self, process: Connection) -> None:
        """Hold the copy that stands there."""
        self._process = process

    def fork(self) -> Connection:
        """Have a copy of the process that stands there, which serves at the other end."""
        with Listener(family="AF_UNIX") as listener:
            _request(self._process, "fork", listener.address)
            return listener.accept()

    def close(self) -> None:
        """Let go of it; a second call does nothing."""
        self._process.close()


class SavingEnv(gymnasium.Env[EnvObservation, np.int64 | F32]):
    """A `WheelchairEnv` with `save` and `restore`. It takes part in no world of others."""

    def __init__(self, town: str = "helsinki", **options: Unpack[EnvOptions]) -> None:
        """Describe the environment, as `WheelchairEnv` does.

        Args:
            town: A town's name or folder.
            **options: See `EnvOptions`. Pictures are drawn by one thread: no other is in a copy.

        Raises:
            ConfigError: The configuration cannot be used.
            TypeError: There is no such option.
        """
        own = (*options.get("overrides", ()), "world.draw_threads=1")
        options = EnvOptions(**{**options, "overrides": own})
        described = WheelchairEnv(town, **options)
        self.config, self.metadata = described.config, described.metadata
        self.observation_space = described.observation_space
        self.action_space = described.action_space
        self.render_mode = described.render_mode
        self._make = town, options
        # The process that made the world has its files, and makes the worlds of other seeds.
        self._first: SavedMoment | None = None
        self._now: SavedMoment | None = None

    def reset(
        self, *, seed: int | None = None, options: Info | None = None
    ) -> tuple[EnvObservation, Info]:
        """See `WheelchairEnv.reset`."""
        super().reset(seed=seed)
        if seed is not None:
            self._leave(self._first)
        if self._now is None:
            process, _ = start_piped_process(_serve, *self._make, name="wcsim-saving", daemon=True)
            self._first = self._now = SavedMoment(process)
        return cast("tuple[EnvObservation, Info]", self._call("reset", seed=seed, options=options))

    def step(self, action: np.int64 | int | F32) -> tuple[EnvObservation, float, bool, bool, Info]:
        """See `WheelchairEnv.step`."""
        return cast("tuple[EnvObservation, float, bool, bool, Info]", self._call("step", action))

    def render(self) -> U8 | None:
        """See `WheelchairEnv.render`."""
        return cast("U8 | None", self._call("render"))

    def save(self) -> SavedMoment:
        """The moment of now; it costs memory for what changes afterwards, and a process.

        Raises ProtocolError before the first reset.
        """
        return SavedMoment(self._at().fork())

    def restore(self, moment: SavedMoment) -> None:
        """Go back to a moment, also to one of an environment with the same options."""
        self._leave(SavedMoment(moment.fork()))

    def close(self) -> None:
        """End the world; saved moments stay. A second call does nothing."""
        self._leave(None)
        if self._first is not None:
            self._first.close()
            self._first = None

    def _leave(self, there: SavedMoment | None) -> None:
        """Go on there."""
        if self._now is not None and self._now is not self._first:
            self._now.close()
        self._now = there

    def _at(self) -> SavedMoment:
        if self._now is None:
            raise ProtocolError("there is no world yet; call reset() first")
        return self._now

    def _call(self, name: str, *args: object, **named: object) -> object:
        return _request(self._at()._process, name, *args, **named)


def _request(process: Connection, name: str, *args: object, **named: object) -> object:
    """What a method of the environment in that process returns. Raises what it raises."""
    try:
        process.send((name, args, named))
        done, result = process.recv()
    except (EOFError, OSError):
        raise ProtocolError("the world's process has ended; call close() and reset()") from None
    if not done:
        raise result
    return result


def _serve(process: Connection, town: str, options: EnvOptions) -> None:
    """Call methods of an environment as they are requested, until the other end is closed.

    A copy begins within this function too, and ends with it.
    """
    env, is_copy = WheelchairEnv(town, **options), False
    with suppress(EOFError, OSError):
        while True:
            name, args, named = process.recv()
            try:
                if name != "fork":
                    process.send((True, getattr(env, name)(*args, **named)))
                    continue
                inherited = process
                copied = go_on_in_copy(partial(Client, *args))
                if copied is None:
                    process.send((True, None))
                else:
                    process, is_copy = copied, True
                    inherited.close()
            except Exception as error:
                process.send((False, error))
    if is_copy:
        os._exit(0)
    env.close()

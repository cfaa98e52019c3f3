"""A client that learns on a seat of a running world, and reports its progress.

It measures where a learner's time goes: choosing actions, learning, and the rest, which its environment takes.

When its process has grown too far, a fresh one goes on with its work: what allocates for weeks grows a little, whatever
is done about it. A world is replaced between epochs for that; a client is, too, where an epoch has just begun: its
episode was cut there anyway.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

from wcsim.agents.clients.group_run import RECONNECT_S, has_work
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.agents.learning.build import network_settings
from wcsim.agents.learning.callbacks import SeqCallback, TrainProgress
from wcsim.agents.learning.train import train
from wcsim.agents.networks.device import checked_device
from wcsim.agents.networks.registry import find_network
from wcsim.agents.runs.run_folder import MANIFEST, ResolvedRun
from wcsim.config import LearnConfig, RunConfig, parse_json, resolve
from wcsim.config.plant import known_plants
from wcsim.core.reading import escaped
from wcsim.errors import (
    AccessError,
    ConfigError,
    ConfigMismatchError,
    DiskFullError,
    EvictedError,
    InterruptedRunError,
    LinkError,
    PicturesError,
    PolicyError,
    ServerGoneError,
    StaleSessionError,
    VersionMismatchError,
    WcsimError,
)
from wcsim.server.launch.states import ClientExit, ClientStatus
from wcsim.server.links.socket import SocketSeat
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import Patience
from wcsim.server.specs import ClientSpec, rss_mb, to_line
from wcsim.supervisor.rewards import find_reward_term

STATUS_EVERY_S = 0.5  # shortest time between two status lines
_LASTING = (
    AccessError,
    ConfigMismatchError,
    PicturesError,
    VersionMismatchError,
)  # it would end so again
_WORLD_PARTS = (
    "world",
    "chair",
    "cameras",
    "imu",
    "sensors",
    "reward",
    "vary",
)  # of a configuration
SETTLED_STEPS: Final = 200  # of a life, after which its memory is what it begins with
_P = ParamSpec("_P")
_R = TypeVar("_R")


class _ProcessGrownError(InterruptedRunError):
    """The work is saved, and another process is to go on with it."""


class _ProcessGrowth:
    """Watches the memory of this process, and asks it to end as a launcher would, once, when it has grown too far.

    It has begun when the replay is full, which has a bound of its own (`learn.replay_frames`).

    Args:
        learn: Of the client.
        memory_mb: Of this process.
        end: Asks it to save its work and end.
    """

    def __init__(
        self,
        learn: LearnConfig,
        memory_mb: Callable[[], float] = rss_mb,
        end: Callable[[], object] = lambda: os.kill(os.getpid(), signal.SIGTERM),
    ) -> None:
        self._limit_mb, self._full_step = learn.process_growth_mb, learn.replay_frames
        self._memory_mb, self._end = memory_mb, end
        self._first_step: int | None = None  # of this life
        self._epoch = -1
        self._begun_mb: float | None = None
        self.reason = ""  # why it was asked to end

    def look(self, step: int, epoch: int) -> None:
        """To be called every few steps.

        Args:
            step: Of the run.
            epoch: Of the world; -1 where it is not known.
        """
        self._first_step = step if self._first_step is None else self._first_step
        if self._begun_mb is None:
            if step > max(self._first_step + SETTLED_STEPS, self._full_step):
                self._begun_mb, self._epoch = self._memory_mb(), epoch
            return
        if epoch == self._epoch or self.reason:
            return
        self._epoch, now_mb = epoch, self._memory_mb()
        if now_mb - self._begun_mb > self._limit_mb:
            self.reason = f"its process has grown from {self._begun_mb:.0f} to {now_mb:.0f} MB"
            self._end()


@dataclass(slots=True)
class _Stopwatch:
    """A stopwatch around calls."""

    seconds: float = 0.0
    calls: int = 0

    def around(self, call: Callable[_P, _R]) -> Callable[_P, _R]:
        """The same call, measured."""

        def measured(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            begun_s = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.seconds += time.perf_counter() - begun_s
                self.calls += 1

        return measured


class _TimeShares(SeqCallback):
    """Measures how long a learner takes for its decisions (`inference`) and for its updates (`learning`)."""

    def __init__(self) -> None:
        super().__init__()
        self.inference, self.learning = _Stopwatch(), _Stopwatch()

    def _on_training_start(self) -> None:
        learner = self.learner
        setattr(learner.policy, "predict", self.inference.around(learner.policy.predict))  # noqa: B010 - to mypy it is fixed
        setattr(learner, "do_updates", self.learning.around(learner.do_updates))  # noqa: B010


class _StatusPipe:
    """Reports the progress of a client, a few times a second, where there is a pipe."""

    def __init__(
        self,
        name: str,
        descriptor: int,
        env: WheelchairEnv,
        shares: _TimeShares,
        growth: _ProcessGrowth,
    ) -> None:
        self._name, self._descriptor, self._growth = name, descriptor, growth
        if descriptor >= 0:
            os.set_blocking(descriptor, False)
        self._env, self._shares = env, shares
        self._written_s = 0.0

    def show(self, now: TrainProgress) -> None:
        """Take in the progress, and report it when it is time, or when that is all."""
        self._growth.look(now.step, self._env.epoch)
        waits = self._env.waits
        said = ClientStatus(
            name=self._name,
            **asdict(now),
            simulation_s=waits.simulation_s,
            barrier_s=max(0.0, waits.link_s - waits.simulation_s),
            inference_s=self._shares.inference.seconds,
            learning_s=self._shares.learning.seconds,
            overlap_s=waits.worked_s,
            pid=os.getpid(),
        )
        is_due = time.monotonic() - self._written_s >= STATUS_EVERY_S or now.step >= now.total_steps
        if self._descriptor >= 0 and is_due:
            self._written_s = time.monotonic()
            try:
                os.write(self._descriptor, to_line(said))
            except BlockingIOError:  # the reader is stopped
                pass
            except (
                OSError
            ):  # no reader is left; the kernel asks for the end itself (`parent.die_with_parent`),
                self._descriptor = -1  # and a second request from here would cut the saving short


def learn(
    order: ClientSpec,
    resume: bool,
    status_fd: int = -1,
    log: Callable[[str], object] = lambda text: None,
) -> None:
    """Train as ordered, into the run folder.

    Args:
        order: The client.
        resume: Go on from a checkpoint, or begin again when a life before left none.
        status_fd: Where status lines go; -1 for nowhere.
        log: Gets messages for the user.

    Raises:
        InterruptedRunError: It was asked to end; the work is saved.
        _ProcessGrownError: Another process is to go on.
        WcsimError: See `agents.train.train` and `WheelchairEnv`.
    """
    out, beats = Path(order.out), count(1)
    goes_on = resume and (out / MANIFEST).is_file()
    if resume and not goes_on and out.is_dir():  # a life that was ended while it made its folder
        if has_work(out):
            raise PolicyError(
                f"{out} holds data but no {MANIFEST}; restore that file, or move the folder away"
            )
        shutil.rmtree(out)
    order, env = opened(order, again=resume)
    config = order.config
    shares = _TimeShares()
    growth = _ProcessGrowth(config.learn)
    pipe = _StatusPipe(order.join.name, status_fd, env, shares, growth)
    run = ResolvedRun(config=config, out=out, info=order.info, resume=goes_on)

    def alive() -> None:  # else a server that hears nothing gives the seat away
        env.beat(next(beats))

    listeners: dict[str, Any] = {"alive": alive, "log": log, "wait_no_more": env.wait_no_more}
    try:
        train(run, lambda: env, pipe.show, progress_every=1, callbacks=(shares,), **listeners)
    except (InterruptedRunError, DiskFullError) as error:
        if growth.reason:  # with or without a last checkpoint, as any other one may fail
            raise _ProcessGrownError(f"{growth.reason}; a fresh one goes on") from error
        raise
    finally:
        env.close()


def opened(order: ClientSpec, again: bool = False) -> tuple[ClientSpec, WheelchairEnv]:
    """The environment of an order, and the order with all that its network asks for.

    An order without a town takes the world as it finds it: it has its seat there when this returns.

    Args:
        order: The client.
        again: Whether such a world was there before, and may come back.

    Raises:
        ConfigError: There is no such world, or it cannot be used.
        LinkError: It was there before, or refuses this client.
        WcsimError: The order cannot be used.
    """
    config = resolve(order.config, network_settings(order.config))
    checked_device(config.learn.device)
    find_network(config.learn.network)
    terms = tuple(find_reward_term(name) for name in order.info.rewards)
    order = replace(order, config=config)
    if order.info.town:
        return order, WheelchairEnv(
            order.info.town, config=config, reward_terms=terms, join=order.join
        )
    seat = SocketSeat(order.join)
    try:
        order = _fitted(order, seat, again)
        return order, WheelchairEnv(
            order.info.town, config=order.config, reward_terms=terms, join=seat
        )
    except BaseException:
        seat.close()
        raise


def _fitted(order: ClientSpec, seat: SocketSeat, again: bool) -> ClientSpec:
    """The order of a client that has taken its seat in a world which somebody else looks after."""
    endpoint, patience = order.join.endpoint, order.join.patience
    try:
        seat.join()
    except ServerGoneError:
        if again:
            raise
        raise ConfigError(
            f"{endpoint}: no answer within {patience.reconnect_s:g} s; is `wcsim serve` running there? "
            "(--wait S waits longer)"
        ) from None
    seat.core.patience = Patience(
        reconnect_s=RECONNECT_S
    )  # from now on the server may be silent for longer
    config = resolve(order.config, _of_world(seat.welcome, endpoint))
    return replace(order, config=config, info=replace(order.info, town=seat.welcome.town))


def _of_world(world: m.Welcome, endpoint: str) -> dict[str, Any]:
    """What the world sets of a configuration. Raises ConfigError rather than open a file that a server names."""
    offered = parse_json(RunConfig, world.config_json, f"the configuration of {endpoint}")
    if not endpoint.startswith("ipc://") and offered.chair.plant not in known_plants():
        raise ConfigError(
            f"the world of {endpoint} drives a wheelchair of a file ({escaped(offered.chair.plant, 80)!r}); expected "
            f"{' or '.join(known_plants())} over the network: join on the world's own machine"
        )
    return {
        **{part: getattr(offered, part) for part in _WORLD_PARTS},
        "env": {"actions": offered.env.actions},
    }


def exit_code(error: WcsimError) -> ClientExit:
    """How a client ends that met this error."""
    if isinstance(error, _ProcessGrownError):
        return ClientExit.GROWN
    if isinstance(error, InterruptedRunError):
        return ClientExit.STOPPED
    if isinstance(error, DiskFullError):
        return ClientExit.DISK_FULL
    if isinstance(error, EvictedError | StaleSessionError):
        return ClientExit.EVICTED
    if isinstance(error, LinkError) and not isinstance(error, _LASTING):
        return ClientExit.SERVER_GONE
    return ClientExit.USER_ERROR

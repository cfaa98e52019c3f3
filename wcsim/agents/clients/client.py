"""A client that learns on a seat of a running world, and reports its progress.

It measures where a learner's time goes: choosing actions, learning, and the rest, which its
environment takes.

When its process has grown too far, a fresh one goes on with its work: what allocates for weeks
grows a little, whatever is done about it. A world is replaced between epochs for that; a client is,
too, where an epoch has just started: its episode was cut there anyway.
"""

import os
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

from wcsim import errors
from wcsim.agents.clients.group_run import RECONNECT_S
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.agents.learning.build import default_settings_for_network
from wcsim.agents.learning.callbacks import SeqDqnCallback, TrainProgress
from wcsim.agents.learning.train import train_dqn
from wcsim.agents.networks.device import validate_device_name
from wcsim.agents.networks.registry import find_network
from wcsim.agents.runs.run_folder import MANIFEST, ResolvedRun, has_results
from wcsim.config import LearnConfig, RunConfig, parse_json, resolve
from wcsim.config.held_out import refuse_held_out
from wcsim.config.plant import list_plants
from wcsim.core.reading import escape
from wcsim.server.launch.states import ClientExitCode, ClientStatusReport
from wcsim.server.links.socket import SocketSeatLink
from wcsim.server.protocol import messages as m
from wcsim.server.protocol.client_core import Patience
from wcsim.server.specs import ClientProcessSpec, encode_json_line, measure_rss_mb
from wcsim.supervisor.rewards import make_reward_term

STATUS_EVERY_S: Final = 0.5  # shortest time between two status lines
SETTLED_STEPS: Final = 200  # of a process, after which its memory counts as what it started with
# A client that ended by one of these would do so again.
_LASTING: Final = (
    errors.AccessError,
    errors.ConfigMismatchError,
    errors.PicturesError,
    errors.VersionMismatchError,
)
# Sections of a configuration that the world sets.
_WORLD_PARTS: Final = ("world", "chair", "cameras", "imu", "sensors", "reward", "vary")
_P = ParamSpec("_P")
_R = TypeVar("_R")


def train_client(
    order: ClientProcessSpec,
    resume: bool,
    status_fd: int = -1,
    log: Callable[[str], object] = lambda text: None,
) -> None:
    """Train as ordered, into the run folder.

    Args:
        order: The client.
        resume: Go on from a checkpoint, or start again when a process before left none.
        status_fd: Where status lines go; -1 for nowhere.
        log: Gets messages for the user.

    Raises:
        InterruptedRunError: A stop was requested; the work is saved.
        _ProcessGrownError: Another process is to go on.
        WcsimError: See `agents.train.train_dqn` and `WheelchairEnv`.
    """
    # 1. The run folder; a process may have been ended while it made it.
    out = Path(order.out)
    goes_on = resume and (out / MANIFEST).is_file()
    if resume and not goes_on and out.is_dir():
        # Without its manifest the folder shows no more than this.
        if has_results(out):
            raise errors.PolicyError(
                f"{out} holds data but no {MANIFEST}; restore that file, or move the folder away"
            )
        shutil.rmtree(out)
    # 2. The environment: a seat in the world.
    order, env = make_client_env(order, again=resume)
    config = order.config
    run = ResolvedRun(config=config, out=out, info=order.info, resume=goes_on)
    # 3. What watches the process while it learns.
    shares = _TimeShares()
    growth = _ProcessGrowth(config.learn)
    pipe = _StatusPipe(order.join.name, status_fd, env, shares, growth)
    beats = count(1)
    try:
        train_dqn(
            run,
            lambda: env,
            pipe.show,
            progress_every=1,
            callbacks=(shares,),
            # A server that receives nothing for long gives the seat away.
            alive=lambda: env.beat(next(beats)),
            log=log,
            wait_no_more=env.wait_no_more,
        )
    except (errors.InterruptedRunError, errors.DiskFullError) as error:
        # With or without a last checkpoint, as any other one may fail.
        if growth.reason:
            raise _ProcessGrownError(f"{growth.reason}; a fresh one goes on") from error
        raise
    finally:
        env.close()


def make_client_env(
    order: ClientProcessSpec, again: bool = False
) -> tuple[ClientProcessSpec, WheelchairEnv]:
    """The order with all settings of its network, and its environment.

    An order without a town takes the world as it finds it: it has its seat there when this returns.

    Args:
        order: The client.
        again: Whether such a world was there before, and may return.

    Raises:
        ConfigError: There is no such world, or it cannot be used.
        LinkError: It was there before, or refuses this client.
        WcsimError: The order cannot be used.
    """
    # 1. What cannot be used is refused before others wait for this client.
    config = resolve(order.config, default_settings_for_network(order.config))
    validate_device_name(config.learn.device)
    find_network(config.learn.network)
    terms = tuple(make_reward_term(name) for name in order.info.rewards)
    order = replace(order, config=config)
    # 2. In a world of its own run the environment takes the seat itself.
    if order.info.town:
        return order, WheelchairEnv(
            order.info.town, config=config, reward_terms=terms, join=order.join
        )
    # 3. Any other world is joined first: the environment needs its settings.
    seat = SocketSeatLink(order.join)
    try:
        order = _join_world(order, seat, again)
        return order, WheelchairEnv(
            order.info.town, config=order.config, reward_terms=terms, join=seat
        )
    except BaseException:
        seat.close()
        raise


def client_exit_from_error(error: errors.WcsimError) -> ClientExitCode:
    """The exit code of a client that met this error."""
    if isinstance(error, _ProcessGrownError):
        return ClientExitCode.GROWN
    if isinstance(error, errors.InterruptedRunError):
        return ClientExitCode.STOPPED
    if isinstance(error, errors.DiskFullError):
        return ClientExitCode.DISK_FULL
    if isinstance(error, errors.EvictedError | errors.StaleSessionError):
        return ClientExitCode.EVICTED
    if isinstance(error, errors.LinkError) and not isinstance(error, _LASTING):
        return ClientExitCode.SERVER_GONE
    return ClientExitCode.USER_ERROR


def _join_world(order: ClientProcessSpec, seat: SocketSeatLink, again: bool) -> ClientProcessSpec:
    """Take a seat in a world that another process looks after; the order with its settings."""
    endpoint = order.join.endpoint
    try:
        seat.join()
    except errors.ServerGoneError:
        if again:
            raise
        raise errors.ConfigError(
            f"{endpoint}: no answer within {order.join.patience.reconnect_s:g} s; is `wcsim serve` "
            "running there? (--wait S waits longer)"
        ) from None
    refuse_held_out("town", (Path(seat.welcome.town).name,), endpoint)
    # From now on the server may be silent for longer.
    seat.core.patience = Patience(reconnect_s=RECONNECT_S)
    config = resolve(order.config, _world_settings(seat.welcome, endpoint))
    return replace(order, config=config, info=replace(order.info, town=seat.welcome.town))


def _world_settings(world: m.Welcome, endpoint: str) -> dict[str, Any]:
    """The settings of a world. Raises ConfigError rather than open a file that a server names."""
    offered = parse_json(RunConfig, world.config_json, f"the configuration of {endpoint}")
    if not endpoint.startswith("ipc://") and offered.chair.plant not in list_plants():
        raise errors.ConfigError(
            f"the world of {endpoint} drives a wheelchair of a file "
            f"({escape(offered.chair.plant, 80)!r}); expected {' or '.join(list_plants())} over "
            "the network: join on the world's own machine"
        )
    return {
        **{part: getattr(offered, part) for part in _WORLD_PARTS},
        "env": {"actions": offered.env.actions},
    }


class _ProcessGrownError(errors.InterruptedRunError):
    """The work is saved, and another process is to go on with it."""


class _ProcessGrowth:
    """Watches the memory of this process, and ends it when it has grown too far.

    Memory is first measured when the replay is full, which has a bound of its own
    (`learn.replay_frames`).

    Args:
        learn: Of the client.
        memory_mb: Of this process.
        end: Requests once that it saves its work and ends.
    """

    def __init__(
        self,
        learn: LearnConfig,
        memory_mb: Callable[[], float] = measure_rss_mb,
        end: Callable[[], object] = lambda: os.kill(os.getpid(), signal.SIGTERM),
    ) -> None:
        self._limit_mb = learn.process_growth_mb
        self._full_step = learn.replay_frames
        self._memory_mb = memory_mb
        self._end = end
        self._first_step: int | None = None  # of this process
        self._epoch = -1
        self._first_mb: float | None = None
        self.reason = ""  # why its end was requested

    def check(self, step: int, epoch: int) -> None:
        """To be called every few steps.

        Args:
            step: Of the run.
            epoch: Of the world; -1 where it is not known.
        """
        if self._first_step is None:
            self._first_step = step
        if self._first_mb is None:
            if step > max(self._first_step + SETTLED_STEPS, self._full_step):
                self._first_mb = self._memory_mb()
                self._epoch = epoch
            return
        if epoch == self._epoch or self.reason:
            return
        self._epoch = epoch
        now_mb = self._memory_mb()
        if now_mb - self._first_mb > self._limit_mb:
            self.reason = f"its process has grown from {self._first_mb:.0f} to {now_mb:.0f} MB"
            self._end()


@dataclass(slots=True)
class _Stopwatch:
    """A stopwatch around calls."""

    seconds: float = 0.0
    calls: int = 0

    def around(self, call: Callable[_P, _R]) -> Callable[_P, _R]:
        """The same call, measured."""

        def measured(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            start_s = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.seconds += time.perf_counter() - start_s
                self.calls += 1

        return measured


class _TimeShares(SeqDqnCallback):
    """Measures how long a learner takes for decisions (`inference`) and updates (`learning`)."""

    def __init__(self) -> None:
        super().__init__()
        self.inference, self.learning = _Stopwatch(), _Stopwatch()

    def _on_training_start(self) -> None:
        # By setattr, as methods are fixed to mypy.
        learner = self.learner
        setattr(learner.policy, "predict", self.inference.around(learner.policy.predict))  # noqa: B010
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
        self._name = name
        self._descriptor = descriptor
        if descriptor >= 0:
            os.set_blocking(descriptor, False)
        self._env = env
        self._shares = shares
        self._growth = growth
        self._written_s = 0.0

    def show(self, now: TrainProgress) -> None:
        """Check the growth, and report the progress when it is time, or when that is all."""
        self._growth.check(now.step, self._env.epoch)
        is_due = time.monotonic() - self._written_s >= STATUS_EVERY_S or now.step >= now.total_steps
        if self._descriptor < 0 or not is_due:
            return
        waits = self._env.waits
        status = ClientStatusReport(
            name=self._name,
            **asdict(now),
            simulation_s=waits.simulation_s,
            barrier_s=max(0.0, waits.link_s - waits.simulation_s),
            inference_s=self._shares.inference.seconds,
            learning_s=self._shares.learning.seconds,
            overlap_s=waits.worked_s,
            pid=os.getpid(),
        )
        self._written_s = time.monotonic()
        try:
            os.write(self._descriptor, encode_json_line(status))
        except BlockingIOError:
            # The reader is stopped.
            pass
        except OSError:
            # No reader is left. The kernel requests the end itself (`processes.die_with_parent`),
            # and a second request from here would cut the saving short.
            self._descriptor = -1

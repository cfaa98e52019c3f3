"""The ways to learn: what each one trains, resumes, loads as a policy and exports.

`LEARNERS` is the registry. A new learner is a class with the members of `Learner` and one entry
there; `learn.head` and `policy.json` name it. PyTorch and the simulators are imported within the
methods that need them: `--help` and refusals load neither.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from wcsim.agents.policy_api import Policy
from wcsim.agents.runs.data_folder import BY_EVENTS
from wcsim.agents.runs.policy_file import (
    read_danger_policy_file,
    read_policy_algorithm,
    read_value_policy_file,
)
from wcsim.agents.runs.run_folder import ResolvedRun, open_run
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerPolicyFile, QPolicyFile
from wcsim.core.reading import JsonObject, pluralize
from wcsim.server.workers.machines import WorkerPoolSettings
from wcsim.supervisor.rewards import make_reward_term
from wcsim.towns.scenario.town import Town

if TYPE_CHECKING:  # these load PyTorch, which --help must not
    from wcsim.agents.envs.wheelchair_env import WheelchairEnv
    from wcsim.agents.export.onnx_export import Graph
    from wcsim.agents.learning.callbacks import TrainProgress
    from wcsim.agents.rounds.train_rounds import RoundProgress


class TrainingDisplay(Protocol):
    """What a training of one network shows its user."""

    def print_note(self) -> None:
        """Print how the network learns."""

    def show_step(self, now: TrainProgress) -> None:
        """Show the progress of Q-learning."""

    def show_round(self, now: RoundProgress) -> None:
        """Show a round and its workers."""

    def print_line(self, line: str, *, left: bool = True) -> None:
        """Print a line above the bar; `left` adds the time that is left where there is no bar."""

    def warn(self, text: str) -> None:
        """Print what went wrong without ending the training."""


class Learner(Protocol):
    """A way to learn. Its attributes are words of messages, and what commands may ask of it."""

    heads: tuple[str, ...]  # values of learn.head
    algorithm: str  # in policy.json of its policies
    command: str  # that trains one network
    presets: str  # of its settings, as messages list them
    method: str  # how messages describe the command
    export_preset: str  # settings of a policy folder outside of its run
    first_stage: str  # name of the bar until progress arrives
    # Whether it drives worlds of its own on any machines, or learns from each step of one world.
    own_worlds: bool
    extends: bool  # whether --steps makes a run longer

    def describe(self, config: RunConfig) -> str:
        """From what and for how long a network learns, in a sentence or two."""

    def length(self, config: RunConfig) -> str:
        """The length of a run, as in "20 rounds"."""

    def train(
        self, run: ResolvedRun, town: Town, machines: WorkerPoolSettings, display: TrainingDisplay
    ) -> Path:
        """Train one network, or resume its run; returns the run folder.

        Args:
            run: The run; with `resume` it continues from its newest checkpoint.
            town: The run's own town.
            machines: The machines that drive worlds, where `own_worlds` is set.
            display: Shows the progress.

        Raises:
            InterruptedRunError: The user stopped it.
            WcsimError: A setting, the folder or a machine cannot be used.
        """

    def read_policy(self, folder: Path) -> QPolicyFile | DangerPolicyFile:
        """Read and check `policy.json` of its policies. Raises PolicyError."""

    def policy_settings(self, folder: Path) -> JsonObject:
        """What a policy folder fixes of a configuration, such as its camera. Raises PolicyError."""

    def load_policy(
        self,
        folder: Path,
        name: str,
        config: RunConfig,
        level: float | None = None,
        network: str | None = None,
    ) -> Policy:
        """A policy for one chair.

        Args:
            folder: The policy folder.
            name: Its name in tables.
            config: The configuration of the world in which it drives.
            level: Level of assistance; None for the policy's own.
            network: The user's own network that may be loaded, `module:Class`.

        Raises:
            PolicyError: It cannot be loaded, or was trained with other observations or actions.
        """

    def open_graph(
        self,
        folder: Path,
        config: RunConfig,
        level: float | None = None,
        network: str | None = None,
    ) -> tuple[Graph, Policy]:
        """A policy as a graph to export, and as wcsim drives with it; see `load_policy`."""


class _QLearning(Learner):
    """Q-learning from the reward of every step, in one world."""

    heads = ("residual", "plain")
    algorithm = "SeqDQN"
    command = "train-q"
    presets = "dqn or paper"
    method = "learns by Q-learning"
    export_preset = "paper"
    first_stage = "loading the town"
    own_worlds = False
    extends = True

    def describe(self, config: RunConfig) -> str:
        """See `Learner`."""
        learn = config.learn
        aid = " and from an oracle's labels (learn.aid=oracle)" if learn.aid == "oracle" else ""
        return (
            f"Q-learning from rewards{aid}, {learn.total_steps} steps: {learn.phase1_steps} in the "
            f"first phase, updates from step {learn.learning_starts} on"
        )

    def length(self, config: RunConfig) -> str:
        """See `Learner`."""
        return f"{config.learn.total_steps} steps"

    def train(
        self, run: ResolvedRun, town: Town, machines: WorkerPoolSettings, display: TrainingDisplay
    ) -> Path:
        """See `Learner`."""
        from wcsim.agents.envs.wheelchair_env import WheelchairEnv
        from wcsim.agents.learning.train import train_dqn

        info = run.info
        terms = tuple(make_reward_term(name) for name in info.rewards)

        def make_env() -> WheelchairEnv:
            env = WheelchairEnv(
                town.address,
                towns=tuple(info.more_towns),
                config=run.config,
                reward_terms=terms,
                run=run.out,
                hook=info.hook,
            )
            env.on_town = lambda word: open_run(run.out).event("town", town=Path(word).name)
            return env

        return train_dqn(run, make_env, display.show_step, log=display.warn)

    def read_policy(self, folder: Path) -> QPolicyFile:
        """See `Learner`."""
        return read_value_policy_file(folder)

    def policy_settings(self, folder: Path) -> JsonObject:
        """See `Learner`."""
        file = read_value_policy_file(folder)
        env = {
            "actions": file.net.actions,
            "classes": file.net.classes,
            "window": file.window,
            "observation": file.observation,
        }
        return {"cameras": [file.camera.model_dump(mode="json")], "env": env}

    def load_policy(
        self,
        folder: Path,
        name: str,
        config: RunConfig,
        level: float | None = None,
        network: str | None = None,
    ) -> Policy:
        """See `Learner`; values have no level of assistance."""
        from wcsim.agents.learning.saved_policy import load_policy_for_config

        return load_policy_for_config(folder, name, config, network)

    def open_graph(
        self,
        folder: Path,
        config: RunConfig,
        level: float | None = None,
        network: str | None = None,
    ) -> tuple[Graph, Policy]:
        """See `Learner`."""
        from wcsim.agents.export.policy_graphs import ValuePolicyGraph
        from wcsim.agents.learning.saved_policy import load_policy

        policy = load_policy(folder, network)
        graph = ValuePolicyGraph(policy.net, policy.file.window, policy.tolerated_loss)
        return graph, policy


class _DangerRounds(Learner):
    """A danger network, in rounds of driving and learning, in worlds of its own."""

    heads = ("danger",)
    algorithm = "danger"
    command = "train"
    presets = "quick, laptop, best or reward"
    method = "learns dangers in rounds"
    export_preset = "laptop"
    first_stage = "driving"
    own_worlds = True
    extends = False

    def describe(self, config: RunConfig) -> str:
        """See `Learner`."""
        collect = config.collect
        drivers = "simulated users and an oracle, which sees everything, drive"
        source = "the oracle's labels, not rewards"
        if config.danger.teacher in BY_EVENTS:
            drivers = "simulated users and the network drive"
            source = f"{BY_EVENTS[config.danger.teacher]}, without an oracle"
        return (
            f"{pluralize(collect.rounds, 'round')} of {collect.segments} x {collect.ticks} ticks "
            f"with {collect.chairs} "
            f"chairs, fewer in scenes: {drivers}. A network learns from {source}, in "
            f"{config.danger.updates} updates per round: which joystick positions end badly."
        )

    def length(self, config: RunConfig) -> str:
        """See `Learner`."""
        return f"{config.collect.rounds} rounds"

    def train(
        self, run: ResolvedRun, town: Town, machines: WorkerPoolSettings, display: TrainingDisplay
    ) -> Path:
        """See `Learner`."""
        from wcsim.agents.rounds.train_rounds import train_danger

        def log(text: str) -> None:
            display.print_line(text, left=False)

        display.print_note()
        return train_danger(run, town, replace(machines, report=log), display.show_round, log)

    def read_policy(self, folder: Path) -> DangerPolicyFile:
        """See `Learner`."""
        return read_danger_policy_file(folder)

    def policy_settings(self, folder: Path) -> JsonObject:
        """See `Learner`."""
        file = read_danger_policy_file(folder)
        cameras = (file.camera, *file.more_cameras)
        names = [camera.name for camera in cameras]
        return {
            "cameras": [camera.model_dump(mode="json") for camera in cameras],
            "env": {
                "actions": file.net.actions,
                "classes": file.classes,
                "window": 1,
                "camera": names if file.more_cameras else "",
            },
            "chair": file.chair.model_dump(mode="json"),
        }

    def load_policy(
        self,
        folder: Path,
        name: str,
        config: RunConfig,
        level: float | None = None,
        network: str | None = None,
    ) -> Policy:
        """See `Learner`; the level is a threshold of danger."""
        from wcsim.agents.danger.policy import load_danger

        return load_danger(folder, name, config, level)

    def open_graph(
        self,
        folder: Path,
        config: RunConfig,
        level: float | None = None,
        network: str | None = None,
    ) -> tuple[Graph, Policy]:
        """See `Learner`."""
        from wcsim.agents.danger.policy import DangerPolicy, load_net
        from wcsim.agents.export.policy_graphs import DangerPolicyGraph

        net, rule = load_net(folder, level)
        return DangerPolicyGraph(net, config, rule), DangerPolicy("own", net, config, rule)


Q_LEARNING: Final = _QLearning()
DANGER_ROUNDS: Final = _DangerRounds()
LEARNERS: Final[tuple[Learner, ...]] = (Q_LEARNING, DANGER_ROUNDS)


def learner_from_config(config: RunConfig) -> Learner:
    """The learner that `learn.head` of a configuration chooses."""
    (found,) = (learner for learner in LEARNERS if config.learn.head in learner.heads)
    return found


def learner_from_policy(folder: Path) -> Learner:
    """The learner of a policy folder. Raises PolicyError when it is no policy folder."""
    algorithm = read_policy_algorithm(folder)
    for learner in LEARNERS:
        if learner.algorithm == algorithm:
            return learner
    # Its check of the file reports the unknown algorithm.
    return Q_LEARNING

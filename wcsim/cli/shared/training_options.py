"""The options that commands which train share. Nothing here loads what a training needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from wcsim.cli.shared.common import (
    ExistingName,
    Flag,
    OutFile,
    OutFolder,
    Repeated,
    SettingsOptions,
    Steps,
)

if TYPE_CHECKING:
    from wcsim.server.specs import RunInfo


@dataclass(kw_only=True)
class OutputOptions:
    """What a training prints, and the file that names its run."""

    verbose: Flag = False
    """Show which SUMO options of the town are overridden, and why."""
    json: OutFile = None
    """Write the path of the run to this file."""


@dataclass(kw_only=True)
class TrainingOptions(SettingsOptions, OutputOptions):
    """Options of every new training."""

    town: str = "helsinki"
    """Training towns, separated by commas: a town's name, its folder, or a .sumocfg file; made:SEED is generated. The
    world changes town after world.epoch_ticks. Test towns need --allow-test-town."""  # noqa: E501 - help text
    seed: int = 0
    """Random seed: equal seeds give equal weights."""
    out: OutFolder = None
    """Run folder; default runs/TOWN-PRESET-SEED."""
    tensorboard: bool = False
    """Also log scalars for TensorBoard in the run folder, as --set learn.tensorboard=true."""
    allow_test_town: bool = False
    """Allow training in a test town."""


@dataclass(kw_only=True)
class QLearningBaseOptions(SettingsOptions):
    """Options of every command that learns by Q-learning."""

    preset: str = "dqn"
    """Preset to start from: dqn or paper. Without a name: a table of all."""
    reward: Annotated[Repeated, ExistingName(_find_reward_term)] = ()
    """Your own reward term as module:Class, added to the paper's terms."""
    steps: Steps = None
    """Total steps, as --set learn.total_steps=N. A preset's first phase of more than half of them shrinks."""  # noqa: E501 - help text


@dataclass(kw_only=True)
class NewQTrainingOptions(QLearningBaseOptions, TrainingOptions):
    """Options of every new training by Q-learning."""

    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""  # noqa: E501 - help text

    def info(self, command: tuple[str, ...]) -> RunInfo:
        """What is known of a run before its town is."""
        from wcsim.server.specs import RunInfo

        return RunInfo(seed=self.seed, rewards=self.reward, command=command, hook=self.hook)


def _find_reward_term(name: str) -> object:
    from wcsim.supervisor.rewards import make_reward_term

    return make_reward_term(name)

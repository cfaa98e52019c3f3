"""From a run's configuration to a learner."""

from dataclasses import dataclass
from typing import Final

from stable_baselines3.common.type_aliases import GymEnv

from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.networks import registry
from wcsim.agents.networks.q_network import SeqQPolicy
from wcsim.agents.perception.depth_image import is_camera_mirror_symmetric
from wcsim.config import RunConfig
from wcsim.config.run_file import FollowPrior, NetSpec
from wcsim.errors import ConfigError, PolicyError
from wcsim.supervisor.actions import action_set

LARGEST_GRADIENT: Final = 10.0  # norm to which a larger one is cut


def default_settings_for_network(config: RunConfig) -> tuple[str, ...]:
    """The memory of a network's kind, and the window that it prefers where `env.window` is not set.

    Groups are for networks that carry a state; another network of windows learns from windows.

    Raises:
        PolicyError: There is no such network.
    """
    network, settings = config.learn.network, list[str]()
    needs_state = config.learn.memory == "groups" and registry.is_windowed_network(network)
    if needs_state and not registry.is_recurrent_network(network):
        settings.append("learn.memory=windows")
    if config.env.window is None:
        window = 1 if _is_stateful(config) else registry.preferred_window_size(network)
        settings.append(f"env.window={window}")
    return tuple(settings)


def build_q_learner(config: RunConfig, env: GymEnv, seed: int) -> SeqDQN:
    """A fresh learner.

    Raises:
        PolicyError: The network or the observation space does not fit.
        ConfigError: `learn.mirror` with a camera that sees left and right differently, or a replay
            beyond the memory, or settings of the memory that do not go together.
    """
    _check_memory(config)
    learn, camera = config.learn, config.eye
    if learn.mirror and not is_camera_mirror_symmetric(camera):
        raise ConfigError(
            f"learn.mirror=true with a camera at y={camera.p_BC_m[1]} m, yaw {camera.yaw_deg}, "
            f"roll {camera.roll_deg} deg; expected 0, because pictures are mirrored: set "
            "learn.mirror=false"
        )
    measures = config.sensors.measures().items()
    # So late that there is something to draw: two steps, or a group of each seat and a step.
    seats = getattr(env, "num_envs", 1)
    least = (learn.group_steps + 1) * seats if learn.memory == "groups" else 2
    try:
        return SeqDQN(
            SeqQPolicy,
            env,
            settings=learn,
            actions=action_set(config.env.actions).name,
            mirror_signs=tuple((name, measure.mirror) for name, measure in measures),
            seed=seed,
            learning_rate=_FadingRate(rate=learn.learning_rate, fade=learn.learning_rate_fade),
            buffer_size=learn.replay_frames,
            learning_starts=max(learn.learning_starts, least),
            train_freq=learn.train_every,
            max_grad_norm=LARGEST_GRADIENT,
            replay_buffer_kwargs={"settings": learn, "seed": seed},
            policy_kwargs={"spec": _net_spec(config)},
            **learn.model_dump(include={"batch_size", "tau", "gamma", "device"}),
        )
    except MemoryError:
        raise ConfigError(
            f"learn.replay_frames={learn.replay_frames} do not fit into memory; expected fewer"
        ) from None


@dataclass(frozen=True, slots=True, kw_only=True)
class _FadingRate:
    """A learning rate that falls to zero over a run's last share, so that its policy is settled.

    >>> [_FadingRate(rate=1.0, fade=0.5)(left) for left in (1.0, 0.5, 0.25, 0.0)]
    [1.0, 1.0, 0.5, 0.0]
    """

    rate: float
    fade: float  # share of all steps

    def __call__(self, left: float) -> float:
        """The rate when the share `left` of all steps is still to be done."""
        return self.rate * min(1.0, max(left, 0.0) / self.fade) if self.fade > 0.0 else self.rate


def _check_memory(config: RunConfig) -> None:
    """Refuse what the memory of a run cannot do."""
    learn = config.learn
    if (
        learn.memory == "windows"
        and registry.is_windowed_network(learn.network)
        and config.env.frames == 1
    ):
        raise ConfigError(
            f"learn.memory=windows with one image in an observation for {learn.network!r}; "
            f"expected a window: set env.window={registry.preferred_window_size(learn.network)}"
        )
    if _is_stateful(config) and (learn.mirror or learn.aid != "none"):
        what = "learn.mirror=true" if learn.mirror else f"learn.aid={learn.aid}"
        raise ConfigError(
            f"{what} with learn.memory=groups and {learn.network!r}: a recurrent state does not "
            "work with that; expected neither of them: set learn.mirror=false and learn.aid=none, "
            "or another learn.memory"
        )


def _is_stateful(config: RunConfig) -> bool:
    """Whether the network carries a state from tick to tick, in the place of a window."""
    return config.learn.memory == "groups" and registry.is_recurrent_network(config.learn.network)


def _net_spec(config: RunConfig) -> NetSpec:
    """The network of a configuration."""
    learn, of_reward = config.learn, {"base", "max_follow_distance", "max_distance", "penalty"}
    prior = FollowPrior(
        reward_scale=learn.reward_scale, **config.reward.model_dump(include=of_reward)
    )
    if learn.head == "danger":
        raise PolicyError(
            "learn.head='danger' is not a head for Q-learning; expected residual or plain here"
        )
    return NetSpec(
        network=learn.network,
        head=learn.head,
        dueling=learn.duel,
        actions=config.env.actions,
        classes=config.env.classes,
        prior=prior,
        stateful=_is_stateful(config),
    )

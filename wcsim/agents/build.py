"""From a run's configuration to a learner."""

from __future__ import annotations

from stable_baselines3.common.type_aliases import GymEnv

from wcsim.agents.phases import PhasePlan
from wcsim.agents.policy import FollowPrior, NetSpec, SeqQPolicy
from wcsim.agents.seqdqn import SeqDQN, SeqSettings
from wcsim.config import LearnConfig, RunConfig


def net_spec(config: RunConfig) -> NetSpec:
    """The network that a run's configuration asks for."""
    reward, learn = config.reward, config.learn
    prior = FollowPrior(
        base=reward.base,
        max_follow_distance=reward.max_follow_distance,
        max_distance=reward.max_distance,
        penalty=reward.penalty,
        reward_scale=learn.reward_scale,
    )
    return NetSpec(
        network=learn.network, head=learn.head, actions=config.env.actions, classes=config.env.classes, prior=prior
    )


def phase_plan(learn: LearnConfig) -> PhasePlan:
    """When the phases change."""
    return PhasePlan(
        total_steps=learn.total_steps,
        phase1_steps=learn.phase1_steps,
        epsilon_start=learn.epsilon_start,
        epsilon_end=learn.epsilon_end,
        margin=learn.margin,
        margin_fade=learn.margin_fade,
        aid=learn.aid_weight if learn.aid == "oracle" else 0.0,
    )


def build_model(config: RunConfig, env: GymEnv, seed: int) -> SeqDQN:
    """A fresh learner. Raises PolicyError when the network or the observation space does not fit."""
    learn = config.learn
    return SeqDQN(
        SeqQPolicy,
        env,
        settings=SeqSettings(
            actions=config.env.actions,
            double_q=learn.double_q,
            reward_scale=learn.reward_scale,
            exploration=learn.exploration,
            epsilon_sigma=learn.epsilon_sigma,
            epsilon_hold=learn.epsilon_hold,
            mirror=learn.mirror,
            aid_batch=learn.aid_batch,
            aid_share=learn.aid_share,
            aid_relabel=learn.aid_relabel,
            aid_ahead=learn.aid_ahead,
            aid_margin=learn.aid_margin,
        ),
        plan=phase_plan(learn),
        seed=seed,
        learning_rate=learn.learning_rate,
        buffer_size=learn.replay_frames,
        learning_starts=max(learn.learning_starts, 2),
        batch_size=learn.batch_size,
        tau=learn.tau,
        gamma=learn.gamma,
        train_freq=learn.train_every,
        gradient_steps=learn.gradient_steps,
        max_grad_norm=learn.clip_norm,
        replay_buffer_kwargs={
            "n_step": learn.n_step,
            "gamma": learn.gamma,
            "precrash_share": learn.precrash_share,
            "precrash_window": learn.precrash_window,
            "advice": learn.aid == "oracle",
            "seed": seed,
        },
        policy_kwargs={"spec": net_spec(config)},
        device=learn.device,
    )

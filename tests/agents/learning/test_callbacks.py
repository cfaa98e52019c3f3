"""Callbacks: events, and values at the starts of episodes beside the returns that followed."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from tests.agents.chain import LENGTH, Chain
from tests.agents.toy import explores, logs_in, memory_of
from tests.support.plants import CALM
from wcsim.agents.envs.episode_view import OBJECTS, InfoObjects
from wcsim.agents.learning.callbacks import EpisodeMetricsCallback, EventReportCallback, _DiscountedReturn
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.networks import registry
from wcsim.agents.networks.q_network import SeqQPolicy
from wcsim.agents.runs.metrics import STEP_COLUMNS, MetricsFile, read_metrics
from wcsim.config.run_file import FollowPrior, NetSpec

GAMMA = 0.97


def test_a_jam_is_reported_once_a_step_and_crashes_each_with_their_words():
    told = []
    watch = EventReportCallback(lambda kind, **values: told.append((kind, values)))
    crash = replace(CALM, crashed=True, crash_reason="collision", crash="was hit by car c", jam_teleports=2)
    infos = [{OBJECTS: InfoObjects(events=each)} for each in (crash, CALM, crash)]
    watch.num_timesteps, watch.locals = 7, {"infos": infos}
    assert watch._on_step()
    fact = ("crash", {"step": 7, "reason": "collision", "told": "was hit by car c"})
    assert told == [("jam", {"step": 7, "teleported": 2}), fact, fact]
    watch.locals = {"infos": [{OBJECTS: InfoObjects(events=CALM)}, {}]}
    assert watch._on_step()
    assert len(told) == 3


def test_returns_are_discounted_and_scaled_as_values_are():
    watch = _DiscountedReturn(gamma=0.9, scale=0.05, start_value=1.0)
    for reward in (1.0, 0.0, -100.0):
        watch.add(reward)
    row = watch.row(ended=True)
    assert row["return_start"] == pytest.approx(0.05 * (1.0 - 0.81 * 100.0))
    assert row["overestimate"] == pytest.approx(1.0 - row["return_start"])
    assert _DiscountedReturn(gamma=0.9, scale=1.0).row(ended=True)["overestimate"] is None


def test_an_episode_cut_short_counts_only_when_little_was_to_come():
    watch = _DiscountedReturn(gamma=0.9, scale=1.0, start_value=0.0)
    for steps in range(1, 40):
        watch.add(1.0)
        told = watch.row(ended=False)["return_start"]
        assert (told is not None) == (0.9**steps <= 0.05)


class Worthless(Chain):
    """Every action goes on and nothing is ever paid: whatever value is seen is too much."""

    def _begin(self):
        self.state = 0

    def step(self, action):
        self.state += 1
        return self._observe(), 0.0, self.state >= LENGTH, False, {}


class MeanOfPlanes(nn.Module):
    """Which class fills the image."""

    def __init__(self, image_shape, vector_size):
        super().__init__()

    def forward(self, image, vector):
        return image.mean(dim=(2, 3))


@pytest.fixture(autouse=True)
def known(monkeypatch):
    """The network is known here, and in no other test."""
    monkeypatch.setitem(registry.NETWORKS, "mean-of-planes", MeanOfPlanes)


def overestimates(folder, double_q, seed, steps=400):
    """The column of every episode of a short training on the worthless chain.

    Double Q-learning helps as far as the two networks err independently; here the target's values begin with noise.
    """
    spec = NetSpec(network="mean-of-planes", head="plain", prior=FollowPrior(reward_scale=1.0))
    learner = SeqDQN(
        SeqQPolicy, Worthless(), settings=explores(1.0, 1.0, double_q=double_q),
        seed=seed, gamma=GAMMA, learning_rate=1e-3, buffer_size=2000, learning_starts=50, batch_size=32, tau=0.002,
        train_freq=1, device="cpu",
        policy_kwargs={"spec": spec},
        replay_buffer_kwargs=memory_of(gamma=GAMMA, seed=seed),
    )  # fmt: skip
    torch.manual_seed(seed)
    learner.q_net_target.advantage.bias.data += torch.randn(81)  # it errs in a way of its own, and forgets that slowly
    learner.learn(steps, callback=EpisodeMetricsCallback(*logs_in(folder), 0.0))
    return [float(row["overestimate"]) for row in read_metrics(folder / "metrics.csv")]


@pytest.mark.proof
def test_without_double_q_values_promise_more_of_what_never_comes(tmp_path):
    later = {
        double_q: np.mean([overestimates(tmp_path / f"{double_q}-{seed}", double_q, seed)[20:] for seed in (1, 2)])
        for double_q in (True, False)
    }
    assert later[False] > 1.0  # of nothing
    assert later[False] > 2.0 * max(later[True], 0.0), later


def test_kpi_1_goes_on_with_the_rows_of_a_run_that_was_stopped(tmp_path):
    rows, steps = logs_in(tmp_path)
    for number in range(30):
        steps.add(dict.fromkeys(STEP_COLUMNS, number))
    on = MetricsFile(steps.path, 25, STEP_COLUMNS)
    assert EpisodeMetricsCallback(rows, on, 0.0).kpi1 == np.mean(range(6, 26))


def test_the_column_is_that_of_the_greedy_value_at_the_start(tmp_path):
    overestimates(tmp_path, True, 1, steps=100)
    rows = read_metrics(tmp_path / "metrics.csv")
    assert {row["length"] for row in rows} == {str(LENGTH)}
    assert all(float(row["return_start"]) == 0.0 for row in rows)
    assert all(row["value_start"] == row["overestimate"] for row in rows)

"""Supervised learning of dangers."""

import numpy as np
import pytest
import torch

from tests.agents.danger.sights import a_segment, all_of, lectures, lessons_of, small_config
from wcsim.agents.danger.learner import DangerLearner, _rate_share
from wcsim.errors import PolicyError


def test_32_steps_are_learned_by_heart():
    fast = ("danger.batch=16", "danger.learning_rate=0.004")
    config = small_config(*fast, "danger.weight_decay=0", "danger.ahead=0")
    # A street map of noise tells nothing of a step once it has seen others.
    lessons, learner = lessons_of(config, a_segment(32, ends=tuple(range(32)))), DangerLearner(config, 1, 60)
    before = float(learner.learn(lessons, 1))
    learner.learn(lessons, 59)
    batch = lessons.batch(all_of(lessons))
    with torch.inference_mode():
        logits = learner.net(*batch.inputs)
    after = torch.nn.functional.binary_cross_entropy_with_logits(logits, batch.unsafe)
    assert after < 0.4 * before
    assert ((logits > 0) == (batch.unsafe > 0)).float().mean() > 0.9


def test_the_rate_rises_and_falls_once_and_stays_down_when_a_run_is_made_longer():
    shares = [_rate_share(done) for done in np.linspace(0.0, 1.0, 101)]
    top = int(np.argmax(shares))
    assert shares[0] == pytest.approx(0.04) and shares[top] == pytest.approx(1.0) and 0 < top < 10
    assert (np.diff(shares[: top + 1]) > 0.0).all() and (np.diff(shares[top:]) < 0.0).all()
    assert _rate_share(1.7) == pytest.approx(0.0)


def test_equal_seeds_give_equal_weights_and_others_others():
    found = []
    for seed in (1, 1, 2):
        config = small_config()
        learner = DangerLearner(config, seed, 4)
        learner.learn(lectures(config, 30), 4)
        found.append(torch.cat([value.detach().reshape(-1) for value in learner.net.parameters()]))
    assert torch.equal(found[0], found[1]) and not torch.equal(found[0], found[2])


def test_a_learner_that_is_restored_goes_on_to_the_same_weights():
    config = small_config()
    straight, before = DangerLearner(config, 1, 6), DangerLearner(config, 1, 6)
    lessons = lectures(config, 30)
    straight.learn(lessons, 3)
    lessons = lectures(config, 30)
    before.learn(lessons, 3)
    after = DangerLearner(config, 2, 6)
    after.net.load_state_dict(before.net.state_dict())
    after.restore(before.arrays(), before.updates, before.loss)
    straight.learn(lectures(config, 30, seed=1), 3)
    after.learn(lectures(config, 30, seed=1), 3)
    for one, other in zip(straight.net.parameters(), after.net.parameters(), strict=True):
        assert torch.equal(one, other)


def test_a_loss_that_is_no_number_stops_the_run():
    config = small_config()
    learner = DangerLearner(config, 1, 4)
    with torch.no_grad():
        learner.net.base.fill_(float("nan"))
    with pytest.raises(PolicyError, match=r"danger\.learning_rate"):
        learner.learn(lectures(config, 20), 1)


def test_a_gradient_that_is_no_number_stops_the_run_before_it_reaches_the_weights(monkeypatch):
    config = small_config()
    learner, lessons = DangerLearner(config, 1, 4), lectures(config, 20)
    learner.learn(lessons, 1)
    before = [value.detach().clone() for value in learner.net.parameters()]

    def steep(logits, wanted):
        return (logits - logits.detach()).sqrt().mean()

    monkeypatch.setattr("wcsim.agents.danger.learner.functional.binary_cross_entropy_with_logits", steep)
    with pytest.raises(PolicyError, match=r"loss was 0\.0 .*gradient (inf|nan) after 1 .*start a new run"):
        learner.learn(lessons, 1)
    assert all(torch.equal(one, other) for one, other in zip(before, learner.net.parameters(), strict=True))

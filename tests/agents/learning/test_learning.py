"""Does it learn? Images of the toy street, nothing else; greedy evaluation on a seed that training never sees.

Measured: the user alone crashes 13 times in 1000 steps; after 4000 steps of learning (16 processor seconds, busy core)
it is 1.6, 4.7 and 1.5 for seeds 0, 1 and 2, at a joystick distance of 0.54 to 0.69 and 0.6 to 0.9 m/s.
"""

from functools import partial

import pytest

from tests.agents.driven import driven
from tests.agents.toy import ToyStreet, WindowedStreet, q_config, toy_camera, train_toy
from wcsim.agents.learning.build import default_settings_for_network
from wcsim.agents.learning.replay.buffer import FrameReplay
from wcsim.agents.learning.saved_policy import load_policy
from wcsim.agents.learning.seqdqn import SeqDQN
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.runs.metrics import read_metrics
from wcsim.agents.runs.run_folder import policy_folder_from_name
from wcsim.config import resolve
from wcsim.view.report.learning_curve import KPI1_LIMIT, crossing, read_training

CAMERA = toy_camera(18, 24)
SHORT = {"total_steps": 4000, "phase1_steps": 800, "learning_rate": 5e-4}


def config(**learn):
    return q_config(CAMERA, replay_frames=20_000, **learn)


def drive(policy, steps):
    """Evaluation row of `steps` steps or a little more, in episodes of at most 400."""
    return driven(policy, ToyStreet(CAMERA), episodes=steps // 100, max_steps=100, seed=99)


def per_1000(row):
    return 1000 * row.crashes_own / (row.kpi2 * row.episodes)


def has_learned(learned, follow):
    """Fewer crashes than the user alone, without standing still or ignoring the user."""
    return per_1000(learned) <= 0.5 * per_1000(follow) and learned.speed_mps >= 0.3 and learned.kpi1 <= 0.9


def outcome(settings, out, seed, steps):
    """The run of a training, and evaluation rows of the user alone and of what was learned."""
    run = train_toy(settings, out, lambda: ToyStreet(CAMERA), seed=seed)
    policies = make_baseline_policy("follow", settings), load_policy(policy_folder_from_name(str(run)))
    return run, *(drive(policy, steps) for policy in policies)


@pytest.mark.proof
def test_it_learns_to_avoid_what_the_user_does_not_see(tmp_path):
    steps = 8000  # 2000 hold 9 to 17 crashes for equal policies
    run, follow, learned = outcome(config(**SHORT), tmp_path / "run", 0, steps)
    obedient = drive(load_policy(policy_folder_from_name(f"{run}:phase1")), steps)
    # The first phase teaches obedience: what the user wants, crashes included.
    assert obedient.kpi1 <= 0.1768
    assert per_1000(obedient) > 0.5 * per_1000(follow)
    # The second phase keeps most of it, without the crashes and without standing still.
    assert has_learned(learned, follow), learned
    rows = read_metrics(run / "metrics.csv")
    assert max(float(row["max_abs_q"]) for row in rows) < 12.5


@pytest.mark.proof
@pytest.mark.parametrize("seed", [1, 2])
def test_it_learns_with_other_seeds_and_more_time(seed, tmp_path):
    settings = config(total_steps=16_000, phase1_steps=2000)
    _, follow, learned = outcome(settings, tmp_path / "run", seed, 8000)
    assert per_1000(learned) <= 0.25 * per_1000(follow)
    assert learned.speed_mps >= 0.4
    assert learned.kpi1 <= 0.85


# The paper's preset in 12x16 pixels: seeds 1 to 3 of fig6 need 4400 to 5000 steps, patch half of its time.
OTHERS = [
    pytest.param(*each, marks=pytest.mark.proof) for each in (("fig6", 1), ("fig6", 2), ("conv3d", 1), ("convlstm", 1))
]


@pytest.mark.parametrize("network, seed", [("patch", 1), *OTHERS])
def test_the_first_phase_of_the_paper_comes_below_its_limit(network, seed, tmp_path):
    learn = {"network": network, "total_steps": 5500, "phase1_steps": 5500, "replay_frames": 5000}
    paper = resolve("paper", {"learn": learn, "cameras": [toy_camera(12, 16).model_dump()]})
    paper = resolve(paper, default_settings_for_network(paper))
    street = partial(WindowedStreet, paper.env.frames, paper.eye, max_steps=300)
    rows = read_training([train_toy(paper, tmp_path / "run", street, seed=seed)]).steps["run"]
    assert crossing(rows).last < KPI1_LIMIT < rows[0].kpi1


def _no_update(monkeypatch):
    monkeypatch.setattr(SeqDQN, "_update", lambda self, loss: None)


def _wrong_sign(monkeypatch):
    gather = FrameReplay.gather

    def negated(self, starts, seats):
        batch = gather(self, starts, seats)
        return batch._replace(rewards=-batch.rewards)

    monkeypatch.setattr(FrameReplay, "gather", negated)


@pytest.mark.proof
@pytest.mark.parametrize("fault", [_no_update, _wrong_sign])
def test_a_learner_with_a_planted_fault_is_found_out(fault, tmp_path, monkeypatch):
    fault(monkeypatch)
    _, follow, learned = outcome(config(**SHORT), tmp_path / "run", 0, 2000)
    assert not has_learned(learned, follow), learned

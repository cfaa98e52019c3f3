"""Labels from crashes that happened: what they say, of what they know nothing, and that a fault in them is seen."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional

from tests.agents.danger.sights import a_segment, lessons_of, small_config
from tests.agents.danger.toy_rides import ACTIONS, astray, follow, ride, segment_of, toy_config
from wcsim.agents.danger.dataset import UNKNOWN, Dataset, _label_by_crashes, _label_by_returns
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.runs.data_folder import ORACLE, join_segments
from wcsim.config import RewardConfig
from wcsim.config.run_file import DangerRuleSettings
from wcsim.errors import PolicyError
from wcsim.supervisor.rewards import reward_of_distance

AHEAD, CLEAR, TICK_S = 6, 12, 0.1
AHEAD_STICK, LEFT, REST = (ACTIONS.nearest(stick) for stick in ((0.0, 1.0), (-1.0, 0.0), (0.0, 0.0)))
WORDS = ("danger.teacher=crashes", f"danger.ahead={AHEAD}")


def driven(sticks, *, delay=0, crashed=False, own=True):
    """An episode with these sticks, which ends in a crash or is cut."""
    count = len(sticks)
    last = np.arange(count) == count - 1
    return replace(
        a_segment(count, ends=()),
        action=np.array(sticks, np.uint8),
        delay=np.full(count, delay, np.uint8),
        crashed=last & crashed,
        own=last & crashed & own,
        visible=np.zeros((count, 0), np.uint8),
        truth=np.zeros((count, 0), np.uint8),
    )


def told(sticks, tick_s=TICK_S, **how):
    """The label of each executed position."""
    labels = _label_by_crashes(driven(sticks, **how), ACTIONS, AHEAD, tick_s)
    return "".join("01?"[label] for label in labels[np.arange(len(sticks)), sticks])


def test_the_stick_that_was_held_until_a_crash_is_unsafe():
    assert told([AHEAD_STICK] * 20, crashed=True) == "0" * 7 + "?" * 6 + "1" * 7
    assert told([AHEAD_STICK] * 20, crashed=True, delay=2) == "0" * 5 + "?" * 6 + "1" * 7 + "??", "too late to act"
    assert told([AHEAD_STICK] * 18 + [REST] * 2, crashed=True) == "0" * 7 + "?" * 6 + "1" * 7, "let go too late"
    assert told([LEFT] * 17 + [AHEAD_STICK] * 3, crashed=True) == "0" * 7 + "?" * 10 + "111", "another stick since"


def test_nobody_knows_what_follows_a_cut_or_would_have_come_without_the_others():
    for how in ({}, {"crashed": True, "own": False}):
        assert told([AHEAD_STICK] * 20, **how) == "0" * 7 + "?" * 13
    assert told([AHEAD_STICK, LEFT, LEFT] * 10) == "?" * 30, "none of them was held for half a second"
    held = ([AHEAD_STICK] * 7 + [LEFT] * 7) * 2
    assert "0" in told(held) and "0" not in told(held, tick_s=0.05), "seven ticks of 0.05 s are less"


def test_positions_beside_the_executed_one_share_its_label_and_all_others_have_none():
    labels = _label_by_crashes(driven([REST] * 20, crashed=True), ACTIONS, AHEAD, TICK_S)
    near = np.abs(ACTIONS.points).sum(axis=1) <= 0.25
    assert near.sum() == 5 and (labels[-1, near] == 1).all() and (labels[0, near] == 0).all()
    assert (labels[:, ~near] == UNKNOWN).all()


episodes = st.lists(
    st.tuples(st.lists(st.sampled_from([AHEAD_STICK, LEFT, REST]), min_size=1, max_size=30), st.booleans()),
    min_size=1,
    max_size=3,
)


@settings(max_examples=30)
@given(episodes, st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_an_episode_is_judged_by_itself_and_neither_wish_nor_driver_nor_oracle_counts(found, delay, seed):
    parts = [driven(sticks, delay=delay, crashed=crashed) for sticks, crashed in found]
    alone = [_label_by_crashes(part, ACTIONS, AHEAD, TICK_S) for part in parts]
    rng, whole = np.random.default_rng(seed), join_segments(parts)
    other = replace(
        whole,
        wish=rng.normal(size=(len(whole), 2)).astype(np.float32),
        driver=rng.integers(0, 4, len(whole)).astype(np.uint8),
        truth=rng.integers(0, 256, (len(whole), 81)).astype(np.uint8),
    )
    for segment in (whole, other):
        assert np.array_equal(_label_by_crashes(segment, ACTIONS, AHEAD, TICK_S), np.concatenate(alone))


def test_returns_are_what_table_2_took_but_for_the_distance_of_sticks():
    reward, held = RewardConfig(), [AHEAD_STICK] * 40
    segment = driven(held, crashed=True)
    points = ACTIONS.points[segment.action]
    paid = reward_of_distance(np.minimum(np.linalg.norm(points - segment.stick, axis=1), reward.max_distance), reward)
    calm = paid - np.where(segment.crashed, reward.crash, 0.0)
    share = _label_by_returns(replace(segment, reward=calm.astype(np.float32)), ACTIONS, reward, 20)[:, AHEAD_STICK]
    assert np.allclose(share, 0.9 ** np.arange(39, -1, -1), atol=1e-5)
    cut = _label_by_returns(replace(driven(held), reward=paid.astype(np.float32)), ACTIONS, reward, 20)[:, AHEAD_STICK]
    assert np.allclose(cut[:20], 0.0, atol=1e-6) and (cut[20:] == UNKNOWN).all(), "nobody knows what follows a cut"
    assert (_label_by_returns(segment, ACTIONS, reward, 20)[:, LEFT] == UNKNOWN).all()


def test_what_the_oracle_drove_and_data_without_labels_are_refused():
    segment = driven([AHEAD_STICK] * 20)
    with pytest.raises(PolicyError, match=r"driven by the oracle.*collect it again"):
        Dataset(small_config(*WORDS)).add(replace(segment, driver=np.full(20, ORACLE, np.uint8)))
    with pytest.raises(PolicyError, match=r"labels for 0 actions; expected 81.*danger\.teacher"):
        Dataset(small_config()).add(segment)
    lessons = lessons_of(small_config(*WORDS), driven([AHEAD_STICK] * 5))
    with pytest.raises(PolicyError, match="nothing is known of 5 steps"):
        lessons.draw()


def test_what_is_not_known_is_neither_drawn_nor_learned(monkeypatch):
    lessons, seen = lessons_of(small_config(*WORDS), driven([AHEAD_STICK] * 20, crashed=True)), []
    assert lessons.tight_share == pytest.approx(7 / 20)
    loss = functional.binary_cross_entropy_with_logits

    def noted(logits, wanted):
        seen.append(wanted)
        return loss(logits, wanted)

    monkeypatch.setattr("wcsim.agents.danger.learner.functional.binary_cross_entropy_with_logits", noted)
    DangerLearner(small_config(*WORDS), 0, 3).learn(lessons, 3)
    assert {float(label) for labels in seen for label in labels} == {0.0, 1.0}
    assert all(16 <= len(labels) <= 16 * 5 for labels in seen), "each step with its neighbours"


# --- a toy street that knows what is unsafe: labels of what happened there have to agree with it ---

TOY = (*WORDS, "danger.batch=16", "danger.learning_rate=0.005", "danger.tight_share=0.35")


@pytest.fixture(scope="module")
def rides():
    return ride(toy_config(*TOY), astray(), 40, seed=1, labelled=True)


FAULTS = {  # of labels, by the steps of a segment and what makes labels of them
    "sign turned": lambda of, made: np.array([1, 0, UNKNOWN], np.uint8)[made(of)],
    "late": lambda of, made: np.roll(made(of), 8, axis=0),
    "stale stick": lambda of, made: made(replace(of, action=ACTIONS.nearest_many(of.wish).astype(np.uint8))),
    "a cut is no end": lambda of, made: made(replace(of, ended=of.crashed)),
}


def agreement(rides):
    """Four shares that are 1 at the best: of labels that say 1, what the street itself calls unsafe; of those that say
    0, what it calls safe; of steps of which something is known, those in which it is so of the executed position; of
    the last steps before a cut, those of which nothing is known."""
    segment = segment_of(rides.rows)
    labels = Dataset(toy_config(*TOY))._labels(segment)
    unsafe, known = np.stack([row[1] for row in rides.rows]), labels < UNKNOWN
    executed = known[np.arange(len(segment)), segment.action]
    cuts = np.flatnonzero(segment.ended & ~segment.crashed)
    before = known[(cuts[:, None] - np.arange(CLEAR)).ravel()].any(axis=1)
    shares = unsafe[labels == 1], ~unsafe[labels == 0], executed[known.any(axis=1)], ~before
    return [share.mean() for share in shares]


def agrees(found):
    return (np.array(found) > (0.95, 0.91, 0.99, 0.99)).all()


def test_labels_of_what_happened_agree_with_the_street(rides):
    """0.98, 0.94, 1, 1."""
    assert rides.crashes > 10 and agrees(agreement(rides)), agreement(rides)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_in_labels_is_found_out(fault, rides, monkeypatch):
    monkeypatch.setattr(
        "wcsim.agents.danger.dataset._label_by_crashes",
        lambda of, *more: FAULTS[fault](of, lambda segment: _label_by_crashes(segment, *more)),
    )
    assert not agrees(agreement(rides)), agreement(rides)


@pytest.mark.proof
def test_a_network_that_learned_from_crashes_alone_crashes_less_than_the_user():
    """16 crashes in 1,000 steps; the user alone 32."""
    config = toy_config(*TOY)
    learner = DangerLearner(config, 0, 600)
    learner.learn(lessons_of(config, segment_of(ride(config, astray(), 120, seed=1).rows)), 600)
    mine = ride(config, DangerPolicy("toy", learner.net, config, DangerRuleSettings(threshold=0.25)), 20, seed=99)
    alone = ride(config, follow, 20, seed=99)
    assert mine.crashes / mine.steps <= 0.7 * alone.crashes / alone.steps, (mine.crashes, mine.steps)
    assert mine.way_m / mine.steps >= 0.3 * alone.way_m / alone.steps

"""FrameReplay against a reference that keeps every step of every episode in plain lists."""

from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.agents.toy import make_replay
from tests.support.samples import stacked
from wcsim.agents.envs.episode_view import WORLD_RESTARTED
from wcsim.agents.learning.checkpoint import _replay_arrays, _restore_replay
from wcsim.agents.learning.replay import frame_store
from wcsim.agents.learning.replay.buffer import FrameReplay
from wcsim.agents.learning.replay.frame_store import _PackedFrames, _RawFrames
from wcsim.errors import PolicyError
from wcsim.supervisor.observation import make_observation_space

H, W = 2, 3
SPACE = make_observation_space("compact", W, H)
ENDS = ("go", "go", "go", "go", "crash", "limit", "reset")


def observation(number):
    """An observation that is told apart by one number."""
    image = np.full((1, H, W), number % 251, np.uint8)
    joystick = np.array([number / 5000, -number / 5000], np.float32)
    return {"seg": image, "depth": image[::1] // 2, "imu": np.zeros(5, np.float32), "joystick": joystick}


def stack(numbers):
    return stacked([observation(n) for n in numbers])


def number_of(vector):
    return round(float(vector[0]) * 5000)


class Reference:
    """Every seat's steps as (observation number, action, reward, end) in time order; "reset" means cut from outside."""

    def __init__(self, seats):
        self.steps = [[] for _ in range(seats)]

    def transition(self, seat, index, n_step, gamma):
        """(return, discount, terminated, number of the observation after) of the chain that starts at `index`."""
        steps, total, weight = self.steps[seat], 0.0, 1.0
        k = index
        for _ in range(n_step):
            _, _, after, reward, end = steps[k]
            if k == len(steps) - 1 and end == "go":
                break  # the newest step has no stored successor
            total += weight * reward
            weight *= gamma
            last_after, last_end = after, end
            if end != "go":
                break
            k += 1
        return total, weight, last_end == "crash", last_after


def fill(buffer, reference, plan, seats):
    """Feed `plan`, a list of per-seat ends a step, to both."""
    numbers = iter(range(1, 100_000))
    now = [next(numbers) for _ in range(seats)]
    for step, ends in enumerate(plan):
        after = [next(numbers) for _ in range(seats)]
        actions, rewards = np.array([step % 81] * seats), np.array([float(n % 7) - 3 for n in now])
        done = np.array([e in ("crash", "limit") for e in ends])
        infos = [{"TimeLimit.truncated": e == "limit"} for e in ends]
        buffer.add(stack(now), stack(after), actions, rewards, done, infos)
        for seat in range(seats):
            reference.steps[seat].append((now[seat], actions[seat], after[seat], rewards[seat], ends[seat]))
        now = [a if e == "go" else next(numbers) for a, e in zip(after, ends, strict=True)]
    return now


def check(buffer, reference, starts, seats):
    batch = buffer.gather(starts, seats)
    for k, (index, seat) in enumerate(zip(starts, seats, strict=True)):
        number, action, *_ = reference.steps[seat][index]
        want = reference.transition(seat, index, buffer.n_step, buffer.gamma)
        assert number_of(batch.observations["joystick"][k]) == number
        assert batch.observations["seg"][k].unique().tolist() == [number % 251]
        assert batch.actions[k, 0] == action
        assert float(batch.rewards[k, 0]) == pytest.approx(want[0], abs=1e-4)
        assert float(batch.discounts[k, 0]) == pytest.approx(want[1], abs=1e-6)
        assert bool(batch.dones[k, 0]) == want[2]
        assert number_of(batch.next_observations["joystick"][k]) == want[3]
        assert batch.next_observations["seg"][k].unique().tolist() == [want[3] % 251]


@settings(max_examples=60)
@given(st.data())
def test_every_draw_is_the_references_transition(data):
    seats, n_step = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 6))
    size, share = data.draw(st.integers(4, 40)), data.draw(st.sampled_from([0.0, 0.5]))
    ends = st.lists(st.sampled_from(ENDS), min_size=seats, max_size=seats)
    plan = data.draw(st.lists(ends, min_size=2, max_size=60))
    # A cut from outside is only known when the next observation comes.
    plan[-1] = ["go" if e == "reset" else e for e in plan[-1]]
    chosen = {"n_step": n_step, "gamma": 0.9, "precrash_share": share}
    buffer = make_replay(size * seats, SPACE, seats, seed=1, **chosen)
    buffer.precrash_window = 5
    reference = Reference(seats)
    fill(buffer, reference, plan, seats)
    starts, drawn = buffer.draw(64)
    assert starts.min() >= buffer.total - buffer.size()
    assert starts.max() < buffer.total
    check(buffer, reference, starts, drawn)
    kept = {(index, seat) for seat in range(seats) for index, s in enumerate(reference.steps[seat]) if s[4] == "crash"}
    assert set(buffer.crashes) == {c for c in kept if c[0] >= buffer.total - buffer.size()}
    assert len(buffer.after_end) <= buffer.size() * seats


def filled(plan, seats=1, **settings):
    buffer = make_replay(200, SPACE, seats, **settings)
    reference = Reference(seats)
    fill(buffer, reference, plan, seats)
    return buffer, reference


def test_truncation_bootstraps_from_its_own_last_observation_and_a_crash_does_not():
    buffer, reference = filled([["go"], ["limit"], ["go"], ["crash"]], n_step=3, gamma=0.5)
    batch = buffer.gather(np.array([0, 2]), np.array([0, 0]))
    assert batch.dones[:, 0].tolist() == [0.0, 1.0]
    assert batch.discounts[:, 0].tolist() == [0.25, 0.25]
    assert number_of(batch.next_observations["joystick"][0]) == reference.steps[0][1][2]


@pytest.mark.parametrize("driven", [0, 1, 4])
def test_a_step_that_was_never_driven_is_left_out_and_the_one_before_leads_to_its_observation(driven):
    buffer, reference = filled([["go"]] * driven, n_step=3, gamma=0.5)
    last = reference.steps[0][-1][2] if driven else 77
    cut = {"TimeLimit.truncated": True, WORLD_RESTARTED: True}
    buffer.add(stack([last]), stack([last]), np.array([9]), np.zeros(1), np.array([True]), [cut])
    assert buffer.total == driven
    after = [9001, 9002, 9003]  # of the episode that begins with the new world
    for now, then in pairwise(after):
        buffer.add(stack([now]), stack([then]), np.array([0]), np.ones(1), np.array([False]), [{}])
    assert buffer.episode_step[driven : driven + 2, 0].tolist() == [0, 1]
    if driven:
        reference.steps[0][-1] = (*reference.steps[0][-1][:4], "limit")  # it is the last one of its episode
        check(buffer, reference, np.arange(driven), np.zeros(driven, int))


def test_precrash_steps_are_their_share_of_a_batch():
    plan = [["go"]] * 80 + [["crash"]] + [["go"]] * 80
    buffer, _ = filled(plan, precrash_share=0.25, n_step=5, gamma=0.97)
    starts, _ = buffer.draw(4000)
    before = np.sum((starts > 60) & (starts <= 80)) / 4000
    assert before == pytest.approx(0.25 + 0.75 * 20 / 160, abs=0.02)
    evenly = filled(plan)[0].draw(4000)[0]
    assert np.sum((evenly > 60) & (evenly <= 80)) / 4000 == pytest.approx(20 / 160, abs=0.02)


def test_equal_seeds_draw_equally():
    plan = [["go"]] * 50
    draws = [filled(plan, seed=s)[0].draw(32)[0].tolist() for s in (4, 4, 5)]
    assert draws[0] == draws[1] != draws[2]


def test_frames_are_kept_once():
    buffer, _ = filled([["go"]] * 30)
    assert isinstance(buffer.windows.frames, _RawFrames)
    assert buffer.windows.frames._frames.nbytes == 200 * 2 * H * W
    assert not buffer.after_end


@pytest.mark.parametrize("smooth", [0, 25_000])
def test_large_frames_are_packed_and_come_back(smooth):
    g = np.random.default_rng(0)
    store = frame_store._frame_store(5, 2, 50_000, smooth)
    assert isinstance(store, _PackedFrames)
    frames = g.integers(0, 4, (5, 2, 50_000), dtype=np.uint8)
    for row in range(5):
        for seat in range(2):
            store.write(row, seat, frames[row, seat])
    rows, seats = np.array([4, 0, 3]), np.array([1, 0, 1])
    assert np.array_equal(store.read(rows, seats), frames[rows, seats])
    assert max(len(blob) for row in store._blobs for blob in row) < 20_000


@pytest.mark.parametrize("steps", [30, 500])
def test_a_restored_memory_draws_the_same(steps):
    g = np.random.default_rng(steps)
    plan = [[ENDS[g.integers(len(ENDS))], ENDS[g.integers(len(ENDS))]] for _ in range(steps)] + [["go", "crash"]]
    buffer, reference = filled(plan, seats=2, n_step=3, gamma=0.9, precrash_share=0.5)
    twin, _ = filled([["go", "go"]], seats=2, n_step=3, gamma=0.9, precrash_share=0.5)
    _restore_replay(twin, _replay_arrays(buffer))
    twin.rng = np.random.Generator(np.random.Philox(7))
    buffer.rng = np.random.Generator(np.random.Philox(7))
    mine, theirs = buffer.draw(64), twin.draw(64)
    assert np.array_equal(mine, theirs)
    check(twin, reference, *theirs)
    # Both go on in a new episode: the open chain of seat 0 is cut there, with its true last observation.
    for each in (buffer, twin):
        each.add(stack([9001, 9002]), stack([9003, 9004]), np.array([0, 0]), np.zeros(2), np.zeros(2, bool), [{}, {}])
    index = np.array([twin.total - 2])
    batch = twin.gather(index, np.array([0]))
    assert number_of(batch.next_observations["joystick"][0]) == reference.steps[0][-1][2]


def test_too_little_is_said():
    buffer, _ = filled([["go"]])
    with pytest.raises(ValueError, match="at least 2"):
        buffer.draw(4)


def test_images_of_two_kinds_are_refused():
    boxes = {"depth": gym.spaces.Box(0, 1, (1, 4, 4), np.float32), "seg": gym.spaces.Box(0, 255, (1, 4, 4), np.uint8)}
    with pytest.raises(PolicyError, match="are of uint8 and float32; expected one kind"):
        FrameReplay(10, gym.spaces.Dict(boxes), gym.spaces.Discrete(2))

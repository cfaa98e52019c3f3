"""Memory (a) of the paper: groups shuffled before each draw, inside their episode, with the state that was stored."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.agents.learning.replay.test_buffer import ENDS, SPACE, Reference, check, fill, number_of, stack
from tests.agents.toy import make_replay
from wcsim.agents.learning.checkpoint import _check_fit, _replay_arrays, _restore_replay
from wcsim.agents.learning.replay.buffer import FrameReplay

PLANS = st.integers(1, 3).flatmap(
    lambda seats: st.lists(
        st.lists(st.sampled_from((*ENDS, "go", "go")), min_size=seats, max_size=seats), min_size=12, max_size=90
    )
)


def memory(seats=1, rows=60, length=4, burn_in=3, state_size=0, **more):
    chosen = {"memory": "groups", "seed": 1, **more}
    buffer = make_replay(rows * seats, SPACE, seats, **chosen, group_steps=length, burn_in=burn_in)
    buffer.groups.state_size = state_size
    return buffer


def driven(plan, **chosen):
    """A memory and what was driven; the state before each step is the number of that step's observation."""
    plan = [*plan[:-1], ["go" if end == "reset" else end for end in plan[-1]]]
    buffer, reference, numbers = memory(len(plan[0]), **chosen), Reference(len(plan[0])), []
    add = buffer.add

    def noted(obs, *step):
        numbers.append([number_of(v) for v in obs["joystick"]])
        buffer.groups.next_states = np.array(numbers[-1], np.float32)[:, None]
        add(obs, *step)

    buffer.add = noted
    fill(buffer, reference, plan, len(plan[0]))
    return buffer, reference


def episodes(reference, seat):
    """First and last step of each episode of a seat; the open one has the last step that there is."""
    first, found = 0, []
    steps = reference.steps[seat]
    for index, step in enumerate(steps):
        if step[4] != "go" or index == len(steps) - 1:
            found.append((first, index, step[4] != "go"))
            first = index + 1
    return found


def expected_groups(buffer, reference, length, burn_in):
    """By hand: {(first step, seat): steps} of all whole groups whose steps and burn-in are still there."""
    oldest, out = buffer.total - buffer.size(), {}
    for seat in range(len(reference.steps)):
        for first, last, closed in episodes(reference, seat):
            for start in range(first, last + 1, length):
                stop = min(start + length - 1, last)
                whole = (closed and stop == last) or (stop == start + length - 1 and stop < buffer.total - 1)
                back = start - max(first, start - burn_in) if buffer.groups.state_size else 0
                if whole and start - back >= oldest:
                    out[start, seat] = stop - start + 1
    return out


@settings(max_examples=60)
@given(PLANS, st.integers(1, 6), st.integers(0, 7), st.sampled_from((0, 1)), st.integers(20, 70))
def test_a_draw_shuffles_all_whole_groups(plan, length, burn_in, state_size, rows):
    buffer, reference = driven(plan, length=length, burn_in=burn_in, state_size=state_size, rows=rows)
    wanted = expected_groups(buffer, reference, length, burn_in)
    assert {tuple(row) for row in buffer.groups.complete(buffer).tolist()} == set(wanted)
    if not wanted:
        with pytest.raises(ValueError, match="no whole group"):
            buffer.sample_groups(32)
        return
    starts, seats = buffer.groups.draw(buffer, len(wanted))
    drawn = list(zip(starts.tolist(), seats.tolist(), strict=True))
    assert sorted(drawn) == sorted(wanted), "none is left out, none comes twice"
    assert [wanted[key] for key in drawn] == buffer.groups.lengths(buffer, starts, seats).tolist()


@settings(max_examples=60)
@given(PLANS, st.integers(1, 6), st.integers(0, 7), st.integers(1, 5), st.integers(20, 70))
def test_groups_hold_what_was_driven_and_never_another_episode(plan, length, burn_in, n_step, rows):
    chosen = {"length": length, "burn_in": burn_in, "state_size": 1, "rows": rows, "n_step": n_step, "gamma": 0.9}
    buffer, reference = driven(plan, **chosen)
    wanted = expected_groups(buffer, reference, length, burn_in)
    if not wanted:
        return
    starts, seats = np.array(sorted(wanted)).T
    batch = buffer.groups.gather(buffer, starts, seats)
    burned = {
        int(k): seen for rows_, seen in batch.burn_in for k, seen in zip(rows_, seen_of(rows_, batch), strict=True)
    }
    for k, (start, seat) in enumerate(zip(starts.tolist(), seats.tolist(), strict=True)):
        steps = reference.steps[seat]
        first = max(f for f, _, _ in episodes(reference, seat) if f <= start)
        assert batch.live[k].tolist() == [t < wanted[start, seat] for t in range(length)]
        entry = max(first, start - burn_in)
        assert float(batch.states[k, 0]) == (0.0 if entry == first else steps[entry][0])
        assert [number_of(v) for v in burned.get(k, [])] == [steps[t][0] for t in range(entry, start)]
        for t in range(wanted[start, seat]):
            total, discount, crashed, after = reference.transition(seat, start + t, n_step, 0.9)
            seen = batch.observations["joystick"][k]
            assert number_of(seen[t]) == steps[start + t][0]
            assert number_of(seen[batch.after[k, t]]) == after
            assert batch.observations["seg"][k, batch.after[k, t]].unique().tolist() == [after % 251]
            assert float(batch.returns[k, t]) == pytest.approx(total, abs=1e-4)
            assert float(batch.discounts[k, t]) == pytest.approx(discount, abs=1e-6)
            assert (float(batch.terminated[k, t]) == 1.0) == crashed
            assert int(batch.actions[k, t]) == steps[start + t][1]


def seen_of(rows, batch):
    """Joysticks (R, steps, 2) of the burn-in of these groups."""
    return next(seen["joystick"] for kept, seen in batch.burn_in if kept is rows)


@settings(max_examples=40)
@given(PLANS, st.integers(1, 6), st.integers(1, 4), st.integers(1, 40))
def test_a_network_without_a_state_learns_from_all_steps_of_groups(plan, length, n_step, size):
    buffer, reference = driven(plan, length=length, n_step=n_step, gamma=0.9)
    wanted = expected_groups(buffer, reference, length, 0)
    if not wanted:
        return
    drawn = memory_steps(buffer, size)
    assert len(drawn) == sum(wanted[key] for key in drawn_groups(buffer, size))
    starts, seats = np.array(drawn).T
    check(buffer, reference, starts, seats)


def drawn_groups(buffer, size):
    """The groups that the next batch is made of."""
    state = buffer.rng.bit_generator.state
    found = buffer.groups.draw(buffer, max(1, round(size / buffer.groups.length)))
    buffer.rng.bit_generator.state = state
    return list(zip(found[0].tolist(), found[1].tolist(), strict=True))


def memory_steps(buffer, size):
    """Steps and seats of the next batch, without taking it."""
    groups = drawn_groups(buffer, size)
    seen = []
    gather, buffer.gather = (
        buffer.gather,
        lambda starts, seats: seen.extend(zip(starts.tolist(), seats.tolist(), strict=True)),
    )
    state = buffer.rng.bit_generator.state
    buffer.sample(size)
    buffer.gather = gather
    buffer.rng.bit_generator.state = state
    assert {(s, k) for s, k in groups} <= set(seen)
    return seen


def test_a_group_can_be_drawn_as_soon_as_it_is_whole():
    buffer, _ = driven([["go"]] * 60, rows=60, length=4, burn_in=0)
    before = {int(k) for k, _ in buffer.groups.complete(buffer)}
    buffer.groups.draw(buffer, 5)
    for number in range(1000, 1012):
        one = (stack([number]), stack([number + 1]), np.array([0]), np.zeros(1), np.zeros(1, bool), [{}])
        FrameReplay.add(buffer, *one)
    now = {int(k) for k, _ in buffer.groups.complete(buffer)}
    assert len(before - now) == len(now - before) == 3
    assert set(buffer.groups.draw(buffer, len(now))[0].tolist()) == now


def test_equal_seeds_draw_equally_and_in_no_order():
    drawn = []
    for seed in (4, 4, 5):
        buffer, _ = driven([["go", "go"]] * 60, seed=seed)
        drawn.append([part.tolist() for part in buffer.groups.draw(buffer, 20)])
    assert drawn[0] == drawn[1] != drawn[2]
    assert drawn[0][0] != sorted(drawn[0][0])


def test_a_batch_has_about_as_many_steps_as_it_is_asked_for():
    buffer, _ = driven([["go"]] * 60, length=4, state_size=1)
    assert [int(buffer.sample_groups(size).live.sum()) for size in (1, 4, 16, 18)] == [4, 4, 16, 16]
    assert len(buffer.sample(16).actions) == 16


def test_states_go_with_their_steps():
    buffer, _ = driven([["go"]] * 300, rows=40, state_size=1)
    assert len(buffer.groups.states) == 40 // 4
    assert min(index for index, _ in buffer.groups.states) >= buffer.total - buffer.size()
    assert all(float(state[0]) == index + 1 for (index, _), state in buffer.groups.states.items())


def test_a_restored_memory_draws_the_same():
    plan = [["go", "crash" if k % 11 == 10 else "go"] for k in range(50)]
    buffer, _ = driven(plan, state_size=1)
    buffer.groups.draw(buffer, 5)
    twin = memory(2, state_size=1)
    kept = _replay_arrays(buffer)
    _check_fit(twin, kept)
    _restore_replay(twin, kept)
    twin.rng.bit_generator.state = buffer.rng.bit_generator.state
    for _ in range(9):
        a, b = buffer.sample_groups(16), twin.sample_groups(16)
        assert all(torch.equal(getattr(a, name), getattr(b, name)) for name in ("states", "live", "actions", "returns"))
    other = memory(2, state_size=2)
    with pytest.raises(ValueError, match="states is float32"):
        _check_fit(other, kept)

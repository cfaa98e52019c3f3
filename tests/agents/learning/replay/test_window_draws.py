"""What the samplers draw where an observation is a window of images: steps one by one, and steps of groups."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.agents.learning.replay.test_windows import WINDOWS, Street, add
from tests.agents.toy import make_replay

KINDS = st.sampled_from(("go", "go", "go", "go", "crash", "limit", "reset", "odd"))
PLANS = st.integers(1, 3).flatmap(
    lambda seats: st.lists(st.lists(KINDS, min_size=seats, max_size=seats), min_size=12, max_size=60)
)


def last_step(ends, start, n_step):
    """The last step of the returns from `start` on; the newest step counts only where its episode ended with it."""
    last = start
    for step in range(start, start + n_step):
        if step == len(ends) - 1 and ends[step] == "go":
            break
        last = step
        if ends[step] != "go":
            break
    return last


def begin_of(ends, step):
    """The first step of the episode of a step; what is only shown oddly goes on."""
    return max((k + 1 for k in range(step) if ends[k] not in ("go", "odd")), default=0)


@pytest.mark.parametrize("memory, precrash", [("windows", 0.5), ("windows", 0.0), ("groups", 0.0)])
@settings(max_examples=25)
@given(plan=PLANS, n_step=st.integers(1, 5), rows=st.integers(20, 70))
def test_windows_are_drawn_whole_with_what_came_after_and_never_of_two_episodes(memory, precrash, plan, n_step, rows):
    seats = len(plan[0])
    plan = [*plan[:-1], ["go" if end in ("reset", "odd") else end for end in plan[-1]]]  # known by the next step alone
    chosen = {"memory": memory, "group_steps": 4, "burn_in": 2, "n_step": n_step, "precrash_share": precrash}
    buffer = make_replay(rows * seats, WINDOWS, seats, seed=1, **chosen)
    buffer.precrash_window = 5
    streets = [Street() for _ in range(seats)]
    for ends in plan:
        add(buffer, streets, ends)
    if memory == "groups" and not len(buffer.groups.complete(buffer)):
        return
    drawn = []
    gather = buffer.gather
    buffer.gather = lambda starts, seat: drawn.append((starts, seat)) or gather(starts, seat)
    batch = buffer.sample(32)
    starts, seat = drawn[0]
    assert starts.min() >= buffer.total - buffer.size()
    for k, (start, which) in enumerate(zip(starts.tolist(), seat.tolist(), strict=True)):
        street, ends = streets[which], [row[which] for row in plan]
        last = last_step(ends, start, n_step)
        for key in WINDOWS.spaces:
            assert np.array_equal(batch.observations[key][k].numpy(), street.record[start][key])
            assert np.array_equal(batch.next_observations[key][k].numpy(), street.after[last][key])
        assert bool(batch.dones[k, 0]) == (ends[last] == "crash")
        assert float(batch.discounts[k, 0]) == pytest.approx(0.99 ** (last - start + 1))
        first = begin_of(ends, start)
        if "odd" not in ends[first:start]:
            own = {int(street.record[step]["seg"][-1, 0, 0]) for step in range(first, start + 1)}
            assert set(batch.observations["seg"][k, :, 0, 0].tolist()) <= own

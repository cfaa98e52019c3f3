"""Ledgers against a journal, epoch by epoch: what was lost, doubled or never done."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from wcsim.log.records import EpochBegun, SeenFrame
from wcsim.log.records import make_ticked_record as log_ticked
from wcsim.server.ledger import audit_ledgers
from wcsim.types import Command, Joystick


def ticked(epoch, tick, *seats):
    commands = tuple(Command(seat=seat, tick=tick - 1, joystick=Joystick(0.0, 0.0)) for seat in seats)
    return log_ticked(epoch, tick, commands, "00" * 8)


def seen(*frames):
    """Entries of (epoch, tick); those with a third item are first frames of a life."""
    return [SeenFrame(epoch=e, tick=t, stepped=not first) for e, t, *first in frames]


JOURNAL = [
    EpochBegun(epoch=0, seed=1),
    *(ticked(0, tick, 0) for tick in (1, 2, 3)),
    EpochBegun(epoch=1, seed=2, fresh=True),
    *(ticked(1, tick, 0) for tick in (1, 2)),
]
WHOLE = seen((0, 0, 1), (0, 1), (0, 2), (0, 3), (1, 0, 1), (1, 1), (1, 2))


def counts(entries, records=JOURNAL):
    found, _ = audit_ledgers(iter(records), [(0, iter(entries))])
    return found.ticks, found.lost, found.doubled, found.phantom


def test_what_is_whole_is_whole():
    assert counts(WHOLE) == (5, 0, 0, 0)


def test_the_last_step_of_a_life_may_be_missing_and_no_other():
    assert counts([entry for entry in WHOLE if (entry.epoch, entry.tick) != (0, 3)]) == (5, 0, 0, 0)
    assert counts([entry for entry in WHOLE if (entry.epoch, entry.tick) != (0, 2)]) == (5, 1, 0, 0)
    assert counts(WHOLE[:-1]) == (5, 0, 0, 0) and counts(WHOLE[:-2]) == (5, 1, 0, 0)
    assert counts([]) == (5, 5, 0, 0)


def test_what_was_seen_twice_or_never_done_is_found():
    assert counts([*WHOLE[:3], WHOLE[2], *WHOLE[3:]]) == (5, 0, 1, 0)
    assert counts([*WHOLE, *seen((1, 3))]) == (5, 0, 0, 1)
    assert counts([*WHOLE, *seen((2, 0, 1), (2, 1))]) == (5, 0, 0, 1), "an epoch that the journal does not have"
    assert counts(WHOLE, JOURNAL[:4]) == (3, 0, 0, 2)
    assert counts([*WHOLE, *seen((0, 2))]) == (5, 0, 0, 1), "an epoch that is over"


def test_each_ledger_by_itself_and_a_ledger_by_itself():
    records = [EpochBegun(epoch=0, seed=1), ticked(0, 1, 0, 1), ticked(0, 2, 0), ticked(0, 3, 0, 1)]
    whole, gone = seen((0, 0, 1), (0, 1), (0, 2), (0, 3)), seen((0, 0, 1), (0, 3))
    whole, (one, other) = audit_ledgers(records, [(0, whole), (1, gone)])
    assert whole.ticks == 3 and (one.lost, one.phantom) == (0, 0) and (other.lost, other.phantom) == (1, 0)
    assert (other.first_tick, other.last_tick, other.steps, other.missing) == (0, 3, 1, 2)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 4), st.booleans()), max_size=12), st.data())
def test_the_same_as_with_everything_in_memory(frames, data):
    """Against counting by sets over all epochs at once, for ledgers and journals whose epochs do not go back."""
    entries = [SeenFrame(epoch=e, tick=t, stepped=s) for e, t, s in sorted(frames, key=lambda f: f[0])]
    done = data.draw(st.sets(st.tuples(st.integers(0, 3), st.integers(1, 4))))
    records = [ticked(epoch, tick, 0) for epoch, tick in sorted(done)]
    mine = {(entry.epoch, entry.tick) for entry in entries if entry.stepped}
    lives = [a for a, b in pairwise(entries) if not b.stepped] + entries[-1:]
    ends = {(entry.epoch, entry.tick + 1) for entry in lives}
    found, _ = audit_ledgers(records, [(0, entries)])
    assert (found.lost, found.phantom) == (len(done - mine - ends), _phantoms(entries, done))


def _phantoms(entries, done):
    """A step of an epoch that the journal has counts once; of one that it has not, as often as it was seen."""
    epochs = {epoch for epoch, _ in done}
    known = {(e.epoch, e.tick) for e in entries if e.stepped and e.epoch in epochs} - done
    return len(known) + sum(e.stepped and e.epoch not in epochs for e in entries)

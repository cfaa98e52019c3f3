"""Threads that share out work: all of it is done once, errors come through, and nothing outlives a close."""

import threading
import time
from functools import partial

import pytest

from wcsim.physics.sensors.drawing_threads import DrawingThreads, cores


def named():
    return [thread for thread in threading.enumerate() if thread.name.startswith("wcsim-draw")]


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("pieces", [0, 1, 3, 50])
def test_each_piece_is_done_once(threads, pieces):
    done = []
    pool = DrawingThreads(threads)
    pool.run([partial(done.append, number) for number in range(pieces)])
    assert sorted(done) == list(range(pieces))
    assert len(named()) <= threads - 1
    pool.close()
    pool.close()
    assert not named()


def turns_of_two(run):
    """Turns of two pieces of work that wait for each other, as `run` gives them to a pool."""
    both, turns = threading.Barrier(2, timeout=20.0), []
    pool = DrawingThreads(2)
    run(pool, lambda: turns.append(both.wait()))
    pool.close()
    return sorted(turns)


def test_two_pieces_are_at_work_at_once():
    assert turns_of_two(lambda pool, meet: pool.run([meet] * 2)) == [
        0,
        1,
    ]  # neither waited in vain: a broken barrier raises


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_an_error_comes_through_when_nothing_is_at_work_any_more(threads):
    at_work = []

    def piece(number):
        at_work.append(number)
        time.sleep(0.01)
        at_work.remove(number)
        if number == 2:
            raise ValueError("piece 2")

    pool = DrawingThreads(threads)
    with pytest.raises(ValueError, match="piece 2"):
        pool.run([partial(piece, number) for number in range(9)])
    assert not at_work
    pool.close()


def test_one_thread_starts_none_and_there_is_a_core():
    pool = DrawingThreads(1)
    pool.run([lambda: None] * 5)
    assert not named() and cores() >= 1
    pool.close()


@pytest.mark.parametrize("threads", [1, 2])
def test_meanwhile_is_done_once_by_whoever_asks_and_its_error_waits_for_the_others(threads):
    pool, done, began = DrawingThreads(threads), [], []
    pool.run([lambda: done.append("piece")] * 3, lambda: done.append(threading.current_thread()))
    assert done.count("piece") == 3 and done.count(threading.current_thread()) == 1

    def fails():
        raise ValueError("meanwhile")

    def slow():
        began.append(1)
        time.sleep(0.02)
        began.pop()

    with pytest.raises(ValueError, match="meanwhile"):
        pool.run([slow] * 3, fails)
    assert not began
    pool.close()


def test_others_draw_while_whoever_asks_does_something_else():
    assert turns_of_two(lambda pool, meet: pool.run([meet, lambda: None], meet)) == [0, 1]

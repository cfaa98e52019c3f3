"""A client's ledger goes on over its lives, and is taken for no other log."""

import pytest

from tests.log.test_log import write
from wcsim.errors import ConfigError, JournalError
from wcsim.log.diff import find_log_difference
from wcsim.log.reader import iter_journal_inputs
from wcsim.log.records import SeenFrame
from wcsim.server.ledger import iter_ledger_frames, open_ledger_writer


def seen(tick, stepped=True):
    return SeenFrame(epoch=0, tick=tick, stepped=stepped)


def filled(path, *frames):
    with open_ledger_writer(path, "c0") as ledger:
        for frame in frames:
            ledger.append(frame)
    return path.read_bytes()


def test_it_goes_on_where_the_last_life_ended_and_says_what_was_torn(tmp_path):
    path = tmp_path / "ledgers" / "c0.ledger"
    whole = filled(path, seen(0, stepped=False), seen(1))
    path.write_bytes(whole[:-3])
    with open_ledger_writer(path, "c0") as ledger:
        assert ledger.cut_bytes > 0
        ledger.append(seen(1))
    assert path.read_bytes() == whole and path.with_name("c0.ledger.torn").exists()
    filled(path, seen(2))
    assert list(iter_ledger_frames(path)) == [seen(0, stepped=False), seen(1), seen(2)]


def test_a_frame_takes_few_bytes(tmp_path):
    assert len(filled(tmp_path / "many", *map(seen, range(9000, 9100)))) - len(filled(tmp_path / "none")) <= 3200


def test_two_of_them_are_compared_and_other_logs_are_refused(tmp_path):
    filled(tmp_path / "a", seen(0), seen(1))
    filled(tmp_path / "b", seen(0), seen(2))
    assert (
        find_log_difference(tmp_path / "a", tmp_path / "b")
        == "SeenFrame (epoch 0, tick 1) against SeenFrame (epoch 0, tick 2)"
    )
    write(tmp_path / "journal")
    for use in (iter_ledger_frames, lambda path: open_ledger_writer(path, "c0")):
        with pytest.raises(JournalError, match="is not a ledger but a journal"):
            use(tmp_path / "journal")
    with pytest.raises(JournalError, match="is not a journal but a ledger"):
        next(iter_journal_inputs(tmp_path / "a"))


def test_two_lives_at_once_are_refused(tmp_path):
    with open_ledger_writer(tmp_path / "a", "c0"), pytest.raises(ConfigError, match="another process is writing"):
        open_ledger_writer(tmp_path / "a", "c0")

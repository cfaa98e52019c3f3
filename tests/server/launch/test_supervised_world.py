"""What a launcher orders from each life of its world, and what it says of one that dies again and again."""

import json
import shlex
from pathlib import Path

from tests.server.launch.test_launcher import STUB, launcher
from wcsim.log.records import EpochBegun, Header, make_ticked_record
from wcsim.log.writer import JOURNAL, LogWriter


def orders_of(folder: Path, words: str, key: str, listen: str = "") -> list[object]:
    """What a launch with these worlds told each of them under a key; all goes well."""
    seen = folder / "orders"
    argv = ("sh", "-c", f'cat "$0" >> "{seen}"; exec {shlex.join((*STUB, "world"))} "$0"')
    outcome = launcher(folder, {"a": "steps=300"}, world=words, world_argv=argv, listen=listen).run()
    assert outcome.code == 0, outcome.message
    return [json.loads(line)[key] for line in seen.read_text().splitlines()]


def test_worlds_know_that_clients_have_yet_to_load_until_one_of_them_was_there(tmp_path):
    words = "die=0x2 die=30x3"  # two lives end before they say that they are loaded, and one later
    assert orders_of(tmp_path, words, "begins") == [True, True, True, False]


def test_a_world_that_comes_back_listens_where_the_one_before_did(tmp_path):
    """Its clients on other machines know no other port than the one that was found for the first."""
    words = "die=20x1 exit5=40x2"  # one life dies, one ends with its epoch
    found = "tcp://127.0.0.1:5001"
    assert orders_of(tmp_path, words, "listen", "tcp://127.0.0.1:*") == ["tcp://127.0.0.1:*", found, found]


def test_where_a_world_died_that_never_came_up_is_read_from_its_journal(tmp_path):
    header = Header(name="", town="", town_sha256="", config="{}", seed=0, seats=1, tick_s=0.1, fingerprint="")
    with LogWriter(tmp_path / JOURNAL, header) as journal:
        for epoch, ticks in ((0, 9), (1, 5)):
            journal.append(EpochBegun(epoch=epoch, seed=0, fresh=True))
            for tick in range(1, ticks + 1):
                journal.append(make_ticked_record(epoch, tick, (), ""))
    outcome = launcher(tmp_path, {"a": "steps=100000"}, world="die=0").run()
    assert outcome.code == 1 and "died 5 times at tick 5" in outcome.message

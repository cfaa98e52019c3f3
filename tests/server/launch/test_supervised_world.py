"""What a launcher orders from each life of its world, and what it says of one that dies again and again."""

from __future__ import annotations

import json
from pathlib import Path

from tests.server.launch.test_launcher import STUB, launcher
from tests.server.servers import OtherWorlds
from wcsim.log.records import EpochBegun, Header, ticked
from wcsim.log.writer import JOURNAL, LogWriter
from wcsim.server.launch.supervised import WORLD_ARGV


class OrdersSeen(OtherWorlds):
    """Keeps what each world is told of who comes to it."""

    def __init__(self):
        super().__init__(*STUB, "world")
        self.begins, self.listens = [], []

    def start(self, argv, env, log, status_fd):
        if tuple(argv[: len(WORLD_ARGV)]) == WORLD_ARGV:
            order = json.loads(Path(argv[-1]).read_text())
            self.begins.append(order["begins"])
            self.listens.append(order["listen"])
        return super().start(argv, env, log, status_fd)


def test_worlds_know_that_clients_have_yet_to_load_until_one_of_them_was_there(tmp_path):
    seen = OrdersSeen()
    words = "die=0x2 die=30x3"  # two lives end before they say that they are loaded, and one later
    outcome = launcher(tmp_path, {"a": "steps=300"}, world=words, spawner=seen).run()
    assert (outcome.code, seen.begins) == (0, [True, True, True, False])


def test_a_world_that_comes_back_listens_where_the_one_before_did(tmp_path):
    """Its clients on other machines know no other port than the one that was found for the first."""
    seen = OrdersSeen()
    words = "die=20x1 exit5=40x2"  # one life dies, one ends with its epoch
    outcome = launcher(tmp_path, {"a": "steps=300"}, world=words, spawner=seen, listen="tcp://127.0.0.1:*").run()
    assert (outcome.code, seen.listens) == (0, ["tcp://127.0.0.1:*", "tcp://127.0.0.1:5001", "tcp://127.0.0.1:5001"])


def test_where_a_world_died_that_never_came_up_is_read_from_its_journal(tmp_path):
    header = Header(name="", town="", town_sha256="", config="{}", seed=0, seats=1, tick_s=0.1, fingerprint="")
    with LogWriter(tmp_path / JOURNAL, header) as journal:
        for epoch, ticks in ((0, 9), (1, 5)):
            journal.append(EpochBegun(epoch=epoch, seed=0, fresh=True))
            for tick in range(1, ticks + 1):
                journal.append(ticked(epoch, tick, (), ""))
    outcome = launcher(tmp_path, {"a": "steps=100000"}, world="die=0").run()
    assert outcome.code == 1 and "died 5 times at tick 5" in outcome.message

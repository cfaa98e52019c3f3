"""Worlds whose every change goes to a journal, as a server does it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType

from tests.support.framing import chained, record_ends
from tests.support.worlds import quick_config
from wcsim.bridge.town_run import as_recorded, chair_box_m
from wcsim.bridge.world import World
from wcsim.log.fingerprint import make_software_fingerprint
from wcsim.log.reader import hash_log, iter_journal_inputs, read_header
from wcsim.log.records import (
    Admitted,
    Dismissed,
    EpochBegun,
    Header,
    Input,
    Respawned,
    Ticked,
    header_to_bytes,
    make_ticked_record,
    record_to_bytes,
    with_fields,
    world_state_from_snapshot,
)
from wcsim.log.writer import LogWriter
from wcsim.towns.scenario.town import find_town, streets_hash
from wcsim.types import Command, Joystick, SeatSpec, Snapshot

SPEC = SeatSpec(profile="competent", max_steps=25)


class JournaledWorld:
    """A world with free seats, its journal, and a trace of its first epoch."""

    def __init__(self, corner: Path, run: Path, *words: str, seed: int = 5, seats: int = 3) -> None:
        config, town = quick_config(*words), find_town(str(corner))
        self.world = World(town, config, (None,) * seats, seed)
        header = Header(
            name=run.name,
            town=town.address,
            town_sha256=streets_hash(town),
            config=config.model_dump_json(),
            seed=seed,
            seats=seats,
            tick_s=config.world.tick_s,
            fingerprint=make_software_fingerprint(),
        )
        self.writer = LogWriter(run / "journal", header)
        trace = Header(
            town=town.name,
            seed=seed,
            tick_s=config.world.tick_s,
            seats=seats,
            fingerprint=make_software_fingerprint(),
            origin_m=town.file.origin_m,
            origin_z_m=self.world.street.net_origin_m[2],
            chair_box_m=chair_box_m(config.chair),
        )
        self.trace = LogWriter(run / "beside.trace", trace)
        self.writer.append(EpochBegun(epoch=0, seed=seed))

    def __enter__(self) -> JournaledWorld:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.writer.close()
        self.trace.close()
        self.world.close()

    @property
    def now(self) -> Snapshot:
        return self.world.snapshot

    def admit(self, seat: int, spec: SeatSpec = SPEC) -> None:
        self.world.admit(seat, spec)
        self.writer.append(Admitted(epoch=self.now.epoch, tick=self.now.tick, seat=seat, spec=spec, name=f"c{seat}"))

    def dismiss(self, seat: int) -> None:
        self.world.dismiss(seat)
        self.writer.append(Dismissed(epoch=self.now.epoch, tick=self.now.tick, seat=seat, reason="left"))

    def respawn(self, seat: int) -> None:
        self.world.respawn(seat)
        self.writer.append(Respawned(epoch=self.now.epoch, tick=self.now.tick, seat=seat))

    def rebuild(self, seed: int) -> None:
        self.world.rebuild(seed)
        self.writer.append(EpochBegun(epoch=self.now.epoch, seed=seed))

    def tick(self, ticks: int, given: Mapping[int, Joystick] = MappingProxyType({})) -> None:
        """So many ticks; who is given nothing weaves."""
        for _ in range(ticks):
            before = self.now
            commands = tuple(
                Command(
                    seat=client.seat,
                    tick=before.tick,
                    joystick=given.get(client.seat, Joystick(0.8 * math.sin(0.3 * before.tick + client.seat), 0.9)),
                )
                for client in before.clients
            )
            after = self.world.tick(commands)
            self.writer.append(make_ticked_record(after.epoch, after.tick, commands, after.state_hash))
            if after.epoch == 0:
                self.trace.append(
                    world_state_from_snapshot(after, commands, as_recorded(after, self.world.sumo.everyone()))
                )


def eventful_run(corner: Path, run: Path) -> dict[str, object]:
    """150 ticks in two epochs with everything that a server does; what happened in them."""
    run.mkdir(exist_ok=True)
    crashes = episodes = 0
    with JournaledWorld(corner, run) as it:
        script = (
            *(("tick", 5), ("admit", 1), ("tick", 20), ("admit", 0), ("tick", 20), ("respawn", 1), ("tick", 20)),
            *(("dismiss", 1), ("tick", 10), ("admit", 2), ("admit", 1), ("tick", 15), ("rebuild", 9), ("tick", 20)),
            *(("dismiss", 0), ("tick", 10), ("admit", 0), ("tick", 30)),
        )
        for name, number in script:
            if name != "tick":
                getattr(it, name)(number)
                continue
            for _ in range(number):
                it.tick(1)
                crashes += sum(client.events.crashed for client in it.now.clients)
                episodes += sum(client.first is not None for client in it.now.clients)
        return {
            "crashes": crashes,
            "episodes": episodes,
            "state_hash": it.now.state_hash,
            "digest": hash_log(run / "journal"),
        }


def rewritten(journal: Path, out: Path, change: dict[int, Input]) -> Path:
    """A copy of a journal with other records at some places."""
    records = [change.get(number, record) for number, record in enumerate(iter_journal_inputs(journal))]
    out.parent.mkdir(exist_ok=True)
    out.write_bytes(chained([header_to_bytes(read_header(journal)), *map(record_to_bytes, records)]))
    assert len(record_ends(out)) == len(records) + 1
    return out


def nudged(record: Input) -> Ticked:
    """A tick in which the first seat was commanded something a little else."""
    assert isinstance(record, Ticked)
    (x, y), *others = record.sticks
    return with_fields(record, sticks=((x, y - 2.0**-8), *others))

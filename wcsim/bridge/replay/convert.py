"""Logs as files of others: SUMO's floating car data, and ROS 2 messages in MCAP. A journal's world is made again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

from wcsim.bridge.ego.randomization import moved
from wcsim.bridge.recording.fcd import write_fcd, write_steps
from wcsim.bridge.recording.ros_bag import RosBag
from wcsim.bridge.recording.ros_chairs import RosChair, drive_bag, trace_bag
from wcsim.bridge.recording.states import chair_box_m, state_of
from wcsim.bridge.replay.player import require_equal
from wcsim.bridge.replay.replayed import replayed, require_hook
from wcsim.bridge.town_run import as_recorded
from wcsim.bridge.world import World
from wcsim.core.reading import escaped
from wcsim.errors import ConfigError, WcsimError
from wcsim.log.drive import read_drive
from wcsim.log.reader import read_header, read_states
from wcsim.log.records import Header, Input, Ticked, WorldState
from wcsim.types import ClientSnapshot, Drawn


def convert_to_fcd(log: Path, out: Path, epoch: int = 0, hook: str = "") -> int:
    """Write an epoch of a trace or a journal as FCD; returns the number of its time steps.

    Raises:
        ReplayMismatchError: A tick gave another state than the journal says.
        WcsimError: It is a drive, or has no such epoch; or as `replayed` does.
    """
    header = read_header(log)
    require_hook(header, hook)
    if header.kind == "drive":
        raise ConfigError(f"{escaped(log)}: is a drive, which holds no traffic; expected a trace or a journal")
    if header.kind == "trace":
        return write_fcd(log, out, epoch)
    with closing(replayed(log, epoch, None, hook)) as steps:
        world, _ = next(steps)
        written = write_steps(_trace_header(header, world), _ticks(steps), out)
    if not written:
        raise WcsimError(f"{log}: has no tick of epoch {epoch}; choose another --epoch")
    return written


def convert_to_mcap(log: Path, out: Path, epoch: int = 0, hook: str = "") -> dict[str, int]:
    """Write the wheelchairs of an epoch as an MCAP file; returns how many messages each topic has.

    A journal holds all, as its world is made again; a trace knows the chairs, a drive its one and the sticks.

    Raises:
        ConfigError: The extra for MCAP is not installed, or there is no wheelchair.
        ReplayMismatchError: A tick gave another state than the journal says.
        WcsimError: There is no such epoch; or as `replayed` does.
    """
    header = read_header(log)
    require_hook(header, hook)
    if header.kind == "journal":
        return _journal_bag(log, out, epoch, hook)
    if header.kind == "drive":
        if epoch:
            raise ConfigError(f"{escaped(log)}: has no epoch {epoch}; a drive has epoch 0 alone: leave --epoch out")
        return drive_bag(read_drive(log), out)
    chosen = [record for record in read_states(log)[1] if record.epoch == epoch and len(record.plants)]
    if not chosen:
        raise ConfigError(f"{escaped(log)}: has no wheelchair in world {epoch}; expected a run with some")
    return trace_bag(header.tick_s, chosen, out)


def _journal_bag(journal: Path, out: Path, epoch: int, hook: str) -> dict[str, int]:
    chairs: dict[int, RosChair] = {}
    drawn: dict[int, Drawn | None] = {}  # by which the cameras of each seat were mounted last
    answered: dict[int, ClientSnapshot] = {}  # what the commands of the next tick answer
    alone = read_header(journal, "journal").seats == 1

    def before(world: World | None, record: Input) -> None:
        if world is not None and isinstance(record, Ticked):
            answered.update((client.seat, client.first or client) for client in world.snapshot.clients)

    with closing(replayed(journal, epoch, None, hook, before)) as steps, RosBag(out) as bag:
        for world, record in steps:
            require_equal(world, record)
            if not isinstance(record, Ticked):
                continue
            now, config = world.snapshot, world.config
            begun_s = now.time_s - config.world.tick_s
            for command in record.commands:
                seat, frame = command.seat, answered[command.seat]
                if seat not in chairs:
                    chairs[seat] = RosChair(bag, None if alone else seat, begun_s)
                if seat not in drawn or drawn[seat] != frame.drawn:
                    drawn[seat] = frame.drawn
                    cameras = config.cameras if frame.drawn is None else moved(config.cameras, frame.drawn)
                    chairs[seat].mounted(begun_s, config.imu, cameras)
                chairs[seat].stick("joy", begun_s, frame.user)
                chairs[seat].stick("joy_command", begun_s, command.joystick)
            for client in now.clients:
                chairs[client.seat].saw(now.time_s, client, config)
        counts = bag.counts
    if not counts:
        raise WcsimError(f"{journal}: has no tick of epoch {epoch}; choose another --epoch")
    return counts


def _ticks(steps: Iterable[tuple[World, Input]]) -> Iterator[WorldState]:
    for world, record in steps:
        require_equal(world, record)
        if isinstance(record, Ticked):
            yield state_of(world.snapshot, record.commands, as_recorded(world.snapshot, world.everyone()))


def _trace_header(header: Header, world: World) -> Header:
    return Header(
        town=world.town.name,
        seed=header.seed,
        tick_s=header.tick_s,
        seats=header.seats,
        fingerprint=header.fingerprint,
        origin_m=world.town.file.origin_m,
        origin_z_m=world.street.net_origin_m[2],
        chair_box_m=chair_box_m(world.config.chair),
    )

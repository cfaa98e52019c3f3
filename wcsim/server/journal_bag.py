"""A journal as an MCAP file: its world is made again, and its wheelchairs say what they did, were told and sensed."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from wcsim.bridge.ego.randomization import moved
from wcsim.bridge.recording.ros_bag import RosBag
from wcsim.bridge.recording.ros_chairs import RosChair
from wcsim.bridge.world import World
from wcsim.errors import WcsimError
from wcsim.log.reader import read_header
from wcsim.log.records import Input, Ticked
from wcsim.server.replay import replayed, require_equal
from wcsim.types import ClientSnapshot, Drawn


def recompute_bag(journal: Path, out: Path, epoch: int = 0, hook: str = "") -> dict[str, int]:
    """Make an epoch again and write its wheelchairs as an MCAP file; returns how many messages each topic has.

    Raises:
        ConfigError: The extra for MCAP is not installed.
        ReplayMismatchError: A tick gave another state than the journal says.
        WcsimError: As `recompute` does.
    """
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

"""Logs as files of others: SUMO's floating car data, and ROS 2 messages in MCAP.

A journal's world is made again. Floating car data has net coordinates, front bumpers, headings in
degrees clockwise from north, as in SUMO's own `--fcd-output`. People are where the bridge showed
them to the wheelchair, stepped aside where they did.
"""

import math
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from wcsim.bridge.ego.randomization import moved
from wcsim.bridge.recording.ros_bag import RosBag
from wcsim.bridge.recording.ros_chairs import RosChair, drive_bag, trace_bag
from wcsim.bridge.replay.replayed import replayed, require_hook
from wcsim.bridge.town_run import as_recorded, chair_box_m
from wcsim.bridge.world import World
from wcsim.core import frames
from wcsim.core.reading import escape
from wcsim.errors import ConfigError, ReplayMismatchError, WcsimError
from wcsim.log.drive import read_drive
from wcsim.log.reader import read_header, read_trace_states
from wcsim.log.records import (
    Header,
    Input,
    Ticked,
    WorldState,
    with_fields,
    world_state_from_snapshot,
)
from wcsim.types import F64, ActorKind, ClientSnapshot, Drawn

_CHAIR_TYPE = ActorKind.WHEELCHAIR.value
_SCHEMA = "http://sumo.dlr.de/xsd/fcd_file.xsd"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
_HEAD = f"""<?xml version="1.0" encoding="UTF-8"?>

<fcd-export xmlns:xsi="{_INSTANCE}" xsi:noNamespaceSchemaLocation="{_SCHEMA}">
"""


def convert_to_fcd(log: Path, out: Path, epoch: int = 0, hook: str = "") -> int:
    """Write an epoch of a trace or a journal as FCD; returns the number of its time steps.

    Raises:
        ReplayMismatchError: A tick gave another state than the journal has.
        WcsimError: It is a drive, or has no such epoch; or as `replayed` does.
    """
    header = read_header(log)
    require_hook(header, hook)
    if header.kind == "drive":
        raise ConfigError(
            f"{escape(log)}: is a drive, which holds no traffic; expected a trace or a journal"
        )
    if header.kind == "trace":
        return _write_fcd(log, out, epoch)
    with closing(replayed(log, epoch, None, hook)) as steps:
        world, _ = next(steps)
        header = with_fields(
            header,
            origin_m=world.town.file.origin_m,
            origin_z_m=world.street.net_origin_m[2],
            chair_box_m=chair_box_m(world.config.chair),
        )
        written = _write_steps(header, _ticks(steps), out)
    if not written:
        raise WcsimError(f"{log}: has no tick of epoch {epoch}; choose another --epoch")
    return written


def convert_to_mcap(log: Path, out: Path, epoch: int = 0, hook: str = "") -> dict[str, int]:
    """Write the wheelchairs of an epoch as an MCAP file; returns how many messages each topic has.

    A journal holds all, as its world is made again; a trace knows the chairs, a drive its one and
    the sticks.

    Raises:
        ConfigError: The extra for MCAP is not installed, or there is no wheelchair.
        ReplayMismatchError: A tick gave another state than the journal has.
        WcsimError: There is no such epoch; or as `replayed` does.
    """
    header = read_header(log)
    require_hook(header, hook)
    if header.kind == "journal":
        return _journal_bag(log, out, epoch, hook)
    if header.kind == "drive":
        if epoch:
            raise ConfigError(
                f"{escape(log)}: has no epoch {epoch}; a drive has epoch 0 alone: leave --epoch out"
            )
        return drive_bag(read_drive(log), out)
    _, records = read_trace_states(log)
    chosen = [record for record in records if record.epoch == epoch and len(record.plants)]
    if not chosen:
        raise ConfigError(
            f"{escape(log)}: has no wheelchair in world {epoch}; expected a run with some"
        )
    return trace_bag(header.tick_s, chosen, out)


def _write_fcd(trace: Path, out: Path, epoch: int = 0) -> int:
    """Write one epoch of a trace as an FCD file; returns the number of its time steps.

    Raises:
        WcsimError: it is no trace, has no such epoch, or was recorded before traces knew sizes.
    """
    header, records = read_trace_states(trace)
    chosen = [record for record in records if record.epoch == epoch]
    if not records:
        raise WcsimError(
            f"{trace}: has no complete tick: it was truncated, or its run ended before the first "
            "one; expected a complete trace: copy it again, or record it again"
        )
    if not chosen:
        epochs = ", ".join(str(number) for number in sorted({record.epoch for record in records}))
        raise WcsimError(
            f"{trace}: has no tick of epoch {epoch}; expected --epoch with one of: {epochs}"
        )
    sized = header.chair_box_m is not None or not any(len(record.plants) for record in chosen)
    if not sized or any(record.actor_ids and not record.bodies for record in chosen):
        raise WcsimError(
            f"{trace}: is of an older version without the sizes of actors and chairs; "
            "record it again"
        )
    return _write_steps(header, chosen, out)


def _write_steps(header: Header, records: Iterable[WorldState], out: Path) -> int:
    """Write ticks of one epoch as an FCD file; returns their number."""
    steps = 0
    with out.open("w", encoding="utf-8") as file:
        file.write(_HEAD)
        for record in records:
            # SUMO calls a step by the time at which it starts.
            start_s = record.time_s - header.tick_s
            file.write(f'    <timestep time="{max(0.0, start_s):.2f}">\n')
            lines = list(_actor_lines(header, record))
            lines += [("vehicle", text) for text in _chair_lines(header, record)]
            # SUMO's schema has all vehicles, the chairs among them, before all persons.
            for domain in ("vehicle", "person"):
                for tag, text in lines:
                    if tag == domain:
                        file.write(f"        <{tag} {text}/>\n")
            file.write("    </timestep>\n")
            steps += 1
        file.write("</fcd-export>\n")
    return steps


def _actor_lines(header: Header, record: WorldState) -> Iterator[tuple[str, str]]:
    for body, row in zip(record.bodies, record.actors, strict=True):
        # What is articulated is one vehicle to SUMO, whose front is that of its first piece.
        if body.piece:
            continue
        domain, _, name = body.id.partition(":")
        pose = row[:3], float(row[3]), float(row[4])
        speed_mps = float(np.linalg.norm(row[5:8]))
        text = _line(name, body.kind.value, *pose, body.size_lwh_m[0], speed_mps, header)
        yield "person" if domain == "p" else "vehicle", text


def _chair_lines(header: Header, record: WorldState) -> Iterator[str]:
    length_m, middle_m = header.chair_box_m or (0.0, 0.0)
    for seat, row in zip(record.seats or range(len(record.plants)), record.plants, strict=True):
        x, y, z, w = row[3:7]
        yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        middle_W_m = row[:3] + middle_m * frames.forward_vector(yaw_rad, 0.0)
        speed_mps = float(np.hypot(row[7], row[8]))
        name = f"{_CHAIR_TYPE}.{seat}"
        yield _line(name, _CHAIR_TYPE, middle_W_m, yaw_rad, 0.0, length_m, speed_mps, header)


def _line(
    name: str,
    kind: str,
    p_W_m: F64,
    yaw_rad: float,
    pitch_rad: float,
    length_m: float,
    speed: float,
    head: Header,
) -> str:
    front_W_m = frames.front_from_centre(p_W_m, yaw_rad, pitch_rad, length_m)
    x_m, y_m, z_m = frames.net_from_world(front_W_m, head.origin_m)
    return (
        f'id={quoteattr(name)} x="{x_m:.2f}" y="{y_m:.2f}" z="{z_m + head.origin_z_m:.2f}" '
        f'angle="{frames.sumo_from_yaw(yaw_rad):.2f}" type="{kind}" speed="{speed:.2f}" '
        f'slope="{frames.rad2deg(pitch_rad):.2f}"'
    )


def _journal_bag(journal: Path, out: Path, epoch: int, hook: str) -> dict[str, int]:
    chairs: dict[int, RosChair] = {}
    drawn: dict[int, Drawn | None] = {}  # by which the cameras of each seat were mounted last
    answered: dict[int, ClientSnapshot] = {}  # what the commands of the next tick answer
    alone = read_header(journal, "journal").seats == 1

    def before(world: World | None, record: Input) -> None:
        if world is not None and isinstance(record, Ticked):
            for client in world.snapshot.clients:
                answered[client.seat] = client.first or client

    with closing(replayed(journal, epoch, None, hook, before)) as steps, RosBag(out) as bag:
        for world, record in steps:
            _require_equal(world, record)
            if not isinstance(record, Ticked):
                continue
            now, config = world.snapshot, world.config
            start_s = now.time_s - config.world.tick_s
            for command in record.commands:
                seat, frame = command.seat, answered[command.seat]
                if seat not in chairs:
                    chairs[seat] = RosChair(bag, None if alone else seat, start_s)
                if seat not in drawn or drawn[seat] != frame.drawn:
                    drawn[seat] = frame.drawn
                    cameras = config.cameras
                    if frame.drawn is not None:
                        cameras = moved(cameras, frame.drawn)
                    chairs[seat].mounted(start_s, config.imu, cameras)
                chairs[seat].stick("joy", start_s, frame.user)
                chairs[seat].stick("joy_command", start_s, command.joystick)
            for client in now.clients:
                chairs[client.seat].saw(now.time_s, client, config)
        counts = bag.counts
    if not counts:
        raise WcsimError(f"{journal}: has no tick of epoch {epoch}; choose another --epoch")
    return counts


def _ticks(steps: Iterable[tuple[World, Input]]) -> Iterator[WorldState]:
    for world, record in steps:
        _require_equal(world, record)
        if isinstance(record, Ticked):
            actors = as_recorded(world.snapshot, world.sumo.everyone())
            yield world_state_from_snapshot(world.snapshot, record.commands, actors)


def _require_equal(world: World, record: Input) -> None:
    """Raise ReplayMismatchError when a tick gave another state than the log has."""
    if isinstance(record, Ticked) and record.state_hash != world.snapshot.state_hash:
        raise ReplayMismatchError(
            f"epoch {record.epoch}, tick {record.tick}: got state {world.snapshot.state_hash}, "
            f"expected {record.state_hash} as in the journal; "
            "use the versions and the kind of machine that it was made with"
        )

"""One hash and one record format for golden scenes, journals and replay.

A trace is a file of records, each `length, CRC-32, payload`; the first payload is the header (JSON), every other one
is a tick: a JSON line with names and hash, then the numbers as little-endian float64. A torn last record is left out
on reading.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from wcsim.errors import WcsimError
from wcsim.types import F64, ActorState, Command, PlantState, Snapshot

_FRAME = struct.Struct("<II")
MAGIC = "wcsim-trace-1"


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceHeader:
    """What a trace is of; `fingerprint` names the versions that its exact hashes hold for."""

    name: str
    seed: int
    tick_s: float
    seats: int
    fingerprint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TickRecord:
    """One tick: who was commanded what, and where everything was afterwards."""

    epoch: int
    tick: int
    commands: F64  # (seats, 2) x, y
    plants: F64  # (seats, 15) see `plant_row`
    actor_ids: tuple[str, ...]
    actors: F64  # (n, 8) position, yaw, pitch, velocity
    state_hash: str


def plant_row(plant: PlantState) -> F64:
    """A plant as 15 numbers: position, quaternion, velocity, angular velocity, wheel speeds."""
    return np.concatenate([plant.p_WB_m, plant.q_WB, plant.v_B_mps, plant.w_B_radps, plant.wheel_radps])


def actor_rows(actors: Sequence[ActorState]) -> F64:
    """Actors as (n, 8) numbers: position, yaw, pitch, velocity."""
    if not actors:
        return np.zeros((0, 8))
    return np.array([(*a.p_W_m, a.yaw_rad, a.pitch_rad, *a.v_W_mps) for a in actors])


def state_hash(snapshot: Snapshot) -> str:
    """64 bits over the raw numbers of everything that moves, as hexadecimal."""
    digest = hashlib.blake2b(digest_size=8)
    digest.update(struct.pack("<qq", snapshot.epoch, snapshot.tick))
    for client in snapshot.clients:
        digest.update(plant_row(client.plant).tobytes())
        digest.update(struct.pack("<dd", client.user.x, client.user.y))
        digest.update(client.sensors.imu.accel_mean_mps2.tobytes())
    for actor in snapshot.actors:
        digest.update(actor.id.encode())
    digest.update(actor_rows(snapshot.actors).tobytes())
    return digest.hexdigest()


def record_of(snapshot: Snapshot, commands: Sequence[Command]) -> TickRecord:
    """The record of a tick from its commands and the snapshot they led to."""
    return TickRecord(
        epoch=snapshot.epoch,
        tick=snapshot.tick,
        commands=np.array([(c.joystick.x, c.joystick.y) for c in commands]).reshape(-1, 2),
        plants=np.array([plant_row(c.plant) for c in snapshot.clients]).reshape(-1, 15),
        actor_ids=tuple(a.id for a in snapshot.actors),
        actors=actor_rows(snapshot.actors),
        state_hash=snapshot.state_hash,
    )


class TraceWriter:
    """Appends records to a trace file; a context manager."""

    def __init__(self, path: Path, header: TraceHeader) -> None:
        self._file = path.open("wb")
        self._put(json.dumps({"magic": MAGIC, **asdict(header)}).encode())

    def append(self, record: TickRecord) -> None:
        """Write one tick."""
        head = json.dumps(
            {
                "epoch": record.epoch,
                "tick": record.tick,
                "seats": len(record.plants),
                "actors": record.actor_ids,
                "hash": record.state_hash,
            }
        )
        numbers = np.concatenate([record.commands.ravel(), record.plants.ravel(), record.actors.ravel()])
        self._put(head.encode() + b"\n" + numbers.astype("<f8").tobytes())

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def __enter__(self) -> TraceWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _put(self, payload: bytes) -> None:
        packed = zlib.compress(payload, 6)
        self._file.write(_FRAME.pack(len(packed), zlib.crc32(packed)) + packed)


def read_trace(path: Path) -> tuple[TraceHeader, tuple[TickRecord, ...]]:
    """Read a trace. Raises WcsimError when the file is not one; a torn last record is left out."""
    payloads = _payloads(path.read_bytes())
    try:
        head = json.loads(payloads[0])
        if head.pop("magic") != MAGIC:
            raise KeyError(MAGIC)
        return TraceHeader(**head), tuple(_tick(payload) for payload in payloads[1:])
    except (IndexError, KeyError, TypeError, ValueError):
        raise WcsimError(f"{path}: is not a trace of this version; expected a file written by wcsim") from None


def _payloads(data: bytes) -> list[bytes]:
    found, at = [], 0
    while at + _FRAME.size <= len(data):
        size, crc = _FRAME.unpack_from(data, at)
        packed = data[at + _FRAME.size : at + _FRAME.size + size]
        if len(packed) < size or zlib.crc32(packed) != crc:
            break
        found.append(zlib.decompress(packed))
        at += _FRAME.size + size
    return found


def _tick(payload: bytes) -> TickRecord:
    line, _, raw = payload.partition(b"\n")
    head = json.loads(line)
    seats = int(head["seats"])
    numbers = np.frombuffer(raw, "<f8")
    actors_at = seats * 17
    return TickRecord(
        epoch=head["epoch"],
        tick=head["tick"],
        commands=numbers[: seats * 2].reshape(-1, 2),
        plants=numbers[seats * 2 : actors_at].reshape(-1, 15),
        actor_ids=tuple(head["actors"]),
        actors=numbers[actors_at:].reshape(-1, 8),
        state_hash=head["hash"],
    )

"""One hash for golden scenes, journals and replay, and the trace: where everything was, tick by tick.

A trace is a file of records (`users/recording/framing.py`); the first payload is the header (JSON), every other one is
a tick: a JSON line with names, hash and the bodies that are new, then the numbers as little-endian float64. It is read
by `bridge/recording/trace_file.py`.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from wcsim.config import ChairConfig
from wcsim.core.closing import Closing
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.types import F64, ActorKind, ActorState, Command, PlantState, Snapshot
from wcsim.users.recording.framing import framed

MAGIC = "wcsim-trace-1"


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceHeader:
    """What a trace is of; `fingerprint` names the versions that its exact hashes hold for."""

    name: str
    seed: int
    tick_s: float
    seats: int
    fingerprint: str
    origin_m: tuple[float, float] = (0.0, 0.0)  # W's origin in the town's net coordinates
    origin_z_m: float = 0.0
    chair_box_m: tuple[float, float] | None = None  # length of a wheelchair, and its middle ahead of the drive axle


@dataclass(frozen=True, slots=True, kw_only=True)
class ActorBody:
    """What an actor is, as far as a replay has to know."""

    id: str
    kind: ActorKind
    size_lwh_m: tuple[float, float, float]
    piece: int = 0  # as in `ActorState`


@dataclass(frozen=True, slots=True, kw_only=True)
class TickRecord:
    """One tick: who was commanded what, and where everything was afterwards."""

    epoch: int
    tick: int
    commands: F64  # (seats, 2) x, y
    plants: F64  # (seats, 15) see `_plant_row`
    actor_ids: tuple[str, ...]
    actors: F64  # (n, 8) position, yaw, pitch, velocity
    state_hash: str
    time_s: float = 0.0  # SUMO's own time
    bodies: tuple[ActorBody, ...] = ()  # one for each actor, in their order; empty in traces of before there were any
    seats: tuple[int, ...] = ()  # whose the commands and plants are; empty when they are those of 0, 1, 2, ...


def chair_box_m(chair: ChairConfig) -> tuple[float, float]:
    """What a header says of the wheelchairs."""
    outline = plant_spec(chair).outline
    return outline.length_m, outline.middle_x_m


def _plant_row(plant: PlantState) -> F64:
    """A plant as 15 numbers: position, quaternion, velocity, angular velocity, wheel speeds."""
    return np.concatenate([plant.p_WB_m, plant.q_WB, plant.v_B_mps, plant.w_B_radps, plant.wheel_radps])


def _actor_rows(actors: Sequence[ActorState]) -> F64:
    """Actors as (n, 8) numbers: position, yaw, pitch, velocity."""
    if not actors:
        return np.zeros((0, 8))
    return np.array([(*a.p_W_m, a.yaw_rad, a.pitch_rad, *a.v_W_mps) for a in actors])


def state_hash(snapshot: Snapshot) -> str:
    """64 bits over the raw numbers of everything that moves, as hexadecimal."""
    digest = hashlib.blake2b(digest_size=8)
    digest.update(struct.pack("<qq", snapshot.epoch, snapshot.tick))
    for client in snapshot.clients:
        digest.update(_plant_row(client.plant).tobytes())
        digest.update(struct.pack("<dd", client.user.x, client.user.y))
        digest.update(client.sensors.imu.accel_mean_mps2.tobytes())
        for reading in client.sensors.readings:
            digest.update(reading.name.encode() + reading.values.tobytes())
    for actor in snapshot.actors:
        digest.update(actor.id.encode())
    digest.update(_actor_rows(snapshot.actors).tobytes())
    return digest.hexdigest()


def record_of(
    snapshot: Snapshot, commands: Sequence[Command], actors: Sequence[ActorState] | None = None
) -> TickRecord:
    """The record of a tick from its commands and the snapshot they led to.

    `actors` are those to record, such as all of the town; the snapshot's own, near the chairs, when they are missing.
    """
    actors = snapshot.actors if actors is None else actors
    seats = tuple(client.seat for client in snapshot.clients)
    return TickRecord(
        epoch=snapshot.epoch,
        tick=snapshot.tick,
        commands=np.array([(c.joystick.x, c.joystick.y) for c in commands]).reshape(-1, 2),
        plants=np.array([_plant_row(c.plant) for c in snapshot.clients]).reshape(-1, 15),
        actor_ids=tuple(a.id for a in actors),
        actors=_actor_rows(actors),
        state_hash=snapshot.state_hash,
        time_s=snapshot.time_s,
        bodies=tuple(ActorBody(id=a.id, kind=a.kind, size_lwh_m=a.size_lwh_m, piece=a.piece) for a in actors),
        seats=() if seats == tuple(range(len(seats))) else seats,
    )


class TraceWriter(Closing):
    """Appends records to a trace file; a context manager."""

    def __init__(self, path: Path, header: TraceHeader) -> None:
        self._file = path.open("wb")
        self._told: dict[str, ActorBody] = {}  # a body is written when it is new or another one than before
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
                "time_s": record.time_s,
                "bodies": [_as_list(body) for body in record.bodies if self._told.get(body.id) != body],
                **({"at": record.seats} if record.seats else {}),
            }
        )
        self._told.update((body.id, body) for body in record.bodies)
        numbers = np.concatenate([record.commands.ravel(), record.plants.ravel(), record.actors.ravel()])
        self._put(head.encode() + b"\n" + numbers.astype("<f8").tobytes())

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._file.close()

    def _put(self, payload: bytes) -> None:
        self._file.write(framed(payload))


def _as_list(body: ActorBody) -> tuple[str, str, tuple[float, float, float], int]:
    return body.id, body.kind.value, body.size_lwh_m, body.piece

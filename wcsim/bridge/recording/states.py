"""One hash for golden scenes, journals and replay; and the record of a state: where everything was after a tick."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence

import numpy as np

from wcsim.config import ChairConfig
from wcsim.log.records import ActorBody, WorldState
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.types import F64, ActorState, Command, PlantState, Snapshot


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


def state_of(snapshot: Snapshot, commands: Sequence[Command], actors: Sequence[ActorState] | None = None) -> WorldState:
    """The record of a tick, by its commands and the snapshot they led to.

    `actors` are those to record, such as all of the town; the snapshot's own, near the chairs, when they are missing.
    """
    actors = snapshot.actors if actors is None else actors
    seats = tuple(client.seat for client in snapshot.clients)
    return WorldState(
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

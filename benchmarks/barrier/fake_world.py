"""A world without simulators: for benches, soaks and tests of what lies around a world.

Chairs go where their joysticks point, a tick costs next to nothing, and the state is a hash over everything that was
done, so that a journal of it can be verified like any other. `python -m benchmarks.barrier.fake_world ORDER_FILE` is a
world process with it.
"""

from __future__ import annotations

import hashlib
import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wcsim.bridge.replay.player import Specs
from wcsim.core.constants import GRAVITY_MPS2
from wcsim.errors import ProtocolError
from wcsim.physics.buffers import ImageSink, SeatBuffers, new_images
from wcsim.server.specs import WorldBuildSpec
from wcsim.types import (
    CameraFrame,
    ClientSnapshot,
    Command,
    Events,
    ImuFrame,
    Joystick,
    PlantState,
    Reading,
    SeatSpec,
    SensorFrame,
    Snapshot,
    StartSpec,
)

_COMMAND = struct.Struct("<iqdd")
_LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
_NOTHING = np.zeros(3)
_IMU = ImuFrame(
    accel_mean_mps2=np.array([0.0, 0.0, GRAVITY_MPS2]),
    accel_peak_mps2=_NOTHING,
    gyro_radps=_NOTHING,
    roll_rad=0.0,
    pitch_rad=0.0,
    yaw_rad=0.0,
)


@dataclass(slots=True)
class _Chair:
    spec: SeatSpec
    episode: int
    step: int = 0
    x_m: float = 0.0
    y_m: float = 0.0


class FakeWorld:
    """See the module's text; used like `bridge.world.World` (`SeatWorld`)."""

    def __init__(self, order: WorldBuildSpec, specs: Specs, seed: int, epoch: int = 0) -> None:
        """A world with a chair for each of `specs` that is not None."""
        self._config, self.epoch = order.config, epoch - 1
        self._chairs = {seat: _Chair(spec, -1) for seat, spec in enumerate(specs) if spec is not None}
        measures = order.config.sensors.measures()
        self._readings = tuple(Reading(name=name, values=np.zeros(len(m.parts))) for name, m in measures.items())
        self._episodes = [0] * len(specs)
        self._own = [(self._new_buffers(), self._new_buffers()) for _ in specs]
        self.snapshot = self._begun(seed, None)

    def tick(self, commands: Sequence[Command], out: ImageSink | None = None) -> Snapshot:
        """See `World.tick`."""
        now = self.snapshot
        got, expected = [(c.seat, c.tick) for c in commands], [(seat, now.tick) for seat in sorted(self._chairs)]
        if got != expected:
            raise ProtocolError(f"commands (seat, tick) {got}; expected {expected}")
        for command in commands:
            chair, stick = self._chairs[command.seat], command.joystick
            chair.step += 1
            chair.x_m, chair.y_m = chair.x_m + stick.x, chair.y_m + stick.y
        self._hash(b"".join([_COMMAND.pack(c.seat, c.tick, c.joystick.x, c.joystick.y) for c in commands]))
        tick = now.tick + 1
        clients = tuple(self._after_step(seat, tick, out) for seat in sorted(self._chairs))
        return self._publish(tick, clients)

    def admit(self, seat: int, spec: SeatSpec, out: ImageSink | None = None) -> ClientSnapshot:
        """See `World.admit`."""
        if seat in self._chairs or not 0 <= seat < len(self._episodes):
            raise ProtocolError(f"seat {seat} is taken or not there; expected a free one")
        self._chairs[seat] = _Chair(spec, 0)
        return self._anew(seat, b"admit", out)

    def dismiss(self, seat: int) -> None:
        """See `World.dismiss`."""
        if self._chairs.pop(seat, None) is None:
            raise ProtocolError(f"seat {seat} is free; expected one that is taken")
        self._hash(b"dismiss%d" % seat)
        self._publish(self.snapshot.tick, tuple(c for c in self.snapshot.clients if c.seat != seat))

    def respawn(self, seat: int, out: ImageSink | None = None, start: StartSpec | None = None) -> ClientSnapshot:
        """See `World.respawn`."""
        return self._anew(seat, b"respawn", out)

    def rebuild(self, seed: int, out: ImageSink | None = None) -> Snapshot:
        """See `World.rebuild`."""
        return self._begun(seed, out)

    def close(self) -> None:
        """Nothing is held."""

    @property
    def taken(self) -> dict[int, SeatSpec]:
        """The seats that are taken."""
        return {seat: self._chairs[seat].spec for seat in sorted(self._chairs)}

    # --- inside ---

    def _begun(self, seed: int, out: ImageSink | None) -> Snapshot:
        self.epoch += 1
        self._digest = hashlib.blake2b(b"%d" % seed, digest_size=8).digest()
        self._episodes = [0] * len(self._episodes)
        clients = tuple(self._first(seat, 0, out) for seat in sorted(self._chairs))
        return self._publish(0, clients)

    def _after_step(self, seat: int, tick: int, out: ImageSink | None) -> ClientSnapshot:
        chair = self._chairs[seat]
        over = chair.step >= chair.spec.max_steps
        client = self._seen(seat, tick, self._buffers(seat, out, first=False), over)
        return replace(client, first=self._first(seat, tick, out)) if over else client

    def _anew(self, seat: int, what: bytes, out: ImageSink | None) -> ClientSnapshot:
        self._hash(what + b"%d" % seat)
        now = self.snapshot
        client = self._first(seat, now.tick, out)
        others = tuple(c for c in now.clients if c.seat != seat)
        self._publish(now.tick, tuple(sorted((*others, client), key=lambda c: c.seat)))
        return client

    def _first(self, seat: int, tick: int, out: ImageSink | None) -> ClientSnapshot:
        """Begin the seat's next episode."""
        self._chairs[seat] = _Chair(self._chairs[seat].spec, self._episodes[seat])
        self._episodes[seat] += 1
        return self._seen(seat, tick, self._buffers(seat, out, first=True), over=False)

    def _seen(self, seat: int, tick: int, buffers: SeatBuffers, over: bool) -> ClientSnapshot:
        chair = self._chairs[seat]
        cameras = self._shot(seat, tick, buffers)
        return ClientSnapshot(
            seat=seat,
            tick=tick,
            plant=_plant(chair),
            sensors=SensorFrame(tick=tick, cameras=cameras, imu=_IMU, readings=self._readings),
            user=Joystick(0.0, 0.5),
            contacts=(),
            events=Events(
                episode=chair.episode,
                step=chair.step,
                crashed=False,
                crash_reason="",
                truncated=over,
                arrived=False,
                gave_up=False,
            ),
        )

    def _shot(self, seat: int, tick: int, buffers: SeatBuffers) -> tuple[CameraFrame, ...]:
        """The tick and the seat in the first pixel: what a renderer costs is not the point."""
        frames = []
        for camera, images in zip(self._config.cameras, buffers, strict=True):
            images.depth_m[0, 0] = tick
            images.class_id[0, 0] = seat
            frames.append(
                CameraFrame(
                    name=camera.name, taken_tick=tick, depth_m=images.depth_m, class_id=images.class_id, rgb=images.rgb
                )
            )
        return tuple(frames)

    def _buffers(self, seat: int, out: ImageSink | None, first: bool) -> SeatBuffers:
        return self._own[seat][first] if out is None else out.buffers(seat, first)

    def _new_buffers(self) -> SeatBuffers:
        cameras = self._config.cameras
        return tuple(new_images(c.width_px, c.height_px, c.rgb) for c in cameras)

    def _hash(self, what: bytes) -> None:
        self._digest = hashlib.blake2b(self._digest + what, digest_size=8).digest()

    def _publish(self, tick: int, clients: tuple[ClientSnapshot, ...]) -> Snapshot:
        self.snapshot = Snapshot(
            epoch=self.epoch,
            tick=tick,
            time_s=tick * self._config.world.tick_s,
            actors=(),
            signals=(),
            clients=clients,
            state_hash=self._digest.hex(),
        )
        return self.snapshot


def _plant(chair: _Chair) -> PlantState:
    return PlantState(
        p_WB_m=np.array([chair.x_m, chair.y_m, 0.0]),
        q_WB=_LEVEL,
        v_B_mps=_NOTHING,
        w_B_radps=_NOTHING,
        wheel_radps=_NOTHING[:2],
        roll_rad=0.0,
        pitch_rad=0.0,
        yaw_rad=0.0,
    )


if __name__ == "__main__":
    from wcsim.server.host.process import main

    raise SystemExit(main(sys.argv[1:], FakeWorld))

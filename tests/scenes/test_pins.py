"""What no change of the code's order may move: drives through whole towns, state by state and picture by picture.

Golden traces of scenes pin short streets; these pin what only a town has: its traffic, signals, users and their draws.
Whoever changes a world on purpose runs `python -m tests.scenes.test_pins` and takes over what it prints.
"""

import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.worlds import follow, open_world

TOWNS = Path(__file__).parents[2] / "scenarios" / "sumo"
TICKS = 120


@dataclass(frozen=True, kw_only=True)
class Pin:
    """A drive, and what comes of it."""

    town: str
    seed: int
    seats: int
    states: str  # BLAKE2 of all state hashes
    pictures: str  # of the classes in all pictures
    override: str = "world.warmup_s=30"  # a second setting


PINS = (
    Pin(
        town="helsinki",
        seed=3,
        seats=2,
        states="bd6dbf3618963ebb83fe31387b935f16",
        pictures="7bce1b135f0d7713e848e57b742c6b22",
    ),
    Pin(
        town="manhattan",
        seed=11,
        seats=1,
        states="0fa45224f24ba49e10b3d630cc1e4e79",
        pictures="4f314aa2de5c9a15b49f4f19e222f09f",
    ),
    Pin(
        town="helsinki",
        seed=3,
        seats=2,
        states="bd6dbf3618963ebb83fe31387b935f16",  # those of the first drive: users look for themselves
        pictures="2ef4e33606285003f07675a8e461f6f4",
        override="cameras.0.noise.objects=usual",
    ),
    Pin(
        town="karhula",
        seed=5,
        seats=1,
        states="116eafc197cec7b72f336aec2bcc6c32",
        pictures="28f9e98394feff94ff68c60b6944225e",
        override="world.warmup_s=60",  # from a saved state
    ),
)


def driven(pin: Pin) -> tuple[str, str]:
    """Digests of states and pictures."""
    states, pictures = hashlib.blake2b(digest_size=16), hashlib.blake2b(digest_size=16)
    world = open_world(TOWNS / pin.town, "world.warmup_s=30", pin.override, seats=pin.seats, seed=pin.seed)
    try:
        for _ in range(TICKS):
            now = follow(world)
            states.update(now.state_hash.encode())
            for chair in now.clients:
                for frame in chair.sensors.cameras:
                    pictures.update(frame.class_id.tobytes())
    finally:
        world.close()
    return states.hexdigest(), pictures.hexdigest()


@pytest.mark.parametrize("pin", PINS, ids=lambda pin: f"{pin.town} {pin.override}")
def test_a_drive_through_a_town_is_the_same_as_ever(pin):
    assert driven(pin) == (pin.states, pin.pictures)


if __name__ == "__main__":
    for drive in PINS:
        sys.stdout.write(f"{drive.town}, seed {drive.seed}, {drive.override}: {driven(drive)}\n")

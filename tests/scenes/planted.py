"""One planted fault for every scene: with it the scene no longer shows what it must, and has to say so."""

import re
from dataclasses import dataclass
from pathlib import Path

NOBODY_STEERS = ("scene.toml", r"^goal_m = .*\nprofile = .*", "joystick = [0.0, 0.7]")
NOBODY_LOOKS = ("scene.toml", r"^seed = ", "attention_share = 0.0\nseed = ")


@dataclass(frozen=True)
class Planted:
    """A change to one file of a scene (a pattern and what takes its place) and what must be told."""

    scene: str
    file: str
    pattern: str
    instead: str
    told: str
    quick: bool = False


PLANTED = (
    Planted("car-at-zebra", *NOBODY_LOOKS, told="crashed is True", quick=True),
    Planted("cyclist-overtaking", "street.typ.xml", 'width="3.5"', 'width="1.8"', told="overtaken is 0"),
    Planted(
        "kerb-drop", "scene.toml", "kerb_height_m = 0.12", "kerb_height_m = 0.02", told="crashed is False", quick=True
    ),
    Planted("left-hand-crossing", "scene.toml", "lefthand = true", "lefthand = false", told="closest_vehicle_m"),
    Planted("lowered-kerb", "street.con.xml", "<crossing [^>]*/>", "", told="crashed is True"),
    Planted("narrow-gate", *NOBODY_LOOKS, told="made_way_m is 0"),
    Planted("parked-car-and-sign", "street.rou.xml", "<vehicle .*</vehicle>", "", told="closest_vehicle_m"),
    Planted("pedestrian-crossing", *NOBODY_LOOKS, told="made_way_m is 0"),
    Planted("roadworks", "street.add.xml", "<poly [^>]*/>", "", told="narrowest_m"),
    Planted("rush-hour", *NOBODY_STEERS, told="red_starts is "),
    Planted("slope", "street.nod.xml", 'z="16"', 'z="10"', told="climb_m"),
    Planted("turning-bus", *NOBODY_LOOKS, told="crashed is True", quick=True),
    Planted("two-chairs", *NOBODY_STEERS, told="crashed is True"),
)


def plant(folder: Path, fault: Planted) -> None:
    """Change a copy of the scene; the pattern must be there."""
    path = folder / fault.file
    text, count = re.subn(fault.pattern, fault.instead, path.read_text(), flags=re.MULTILINE)
    assert count, f"{fault.file} has no {fault.pattern!r}"
    path.write_text(text)

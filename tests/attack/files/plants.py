"""Plants whose parameters are at their bounds, one after the other and many at once, driven for some seconds."""

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.attack.outcomes import Case
from tests.attack.scenarios.twists import draws, pick, toml_text, without_none
from tests.physics.rig import rig, step_street
from wcsim.config import ChairConfig
from wcsim.config.plant import PlantFile, list_plants, override_plant_values, read_plant
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.physics.wheelchair.plant_body import urdf
from wcsim.types import Joystick

_TICKS, _KERB_M = 8, 0.05
_MOST_M, _MOST_MPS = 30.0, 30.0  # away from where it was put, and how fast it may be
_INERTIA = re.compile(r'ixx="([^"]*)" iyy="([^"]*)" izz="([^"]*)"')
_SCHEMA = PlantFile.model_json_schema()


def cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """Each bound of each plant alone, in turn, and then draws of many."""
    bounds = [(plant, key, value) for plant in list_plants() for key, both in _bounds(plant) for value in both]
    _drives("rwd", {}, work)  # machine code is made once
    for number, rng in draws(count, seed):
        plant, key, value = bounds[(number // 2 * 7919) % len(bounds)]
        values = {key: value}
        if number % 2:
            share = pick(rng, (0.03, 0.1, 0.3, 1.0))
            values = {key: pick(rng, both) for key, both in _bounds(plant) if rng.random() < share}
        told = f"{number} of {seed}: {plant} {values if len(values) < 6 else len(values)}"
        yield Case(area="plants that drive", name=told, feed=partial(_drives, plant, values, work))


def _drives(plant: str, values: dict[str, float], work: Path) -> bool:
    """Whether it stays where chairs are, in finite numbers, ahead over a kerb, back, and turning."""
    path = work / "p.toml"
    try:
        path.write_text(
            toml_text(without_none(override_plant_values(read_plant(plant), values).model_dump(mode="json")))
        )
        if not all(map(_is_of_a_body, _INERTIA.findall(urdf(plant_spec(ChairConfig(plant=str(path))))))):
            return False
        with rig(step_street(_KERB_M, at_x_m=1.5), plant=str(path)) as driven:
            for stick in ((0.0, 1.0), (1.0, 1.0), (0.0, -1.0), (-1.0, 0.0)):
                ride = driven.drive(Joystick(*stick), _TICKS)
                states = np.array([*ride.p_m, ride.end.v_B_mps, ride.end.w_B_radps])
                far = np.abs(states[:-2]).max() > _MOST_M or np.abs(states[-2]).max() > _MOST_MPS
                if not np.isfinite(states).all() or not np.isfinite(ride.peak).all() or far:
                    return False
    finally:
        path.unlink(missing_ok=True)
    return True


def _is_of_a_body(told: tuple[str, str, str]) -> bool:
    """Whether no principal moment of inertia is larger than the other two together."""
    least, middle, most = sorted(map(float, told))
    return least > 0.0 and most <= 1.000001 * (least + middle)


def _bounds(plant: str) -> list[tuple[str, tuple[float, float]]]:
    """The names of a plant's numbers with their lowest and highest values."""
    return list(_bounds_in(read_plant(plant).model_dump(mode="json"), _SCHEMA, ""))


def _bounds_in(value: Any, told: dict[str, Any], name: str) -> Iterator[tuple[str, tuple[float, float]]]:
    told = next((each for each in told.get("anyOf", ()) if "$ref" in each), told)
    told = _SCHEMA["$defs"][told["$ref"].rpartition("/")[2]] if "$ref" in told else told
    if isinstance(value, dict):
        for key, inside in value.items():
            yield from _bounds_in(inside, told["properties"][key], f"{name}.{key}".lstrip("."))
    elif isinstance(value, list):
        for place, inside in enumerate(value):
            each = told["prefixItems"][place] if "prefixItems" in told else told["items"]
            yield from _bounds_in(inside, each, f"{name}.{place}")
    elif isinstance(value, float):
        low = told.get("minimum", np.nextafter(told.get("exclusiveMinimum", 0.0), 1e9))
        yield name, (float(low), float(told["maximum"]))

"""Rows of the scales: mass, balance, inertia, losses and grip against what the parameter file declares."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from wcsim.chair_check import scales
from wcsim.chair_check.declared import inertia_kgm2, stand
from wcsim.chair_check.row import Setup, Trial
from wcsim.chair_check.static_balance import loads_N
from wcsim.physics.engine import GRAVITY_MPS2
from wcsim.physics.wheelchair.plant import PlantSpec, plant_spec

_FILE = "parameter file"
_COAST_MPS = 1.0
_AXES = ("roll", "pitch", "yaw")


def weight_trials(setup: Setup) -> Iterator[Trial]:
    """The rows of one plant."""
    spec = plant_spec(setup.chair)
    yield from _loads(spec)
    yield from _inertias(spec)
    yield from _losses(spec)


def _loads(spec: PlantSpec) -> Iterator[Trial]:
    yield Trial(
        name="mass",
        unit="kg",
        bound="file",
        low=0.995 * spec.whole_kg,
        high=1.005 * spec.whole_kg,
        method="normal loads of all wheels at rest, divided by 9.81 m/s2",
        source=_FILE,
        measure=scales.mass_kg,
    )
    loads = loads_N(stand(spec))
    share = sum(load for name, load in loads.items() if name.startswith("wheel")) / sum(loads.values())
    yield Trial(
        name="drive_wheel_share",
        unit="",
        bound="file",
        low=share - 0.02,
        high=share + 0.02,
        method="share of the weight that rests on the drive wheels",
        source="statics of masses, springs and contact points",
        measure=scales.drive_wheel_share,
    )


def _inertias(spec: PlantSpec) -> Iterator[Trial]:
    for axis, inertia in enumerate(inertia_kgm2(spec)):
        yield Trial(
            name=f"inertia_{_AXES[axis]}",
            unit="kg m2",
            bound="file",
            low=0.98 * float(inertia),
            high=1.02 * float(inertia),
            method="floating with joints held: 20 Nm for 0.5 s, divided by the resulting rate",
            source=_FILE + ": inertia of all parts, parallel axes",
            measure=partial(scales.turning_inertia_kgm2, axis=axis),
        )


def _losses(spec: PlantSpec) -> Iterator[Trial]:
    yield Trial(
        name="turning_loss",
        unit="1/s",
        bound="file",
        low=-0.001,
        high=0.001,
        method="share of its yaw rate that it loses in one second while floating",
        source="no damping is declared",
        measure=scales.turning_loss_per_s,
    )
    yield Trial(
        name="coasting_loss",
        unit="m/s2",
        bound="file",
        low=-0.01,
        high=0.01,
        method="slowing down on level ground from 1 m/s with the motors off, mean of 2 s",
        source="no rolling resistance is declared",
        measure=scales.coasting_mps2,
        speed_mps=_COAST_MPS,
    )
    chair = stand(spec)
    loads = loads_N(chair)
    friction = {foot.name: foot.friction for foot in chair.feet}
    grip = sum(load * friction[name] for name, load in loads.items()) / (spec.whole_kg * GRAVITY_MPS2)
    yield Trial(
        name="grip",
        unit="",
        bound="file",
        low=0.95 * grip,
        high=1.05 * grip,
        method="pull along the ground at which it slides with locked wheels, divided by its weight",
        source=_FILE + ": friction of each wheel, weighted with its load",
        measure=scales.grip,
    )

"""Tiles of the street in an engine: what leaves it comes back as it was, and leaves little behind."""

import gc
import tracemalloc

import numpy as np
import pybullet
import pytest

from tests.physics.rig import flat_street, tiled_street
from tests.support.samples import strip_street
from wcsim.config import ChairConfig, ImuConfig
from wcsim.physics.engine import Engine, StreetBodies
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.types import Joystick, StreetMesh

HERE, FAR = (0, 0), (9, 0)
KERB_WAY = (np.array([60.0, 2.5, 0.0]), 0.5 * np.pi)  # ahead lies the kerb of the north pavement


def strip() -> StreetMesh:
    return strip_street().mesh


def drive(engine: Engine, chair: Wheelchair, ticks: int = 25) -> bytes:
    """Against a kerb and along it; the poses of all ticks."""
    chair.place(*KERB_WAY)
    poses = []
    for tick in range(ticks):
        chair.command(Joystick(0.3 if tick > 12 else 0.0, 0.6))
        for _ in range(24):
            chair.before_step()
            engine.step()
            chair.after_step()
        plant = chair.state()
        poses.append(np.r_[plant.p_WB_m, plant.q_WB])
    return np.array(poses).tobytes()


def test_a_tile_that_comes_back_is_felt_as_one_that_comes():
    driven = []
    for visits in (1, 4):
        with Engine(1 / 240) as engine:
            street = StreetBodies(engine)
            chair = Wheelchair(engine, ChairConfig(), ImuConfig(), seat=0)
            for _ in range(visits - 1):
                street.lay(HERE, strip)
                street.lift(HERE)
                street.lay(FAR, flat_street)
                street.lift(FAR)
            street.lay(HERE, strip)
            driven.append(drive(engine, chair))
    assert driven[0] == driven[1]


def test_a_tile_that_left_is_not_there(engine):
    street, kerb = StreetBodies(engine), np.array([[60.0, 5.0, 0.12]])
    street.lay(HERE, strip)
    assert engine.ground_at(kerb) == pytest.approx(0.12, abs=1e-6)
    street.lift(HERE)
    assert street.keys == set() and engine.rolling_ids == set()
    assert np.isnan(engine.ground_at(kerb)).all()
    assert engine.bullet.getNumBodies() == 0
    street.lay(HERE, strip)
    assert street.keys == {HERE}
    assert engine.ground_at(kerb) == pytest.approx(0.12, abs=1e-6)


def test_a_mesh_is_read_once_and_its_shapes_are_kept(engine, monkeypatch):
    made, create = [], pybullet.createCollisionShape
    monkeypatch.setattr(pybullet, "createCollisionShape", lambda *a, **k: made.append(1) or create(*a, **k))
    read = []
    street = StreetBodies(engine)
    for _ in range(5):
        street.lay(HERE, lambda: read.append(1) or strip())
        street.lift(HERE)
    assert (len(read), len(made)) == (1, 4)


def test_pybullet_is_left_with_no_lists_of_vertices(engine):
    """It never lets go of the lists that it reads a mesh from."""
    floor = tiled_street(0.2)
    vertices, faces = len(floor.vertices_W_m), len(floor.faces)
    engine.add_street(floor)  # makes what is used again
    gc.collect()
    tracemalloc.start()
    try:
        for _ in range(5):
            engine.add_street(floor)
        gc.collect()
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 5 * faces, f"{kept} bytes for 5 meshes of {vertices} vertices and {faces} faces"

"""Six cameras drawn by one thread and by several: both are measured, on the same pictures."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.camera.random_scenes import Scene
from benchmarks.camera.side_by_side import CAMERAS, side_by_side
from tests.support.samples import strip_street
from wcsim.config import CameraConfig
from wcsim.errors import ConfigError
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.sensors.camera import CameraRig

SCENE = Scene(places=((np.array([2.0, 5.5, 0.12]), 0.3), (np.array([9.0, 5.0, 0.12]), 2.0)), poses=(), actors=())
CAMERA = CameraConfig(width_px=40, height_px=30)


def test_both_ways_draw_all_cameras_in_every_turn(monkeypatch):
    calls = []
    shoot_all = CameraRig.shoot_all
    monkeypatch.setattr(CameraRig, "shoot_all", lambda rig, scenes: calls.append(scenes) or shoot_all(rig, scenes))
    row = side_by_side(GeometryStore(strip_street().mesh), CAMERA, SCENE, threads=2, turns=3)
    assert [len(scenes) for scenes in calls] == [CAMERAS] * 6
    assert {scene.tick for scenes in calls for scene in scenes.values()} == {0, 1, 2}  # no picture is repeated
    assert row.threads == 2 and row.gain == row.alone_ms / row.together_ms > 0.0


def test_a_measurement_needs_places_and_turns():
    store = GeometryStore(strip_street().mesh)
    with pytest.raises(ConfigError, match="at least one"):
        side_by_side(store, CAMERA, replace(SCENE, places=()))
    with pytest.raises(ConfigError, match="0 turns"):
        side_by_side(store, CAMERA, SCENE, turns=0)

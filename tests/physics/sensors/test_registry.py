"""What a kind of sensor has to be, and that nothing but the registry has to know it."""

import numpy as np
import pytest

from tests.physics.rig import FORWARD
from wcsim.config import ChairConfig, ImuConfig
from wcsim.errors import ConfigError
from wcsim.physics.sensors import registry
from wcsim.physics.sensors.base import BodyMotion, Mount, Sensor, Surroundings
from wcsim.physics.sensors.imu import Imu
from wcsim.physics.sensors.registry import _SeatCameras
from wcsim.physics.wheelchair.wheelchair import Wheelchair


class Steps(Sensor):
    """Says how many physics steps a tick had, and the key of its noise; looks when `sees`."""

    def __init__(self, sees: bool) -> None:
        self.sees, self.count, self.begun = sees, 0, None

    def start(self, noise_key):
        self.begun = noise_key

    def sample(self, motion: BodyMotion):
        self.count += 1

    def end_tick(self, noise_key):
        said, self.count = np.array([self.count, noise_key or 0, self.begun or 0], float), 0
        return None if self.sees else said

    def look(self, scene: Surroundings):
        return np.array([scene.tick], float) if self.sees else None


@pytest.fixture
def made(monkeypatch):
    kinds = {"steps": lambda section, mount: Steps(section), "cameras": lambda section, mount: Steps(section)}
    monkeypatch.setattr(registry, "SENSORS", {**registry.SENSORS, **kinds})


def scene(tick: int, chair: Wheelchair) -> Surroundings:
    here = chair.state()
    return Surroundings(tick=tick, plant=here, actors=(), chairs=(), signals=(), buffers=None, counted=False)


@pytest.mark.parametrize("sees", [False, True])
def test_a_further_sensor_is_fitted_sampled_and_read_by_its_name_alone(made, on_flat, sees):
    on_flat.chair.remove()
    on_flat.chair = Wheelchair(on_flat.engine, ChairConfig(), ImuConfig(), 0, {"steps": sees, "cameras": True})
    on_flat.place()
    on_flat.chair.sensors.start({"imu": 1, "steps": 5, "cameras": 3})
    on_flat.drive(FORWARD, 1)
    on_flat.chair.sensors.end_tick({"imu": 2, "steps": 4, "cameras": 6})
    frame = on_flat.chair.sensors.observe(scene(9, on_flat.chair))
    assert [reading.name for reading in frame.readings] == ["steps"]
    assert frame.readings[0].values.tolist() == ([9.0] if sees else [0.0, 4.0, 5.0])
    assert frame.imu is on_flat.chair.imu() and frame.tick == 9 and frame.cameras.tolist() == [9.0]


def test_it_is_sampled_in_every_step_and_made_anew_for_another_section(made, on_flat):
    on_flat.chair.remove()
    on_flat.chair = Wheelchair(on_flat.engine, ChairConfig(), ImuConfig(), 0, {"steps": False})
    on_flat.place().drive(FORWARD, 1)
    assert on_flat.chair.sensors.felt("steps")[0] == 24
    on_flat.chair.become(on_flat.chair.spec, {"steps": True})
    on_flat.place().drive(FORWARD, 1)
    assert on_flat.chair.sensors.felt("steps") is None


def test_cameras_need_a_rig(engine):
    with pytest.raises(ConfigError, match="no rig"):
        Wheelchair(engine, ChairConfig(), ImuConfig(), 0, {"cameras": ()})


def test_cameras_and_imu_are_two_kinds_of_sensors():
    assert {"cameras", "imu"} <= set(registry.SENSORS)
    assert Sensor in Imu.__mro__ and Sensor in _SeatCameras.__mro__
    mount = Mount(seat=0, engine=None, com_B_m=(0.0, 0.0, 0.0), wheel_radius_m=0.1, track_m=0.5, rig=object())
    assert isinstance(registry.SENSORS["cameras"]((), mount), _SeatCameras)

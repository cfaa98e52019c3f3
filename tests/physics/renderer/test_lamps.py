"""Traffic lights shine in the colour that SUMO says, towards those they face, in both renderers."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.physics.renderer.render_oracle import actor
from tests.physics.rig import shoot
from tests.support.plants import plant_state
from tests.support.samples import strip_street
from tests.support.yardstick import multiple
from wcsim.config import CameraConfig
from wcsim.physics.buffers import new_images
from wcsim.physics.renderer import kernels
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.cast import _SignalLamps
from wcsim.physics.renderer.instances import actor_instances
from wcsim.physics.renderer.models.paint import Paint
from wcsim.physics.renderer.raster import RasterRenderer
from wcsim.physics.renderer.tiny_renderer import TinyRenderer
from wcsim.physics.sensors.camera import CameraRig
from wcsim.physics.sensors.camera_geometry import look_at
from wcsim.types import ActorKind, ClassId, SignalHead, SignalState

CAMERA = Pinhole(width_px=120, height_px=160, focal_px=500.0, near_m=0.1, range_m=40.0)
EYE = (10.0, 0.0, 1.1)
EYES = np.array([EYE])
HEAD_W_M = (18.0, 0.0, 2.7)


def head(link=0, pedestrian=False, p=HEAD_W_M, yaw=math.pi, tls="t") -> SignalHead:
    return SignalHead(tls_id=tls, link=link, p_W_m=np.array(p), yaw_rad=yaw, pedestrian=pedestrian)


def state(letters: str, tls="t") -> tuple[SignalState, ...]:
    return (SignalState(tls_id=tls, colours=letters),)


@pytest.fixture(scope="module")
def renderers(store):
    with TinyRenderer(store) as tiny:
        yield RasterRenderer(store), tiny


def lit(rgb: np.ndarray, class_id: np.ndarray) -> tuple[set[str], dict[str, float]]:
    """Which colours shine, and the row of each."""
    pixels = rgb.astype(int)
    r, g, b = (pixels[..., k] for k in range(3))
    head_px = class_id == ClassId.TRAFFIC_LIGHT
    masks = {
        "red": head_px & (r > 120) & (g < 0.45 * r) & (b < 0.45 * r),
        "amber": head_px & (r > 120) & (g > 0.5 * r) & (g < 0.9 * r) & (b < 0.45 * r),
        "green": head_px & (g > 100) & (r < 0.45 * g),
    }
    found = {name: float(np.nonzero(mask)[0].mean()) for name, mask in masks.items() if mask.sum() >= 20}
    return set(found), found


@pytest.mark.parametrize(
    "letter, pedestrian, colours",
    [
        ("r", False, {"red"}), ("y", False, {"amber"}), ("u", False, {"red", "amber"}), ("g", False, {"green"}),
        ("G", False, {"green"}), ("s", False, {"red"}), ("o", False, {"amber"}), ("O", False, set()),
        ("r", True, {"red"}), ("G", True, {"green"}), ("y", True, {"red"}), ("O", True, set()), ("?", False, set()),
    ],
)  # fmt: skip
def test_the_letter_lights_its_lamp_in_both_renderers(renderers, letter, pedestrian, colours):
    lamps = _SignalLamps((head(1, pedestrian),)).near(EYES, 40.0, state("O" + letter))[0]
    T_CW = look_at(EYE, HEAD_W_M)
    for renderer in renderers:
        out = new_images(CAMERA.width_px, CAMERA.height_px, rgb=True)
        renderer.render(CAMERA, T_CW, lamps, out)
        names, rows = lit(out.rgb, out.class_id)
        assert names == colours, type(renderer).__name__
        if "green" in rows:
            assert rows["green"] > 80 + 3, "green is the lowest"
        if "red" in rows:
            assert rows["red"] < 80 - 3, "red is the highest"
        middle = out.class_id[:, 60] == ClassId.TRAFFIC_LIGHT
        assert middle.any() and abs(out.depth_m[:, 60][middle].mean() - 7.9) < 0.3


def test_only_heads_that_face_the_camera_and_are_near_are_drawn():
    heads = (head(), head(yaw=0.0), head(p=(60.0, 0.0, 2.7)), head(p=(14.0, 5.0, 2.7), yaw=-2.4))
    lamps = _SignalLamps(heads)
    assert len(lamps.near(EYES, 40.0, state("g"))[0]) == 2
    assert len(lamps.near(EYES, 60.0, state("g"))[0]) == 3
    assert len(_SignalLamps(()).near(EYES, 40.0, state("g"))[0]) == 0


def test_a_light_that_says_nothing_or_too_little_is_dark_and_comes_back():
    lamps = _SignalLamps((head(0, tls="a"), head(3, tls="b")))
    both = (SignalState(tls_id="a", colours="rr"), SignalState(tls_id="b", colours="gggg"))
    first = lamps.near(EYES, 40.0, both)[0].template.tolist()
    assert first[0] != first[1]
    alone = lamps.near(EYES, 40.0, both[:1])[0].template.tolist()
    short = lamps.near(EYES, 40.0, (both[0], SignalState(tls_id="b", colours="ggg")))[0].template.tolist()
    assert alone == short and alone[0] == first[0] and alone[1] not in first
    assert lamps.near(EYES, 40.0, both)[0].template.tolist() == first


def test_a_rig_shows_the_lights_of_now():
    camera = CameraConfig(width_px=160, height_px=120, rgb=True, hfov_deg=60.0, pitch_deg=10.0)
    plant = plant_state(10.0)
    near = (head(p=(13.0, 0.0, 1.9)),)
    with CameraRig(strip_street().mesh, (camera,), 1, near) as rig:
        seen = []
        for tick, letter in enumerate("rgO"):
            frame = shoot(rig, plant, tick=tick, signals=state(letter))[0]
            seen.append(lit(frame.rgb, frame.class_id)[0])
        dark = shoot(rig, plant, tick=9)[0]
    assert seen == [{"red"}, {"green"}, set()]
    assert (dark.class_id == ClassId.TRAFFIC_LIGHT).any() and lit(dark.rgb, dark.class_id)[0] == set()


def test_three_hundred_heads_cost_next_to_nothing():
    rng = np.random.default_rng(3)
    places = np.c_[rng.uniform(-300, 300, (300, 2)), np.full(300, 2.7)]
    heads = [head(k % 12, p=p, yaw=rng.uniform(-3, 3), tls=f"t{k // 12:02}") for k, p in enumerate(places)]
    lamps = _SignalLamps(heads)
    ranges_m = itertools.cycle((40.0, 41.0))
    signals = tuple(SignalState(tls_id=f"t{k:02}", colours="rgyG" * 3) for k in range(25))
    assert len(lamps.near(EYES, 41.0, signals)[0]) < 30
    assert multiple(lambda: lamps.near(EYES, next(ranges_m), signals)) < 0.6  # about a tenth of that


def test_the_kernel_s_numbers_are_those_of_the_paints():
    names = ("TAILLIGHT", "LEFT_LAMP", "RIGHT_LAMP", "BRAKING", "TURNING")
    assert [getattr(kernels, name) for name in names] == [Paint[name] for name in names]
    assert kernels.SHINING == Paint.BRAKING and max(Paint) == Paint.BLUE_LIGHT


@pytest.mark.parametrize("kind", [ActorKind.CAR, ActorKind.BUS, ActorKind.TRUCK])
def test_brake_lights_and_turn_lamps_shine_when_sumo_says_so(store, kind):
    """Bits of SUMO's signals: 8 brake, 1 right, 2 left."""
    raster = RasterRenderer(store)
    camera = Pinhole(width_px=320, height_px=240, focal_px=200.0, near_m=0.1, range_m=40.0)
    out = {}
    for signals in (0, 8, 1, 2):
        one = replace(actor(kind, 20.0, 0.0), signals=signals)
        images = new_images(320, 240, rgb=True)
        back_m = 0.5 * one.size_lwh_m[0] + 5.0
        raster.render(camera, look_at((20.0 - back_m, 0.0, 1.1), (20.0, 0.0, 1.0)), actor_instances([one]), images)
        out[signals] = images.rgb.astype(int)
    brighter = (out[8] - out[0])[..., 0] > 40
    assert brighter.sum() >= 8
    if kind is ActorKind.CAR:
        right, left = np.abs(out[1] - out[0]).sum(2) > 40, np.abs(out[2] - out[0]).sum(2) > 40
        assert np.nonzero(right)[1].min() > 160 > np.nonzero(left)[1].max()

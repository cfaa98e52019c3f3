"""The pictures of docs/senses.md (`make pictures PART=models`)."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.chart import Line, Panel, chart
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.chair_check.rig import make_sloped_street, make_step_street
from wcsim.config import CameraConfig, CameraNoiseConfig, ChairConfig, ImuConfig, RunConfig
from wcsim.core import seeding
from wcsim.physics.engine import Engine
from wcsim.physics.sensors.pixel_noise import child
from wcsim.physics.wheelchair.wheelchair import Wheelchair
from wcsim.towns.scenario.town import find_town
from wcsim.types import CameraFrame, ClassId, ImuFrame, Joystick, PlantState, SeatSpec, StreetMesh
from wcsim.view.pictures import captioned, class_colours, depth_colours, write_png

SEED, TOWN, DRIVE_TICKS = 4, "helsinki", 250
SUBSTEPS, HZ, TICK_S = 24, 240, 0.1
STRONG = CameraNoiseConfig.model_validate(
    {
        "depth": {"sigma_px": 0.25, "baseline_m": 0.12, "dropout": 0.04, "patch_px": 5},
        "classes": {"border_px": 4, "border_share": 0.7, "dropout": 0.05, "patch_px": 10},
        "rgb": {"snr_db": 22.0},
    }
)
Stick = Callable[[float], Joystick]
Told = tuple[list[ImuFrame], list[PlantState]]


def main(folder: Path) -> None:
    """Write every picture."""
    folder.mkdir(parents=True, exist_ok=True)
    write_png(folder / "camera_noise.png", cameras())
    write_png(folder / "imu_kerb.png", imu_kerb())
    write_png(folder / "tilt_braking.png", tilt_braking())


def cameras() -> np.ndarray:
    """Colours, classes and depth of one place: exact, typical noise, a poor network's errors, strong noise."""
    kinds = {"exact": None, "typical": "typical", "objects-poor": {"objects": "poor"}, "strong": STRONG}
    rig = tuple(CameraConfig(name=name, rgb=True, noise=noise) for name, noise in kinds.items())
    with World(find_town(TOWN), RunConfig(cameras=rig), (SeatSpec(profile="competent"),), SEED) as world:
        best, most = world.snapshot.clients[0].sensors.cameras, -1.0
        for _ in range(DRIVE_TICKS):
            frames = next(rollout(world)).after.clients[0].sensors.cameras
            busy = min(0.2, float(np.isin(frames[0].class_id, range(ClassId.PERSON, ClassId.BICYCLE + 1)).mean()))
            if busy > most:
                best, most = tuple(copied(frame) for frame in frames), busy
    return np.vstack([row(frame) for frame in best])


def copied(frame: CameraFrame) -> CameraFrame:
    """A frame that outlives the next ticks."""
    rgb = None if frame.rgb is None else frame.rgb.copy()
    return CameraFrame(
        name=frame.name, taken_tick=0, depth_m=frame.depth_m.copy(), class_id=frame.class_id.copy(), rgb=rgb
    )


def row(frame: CameraFrame) -> np.ndarray:
    """The pictures of one camera side by side."""
    panels = (
        captioned(frame.rgb, f"{frame.name}: colours"),
        captioned(class_colours(frame.class_id), f"{frame.name}: classes (black: none)"),
        captioned(depth_colours(frame.depth_m, 40.0), f"{frame.name}: depth (white: none)"),
    )
    return np.hstack(panels)


def ride(imu: ImuConfig, street: StreetMesh, seconds: float, stick: Stick, chair: ChairConfig) -> Told:
    """What the IMU and the truth say of a ride, tick by tick."""
    with Engine(1 / HZ) as engine:
        engine.add_street(street)
        driven = Wheelchair(engine, chair, imu, seat=0)
        driven.place(np.zeros(3), 0.0)
        driven.sensors.start({"imu": seeding.derive_rng_key(SEED, "imu", 0, "start", 0)})
        told: Told = ([], [])
        for tick in range(round(seconds / TICK_S)):
            driven.command(stick(tick * TICK_S))
            for _ in range(SUBSTEPS):
                driven.before_step()
                engine.step()
                driven.after_step()
            driven.end_tick({"imu": child(SEED, tick)})
            told[0].append(driven.imu())
            told[1].append(driven.state())
    return told


def imu_kerb() -> np.ndarray:
    """Up a 40 mm kerb at 1 m/s."""
    street, chair = make_step_street(0.04), ChairConfig(v_max_mps=1.0)
    exact, noisy = (ride(ImuConfig(noise=n), street, 8.0, lambda _: Joystick(0.0, 1.0), chair) for n in (False, True))
    t = times(exact)
    mean = np.array([frame.accel_mean_mps2 for frame in exact[0]])
    heard = np.array([frame.accel_mean_mps2 for frame in noisy[0]])
    peak = np.array([frame.accel_peak_mps2 for frame in exact[0]])
    pitch = np.degrees([state.pitch_rad for state in exact[1]])
    return chart(
        (
            panel("forward, mean of a tick (m/s2)", t, exact=mean[:, 0], noisy=heard[:, 0]),
            panel("up, mean of a tick (m/s2)", t, exact=mean[:, 2], noisy=heard[:, 2]),
            panel("peak behind the 20 Hz low-pass, no gravity (m/s2)", t, forward=peak[:, 0], up=peak[:, 2]),
            panel("pitch (deg)", t, true=pitch),
        ),
        "seconds; a 40 mm kerb at 1 m/s",
    )


def tilt_braking() -> np.ndarray:
    """Pitch as three sensors say it: start, cruise, brake, on level ground and up a slope."""
    stick = lambda t: Joystick(0.0, 1.0 if 1.0 < t < 5.0 else 0.0)  # noqa: E731
    panels = []
    for name, street in (
        ("level ground", make_sloped_street()),
        ("a slope of 5 deg, up", make_sloped_street(math.radians(5.0))),
    ):
        curves = {}
        for mode in ("accelerometer", "complementary", "ideal"):
            told = ride(ImuConfig(tilt=mode), street, 9.0, stick, ChairConfig())
            curves[mode] = np.degrees([frame.pitch_rad for frame in told[0]])
        panels.append(panel(f"pitch on {name} (deg)", times(told), **curves))
        speed = np.array([state.v_B_mps[0] for state in told[1]])
        panels.append(panel("speed (m/s)", times(told), speed=speed))
    return chart(panels, "seconds; start at 1 s, brake at 5 s; nose up is positive")


def times(told: Told) -> np.ndarray:
    """Ends of the ticks."""
    return TICK_S * np.arange(1, len(told[0]) + 1)


def panel(title: str, t: np.ndarray, **curves: np.ndarray) -> Panel:
    """Named curves over time."""
    return Panel(title=title, lines=tuple(Line(label=name, x=t, y=np.asarray(y)) for name, y in curves.items()))

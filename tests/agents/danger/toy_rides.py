"""A toy street for danger networks: walls, drops and people before a chair that moves by the drive's own law.

Pictures are ray cast exactly (boxes, level ground, pits with a floor below); the real eye makes a map of them.
Labels follow a rule of their own, in plain NumPy: a position is unsafe when, held for half a second and then let go, it
brings the hull into a wall, over a drop, or nearer to a person than `SHY_M`. So a network has to know where things are,
what they are, how fast the chair is, and on which side.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from tests.support.samples import ACTIONS
from tests.support.worlds import quick_config
from wcsim.agents.danger.policy import _choose
from wcsim.agents.danger.street_map import FeatureExtractor
from wcsim.agents.perception.arcs import integrate_chair_state
from wcsim.agents.perception.depth_image import viewing_rays
from wcsim.agents.runs.data_folder import SAFE, DrivingSegment
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRuleSettings
from wcsim.core.jit import compile_exact_kernel
from wcsim.supervisor.observation import encode_depth
from wcsim.types import ClassId

WALL, DROP, PERSON = range(3)
SHY_M, PIT_M, TALL_M = 0.25, -0.6, 1.6
TICK_S, STEPS, HELD = 0.1, 16, 5
FAR_M = 2.5  # more than the hull's length, a person's way in STEPS ticks and SHY_M together
_SMALL = (
    "cameras.0.width_px=48", "cameras.0.height_px=36", "sensors.odometry=typical", "env.observe_gyro=true",
    "danger.ahead=0", "danger.width=8", "danger.batch=32", "danger.weight_decay=0",
)  # fmt: skip
_CLASS = {WALL: ClassId.BUILDING, DROP: ClassId.SIDEWALK, PERSON: ClassId.PERSON}


def toy_config(*overrides: str) -> RunConfig:
    """A small camera, labels of the very tick, and a network of 8 channels."""
    return quick_config(*_SMALL, *overrides)


@dataclass
class Street:
    """Things (n, 7): kind, x, y, half sizes, velocity; a chair (6,): x, y, yaw, v, w, acceleration. SI, frame W."""

    config: RunConfig
    things: np.ndarray
    chair: np.ndarray
    eye: FeatureExtractor = field(repr=False)

    def sees(self, stick=(0.0, 0.0)):
        """The observation of a chair that stands level."""
        camera, (x, y, yaw, v, w, _) = self.config.cameras[0], self.chair
        depth_m, seg = cast(self.things, (x, y, yaw), camera)
        shape = (camera.height_px, camera.width_px)
        imu = np.array([0, 0, 0.25, 0, 0, 0, 0, w / 4.0], np.float32)
        return {
            "depth": encode_depth(depth_m.astype(np.float32).reshape(shape), camera.range_m)[None],
            "seg": seg.reshape(shape)[None],
            "imu": imu,
            "odometry": np.array([v / 4.0, w / 4.0], np.float32),
            "joystick": np.asarray(stick, np.float32),
        }

    def unsafe(self):
        """(81,) by the rule above."""
        poses = _held(self.chair, self.eye.around.commands, self.eye.around.limits)
        ahead_s = TICK_S * np.arange(1, STEPS + 1)[None, :, None]
        return self._touched(poses, ahead_s, SHY_M).any(axis=1)

    def crashed(self):
        """Whether the hull is in something now."""
        return bool(self._touched(self.chair[None, None, :3], np.zeros((1, 1, 1)), 0.0).any())

    def move(self, action):
        """A tick: people walk, the chair obeys."""
        integrate_chair_state(self.chair, self.eye.around.commands[action], self.eye.around.limits, TICK_S)
        self.things[:, 1:3] += TICK_S * self.things[:, 5:7]

    def _touched(self, poses, ahead_s, shy_m):
        """(K, T) whether the hull is in something at these poses (K, T, 3), so much later."""
        rear, front, half = self.eye.around.box_B_m
        hull = np.array([(x, y) for x in np.linspace(rear, front, 5) for y in (-half, 0.0, half)])
        cos, sin = np.cos(poses[..., 2:]), np.sin(poses[..., 2:])
        x = poses[..., :1] + cos * hull[:, 0] - sin * hull[:, 1]
        y = poses[..., 1:2] + sin * hull[:, 0] + cos * hull[:, 1]
        found = np.zeros(poses.shape[:2], bool)
        for kind, at_x, at_y, half_x, half_y, vx, vy in self.things:
            more = shy_m if kind == PERSON else 0.0
            if max(np.abs(poses[..., 0] - at_x).min() - half_x, np.abs(poses[..., 1] - at_y).min() - half_y) > FAR_M:
                continue
            off_x, off_y = np.abs(x - at_x - ahead_s * vx), np.abs(y - at_y - ahead_s * vy)
            found |= ((off_x < half_x + more) & (off_y < half_y + more)).any(axis=2)
        return found


@compile_exact_kernel
def _held(chair, commands, limits):
    """(K, STEPS, 3) x, y, yaw after each tick, when each command is held for HELD ticks and then let go."""
    poses, rest = np.empty((len(commands), STEPS, 3)), np.zeros(2)
    for k in range(len(commands)):
        now = chair.copy()
        for step in range(STEPS):
            integrate_chair_state(now, commands[k] if step < HELD else rest, limits, TICK_S)
            poses[k, step] = now[:3]
    return poses


def cast(things, pose, camera):
    """Depth in metres and class of each pixel."""
    x, y, yaw = pose
    rays = viewing_rays(camera)
    cos, sin = math.cos(yaw), math.sin(yaw)
    ex, ey, ez = camera.p_BC_m
    ox, oy = x + cos * ex - sin * ey, y + sin * ex + cos * ey
    rx, ry, rz = cos * rays[:, 0] - sin * rays[:, 1], sin * rays[:, 0] + cos * rays[:, 1], rays[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rz < 0, -ez / rz, np.inf)
        low = np.where(rz < 0, (PIT_M - ez) / rz, np.inf)
        depth, seg = floor.copy(), np.where(rz < 0, int(ClassId.SIDEWALK), int(ClassId.SKY))
        for row in things:
            kind, at_x, at_y, half_x, half_y = row[:5]
            low_x, high_x = (at_x - half_x - ox) / rx, (at_x + half_x - ox) / rx
            low_y, high_y = (at_y - half_y - oy) / ry, (at_y + half_y - oy) / ry
            near = np.maximum(np.minimum(low_x, high_x), np.minimum(low_y, high_y))
            far = np.minimum(np.maximum(low_x, high_x), np.maximum(low_y, high_y))
            if kind == DROP:
                inside = (near < floor) & (floor < far)
                depth = np.where(inside & (depth == floor), np.minimum(low, far), depth)
                continue
            hit = (near < far) & (near > 0.05) & (ez + near * rz < TALL_M) & (ez + near * rz > 0.0) & (near < depth)
            depth, seg = np.where(hit, near, depth), np.where(hit, int(_CLASS[kind]), seg)
    far = ~(depth < camera.range_m)
    return np.where(far, camera.range_m, depth), np.where(far, int(ClassId.SKY), seg).astype(np.uint8)


def thing(rng, x, y):
    """A wall, a drop or a person at a place."""
    kind = int(rng.integers(3))
    half = rng.uniform(0.2, 0.7, 2) if kind != PERSON else np.full(2, 0.2)
    if kind == DROP:
        half += 0.3
    return np.array([kind, x + half[0], y, *half, 0.0, 0.0])


def slide(config, eye, rng):
    """A street of its own: one or two things ahead, all on one side, and a chair that drives and turns."""
    while True:
        far = rng.uniform(1.25, 2.2, int(rng.integers(1, 3)))
        side = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.1, len(far))
        things = np.stack([thing(rng, x, y) for x, y in zip(far, side, strict=True)])
        things[:, 2] += np.sign(side) * 0.5 * (things[:, 4] - 0.2)  # a wide one begins where a narrow one does
        chair = np.array([0.0, 0.0, 0.0, rng.uniform(0.0, 1.4), rng.uniform(-0.6, 0.6), 0.0])
        street = Street(config, things, chair, eye)
        if not street.crashed():
            return street


def slides(config, count, seed):
    """So many ticks, each in a street of its own: one tick off, and a label says nothing."""
    rng, eye = np.random.default_rng(seed), FeatureExtractor(config)
    streets = [slide(config, eye, rng) for _ in range(count)]
    rows = [(street.sees(), street.unsafe(), 40, True, False) for street in streets]
    return segment_of(rows)


def street_to_ride(config, eye, rng):
    """A pavement with things all along it, on which people walk across; the chair stands at its begin."""
    while True:
        along = np.linspace(2.0, 9.0, 6) + rng.uniform(-0.4, 0.4, 6)
        things = np.stack([thing(rng, x, rng.uniform(-1.5, 1.5)) for x in along])
        walks = things[:, 0] == PERSON
        things[walks, 6] = rng.choice([-1.0, 1.0], walks.sum()) * rng.uniform(0.2, 0.6, walks.sum())
        street = Street(config, things, np.zeros(6), eye)
        if not street.unsafe().all():
            return street


@dataclass
class Ride:
    """What came of some episodes."""

    rows: list = field(default_factory=list)
    crashes: int = 0
    distance: float = 0.0
    steps: int = 0
    way_m: float = 0.0

    @property
    def joystick_distance(self):
        return self.distance / self.steps


def ride(config, policy, episodes, seed, ticks=60, labelled=False):
    """Drive episodes that end with a crash or after `ticks`; the user steers from side to side and looks at nothing.

    Args:
        config: Of the run.
        policy: With `act` and `reset`, or a function of (street, stick, generator) that gives an action.
        episodes: How many.
        seed: Of streets, user and driver.
        ticks: Of an episode at most.
        labelled: Keep (observation, unsafe, action, ended, crashed) of each tick.
    """
    rng, eye, found = np.random.default_rng(seed), FeatureExtractor(config), Ride()
    for _ in range(episodes):
        street, goal_m, wobble = street_to_ride(config, eye, rng), 0.0, np.zeros(2)
        if hasattr(policy, "reset"):
            policy.reset()
        for tick in range(ticks):
            goal_m = rng.uniform(-1.2, 1.2) if tick % 20 == 0 else goal_m
            wobble += -0.1 * wobble + 0.05 * rng.normal(size=2)
            _, y, yaw, *_ = street.chair
            turn = -1.5 * (np.clip(0.8 * (goal_m - y), -0.7, 0.7) - yaw)
            stick = np.clip(np.array([turn, 0.8]) + wobble, -0.7, 0.8)
            seen = street.sees(stick)
            action = policy.act(seen) if hasattr(policy, "act") else policy(street, stick, rng)
            unsafe = street.unsafe() if labelled else None
            before = street.chair[0]
            street.move(action)
            crashed = street.crashed()
            found.crashes += crashed
            found.steps += 1
            found.way_m += street.chair[0] - before
            found.distance += ACTIONS.distance(action, stick)
            found.rows.append((seen, unsafe, action, crashed or tick == ticks - 1, crashed))
            if crashed:
                break
    return found


def follow(street, stick, rng):
    """The user alone."""
    return ACTIONS.nearest(stick)


def mixed(street, stick, rng):
    """Follows, or avoids what is unsafe; by a draw of each tick, from sticks that go astray."""
    wish = np.clip(stick + rng.normal(0.0, 0.3, 2), -1.0, 1.0)
    danger = street.unsafe().astype(float) if rng.random() < 0.5 else np.zeros(len(ACTIONS))
    return _choose(danger, wish, ACTIONS, DangerRuleSettings())


def astray():
    """The user's stick with an offset that is held for 1 to 3 s and carried out."""
    left, offset = 0, np.zeros(2)

    def drive(street, stick, rng):
        nonlocal left, offset
        left -= 1
        if left <= 0:
            left = int(rng.integers(10, 31))
            offset = rng.normal(0.0, 0.9, 2)
        return ACTIONS.nearest(np.clip(stick + offset, -1.0, 1.0))

    return drive


def segment_of(rows):
    """A segment of (observation, unsafe, action, ended, crashed)."""
    seen = {key: np.stack([row[0][key] for row in rows]) for key in rows[0][0]}
    unsafe = np.stack([np.zeros(0, bool) if row[1] is None else row[1] for row in rows])
    codes = np.where(unsafe, 3, SAFE).astype(np.uint8)
    count = len(rows)
    return DrivingSegment(
        depth=seen["depth"][:, 0],
        seg=seen["seg"][:, 0],
        imu=seen["imu"],
        odometry=seen["odometry"],
        stick=seen["joystick"],
        wish=seen["joystick"],
        action=np.array([row[2] for row in rows], np.uint8),
        driver=np.zeros(count, np.uint8),
        visible=codes,
        truth=codes.copy(),
        reward=np.zeros(count, np.float32),
        crashed=np.array([row[4] for row in rows], np.bool_),
        own=np.array([row[4] for row in rows], np.bool_),
        ended=np.array([row[3] for row in rows], np.bool_),
        delay=np.zeros(count, np.uint8),
    )

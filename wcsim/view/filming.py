"""Films: a chair drives in a town for the camera, or a recorded episode is shown again."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import cv2
import numpy as np

from wcsim.agents.envs.episode_view import OBJECTS, Info, trim_frame_window
from wcsim.agents.envs.seat_driver import AgentSeatDriver, PolicyAgentAdapter
from wcsim.agents.evaluation.suite.playback import PlayedStep
from wcsim.agents.opening.named_policy import (
    list_policy_overrides,
    make_policy_seat_spec,
    open_named_policy,
    resolve_policy_config,
)
from wcsim.agents.policy_api import (
    CLASS_KEY,
    DEPTH_KEY,
    STATE_SENSE,
    Observation,
    Policy,
    Warns,
    calling,
)
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CameraConfig, RunConfig, WorldConfig, resolve
from wcsim.core.frames import deg2rad
from wcsim.errors import ConfigError
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import decode_depth
from wcsim.towns.scenario.town import Town
from wcsim.types import F32, U8, CameraFrame, ClassId, Joystick, Route, SeatSpec, Snapshot
from wcsim.users.recordings.recorded_user import find_user
from wcsim.view.map import MapView, street_video
from wcsim.view.pictures import (
    captioned,
    class_colours,
    darken,
    depth_colours,
    open_video,
    side_by_side,
    with_legend,
)

_FILM_PX: Final = 480


def seen_picture(seen: Observation, config: RunConfig) -> U8:
    """An observation, (2 H, W, 3): newest classes above, depth below; black without pictures."""
    camera = config.eye
    range_m = camera.range_m
    if STATE_SENSE in seen:
        return np.zeros((2 * camera.height_px, camera.width_px, 3), np.uint8)
    if CLASS_KEY in seen:
        classes = class_colours(seen[CLASS_KEY][-1])
        depth_m = decode_depth(seen[DEPTH_KEY][-1], range_m)
    else:
        newest = trim_frame_window(seen, 1)
        classes = np.rint(255.0 * np.moveaxis(newest["segmentation"], 0, -1)).astype(np.uint8)
        depth_m = newest["depth"][-1] * np.float32(range_m)
    return np.asarray(np.vstack([classes, depth_colours(depth_m, range_m)]), np.uint8)


def around_picture(view: MapView, step: PlayedStep, trail: Sequence[PlayedStep]) -> U8:
    """The street around a chair at a step, with those near; a green line is where it was."""
    points = np.array([item.p_W_m[:2] for item in trail], np.float64).reshape(-1, 2)
    come = Route(
        points_W_m=points, arc_m=np.zeros(len(points)), edge_index=np.zeros(len(points), np.int32)
    )
    return view.draw(step.p_W_m, step.actors, step.chairs, come)


def film_steps(path: Path, view: MapView, steps: Sequence[PlayedStep], config: RunConfig) -> None:
    """A video of observations beside the street, with sticks and speed. Raises ConfigError."""
    with open_video(path, config.world.tick_s) as write:
        for number, step in enumerate(steps):
            seen = seen_picture(step.seen, config)
            width = round(_FILM_PX * seen.shape[1] / seen.shape[0])
            large = cv2.resize(seen, (width, _FILM_PX), interpolation=cv2.INTER_NEAREST)
            before_s = (len(steps) - 1 - number) * config.world.tick_s
            street = around_picture(view, step, steps[: number + 1])
            user, driven = sticks(step)
            caption = f"-{before_s:.1f} s  {step.speed_mps:.2f} m/s  user {user}  driven {driven}"
            write(side_by_side(np.asarray(large, np.uint8), captioned(street, caption)))


def sticks(step: PlayedStep) -> tuple[str, str]:
    """The user's stick and the given one in words: x to the right, y ahead."""
    asked, given = (f"{stick.x:+.2f} {stick.y:+.2f}" for stick in (step.requested, step.given))
    return asked, given


def near(step: PlayedStep) -> list[str]:
    """Who was there at a step and how far from the chair, nearest first."""
    gaps = sorted(
        (float(np.hypot(*(actor.p_W_m - step.p_W_m)[:2])), actor.kind.value)
        for actor in step.actors
    )
    return [f"{kind} {gap_m:.1f} m" for gap_m, kind in gaps]


_ACTOR_CLASSES = np.array(
    [c.value for c in ClassId if ClassId.PERSON <= c <= ClassId.BICYCLE], np.uint8
)
_FIELD_OF_VIEW_M = 30.0
_NEAR_M, _ALL = 15.0, 4.0  # of what makes a picture telling
_MAP_SPAN_M: Final = 60.0
SIGHT_M = (
    200.0  # of pictures for people: a street ends in the distance, not where a sensor's range does
)
_FILM_CAMERA: Final = "film"  # beside those of the policy, which sees nothing of it
_PAD_SHARE: Final = 0.28  # of the picture's height
_RIM = (150, 156, 164)
ASKED_RGB, GIVEN_RGB, WARN_RGB = (90, 170, 255), (255, 170, 40), (230, 40, 40)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmDriver:
    """Who drives a filmed chair, and for whom."""

    policy: str = ""  # as `wcsim test` names it; "" for the user alone
    profile: str = "competent"  # of the user, whose stick the policy sees
    network: str = ""  # a custom one, module:Class, that the policy may look with
    settings: tuple[
        str, ...
    ] = ()  # section.key=value, laid over the policy's own, or over the usual ones


_ALONE: Final = FilmDriver()


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One moment through the camera."""

    picture: U8  # see `_triptych`
    after_s: float
    in_view: int  # actors in the camera's field of view, near enough to be seen


class FilmedDrive:
    """A world with one chair to look at, filmed if a video is asked for; a context manager.

    Args:
        town: Where.
        seed: Of the world.
        width: Of the camera's picture in pixels.
        driver: Who drives.
        video: Its file.
    """

    def __init__(
        self,
        town: Town,
        seed: int,
        width: int,
        driver: FilmDriver = _ALONE,
        video: Path | None = None,
    ) -> None:
        """Raises PolicyError, TownError, or ConfigError for what cannot be."""
        if not 64 <= width <= 1920:
            raise ConfigError(f"a picture cannot be {width} pixels wide; expected 64 to 1920")
        self._driver: AgentSeatDriver | None = None
        self._info = Info()
        config, spec, self._policy = _senses(driver, seed, width)
        self._index = 0 if self._policy is None else -1  # of the film's camera
        self.camera, self.tick_s = config.cameras[self._index], config.world.tick_s
        self._ticks = 0
        with ExitStack() as held:
            self.world = held.enter_context(World(town, config, (spec,), seed, find_user=find_user))
            if self._policy is not None:
                agent = _OwnCode(
                    self._policy, action_set(config.env.actions), config.world.users_help_ticks
                )
                self._driver = AgentSeatDriver(config, agent, self.world.snapshot.clients[0])
            self._steps = rollout(
                self.world, {} if self._driver is None else {0: self._driver.choose}
            )
            if video is not None:  # last: what failed before leaves no file
                try:
                    video.parent.mkdir(parents=True, exist_ok=True)
                except OSError as error:
                    told = (
                        f"{video.parent}: cannot be made ({error.strerror}); choose another place"
                    )
                    raise ConfigError(told) from None
                self._write = held.enter_context(street_video(video, self.world, _MAP_SPAN_M))
            self._held = held.pop_all()

    def drive(self) -> None:
        """Drive one tick without a picture."""
        (client,) = next(self._steps).after.clients
        if self._driver is not None:
            self._info = self._driver.finish_step(client).info
        self._ticks += 1

    def add(self) -> U8:
        """Drive one tick and add its picture to the video, which is returned."""
        self.drive()
        snapshot, policy = self.world.snapshot, self._policy
        speed = float(np.hypot(*snapshot.clients[0].plant.v_B_mps[:2]))
        caption = f"{self._ticks * self.tick_s:.1f} s   {speed:.2f} m/s"
        if policy is None:
            picture = captioned(self._colours(), f"{caption}   {len(snapshot.actors)} actors near")
        else:
            told = self._info[OBJECTS]
            crash = "   CRASH" if told.events.crashed else ""
            picture = captioned(self._colours(), f"{policy.name}   {caption}{crash}")
            with_sticks(
                picture,
                told.asked,
                told.given,
                warning=isinstance(policy, Warns) and policy.warning,
            )
        return self._write(picture)

    def shot(self, after_s: float) -> Shot:
        """The camera's picture `after_s`; below it those of others with colours in its size."""
        size = self._colours().shape
        rows = [
            _triptych(each.rgb, each.class_id, each.depth_m)
            for each in self.world.snapshot.clients[0].sensors.cameras
            if each.rgb is not None and each.rgb.shape == size
        ]
        return Shot(
            picture=np.vstack(rows),
            after_s=after_s,
            in_view=self._in_view(self.world.snapshot),
        )

    def business(self) -> float:
        """How much of a street is near in the picture: of a road, kerb, crossing and somebody.

        A whole number for each of the four; the rest says how large the people and vehicles are.
        """
        frame = self._frame()
        near, seen = frame.depth_m < _NEAR_M, frame.class_id
        somebody = np.isin(seen, _ACTOR_CLASSES) & near
        road, paved = np.isin(seen, (ClassId.ROAD, ClassId.CROSSWALK)), seen == ClassId.SIDEWALK
        kerb = near & np.isin(seen, (ClassId.KERB, ClassId.LOWERED_KERB))
        kerb[1:] |= near[1:] & (
            (road[:-1] & paved[1:]) | (paved[:-1] & road[1:])
        )  # from above its face is hidden
        there = (
            (road & near, 0.02),
            (kerb, 0.0005),
            ((seen == ClassId.CROSSWALK) & near, 0.003),
            (somebody, 0.002),
        )
        pixels = [np.count_nonzero(where) / seen.size for where, _ in there]
        kinds = sum(share >= least for share, (_, least) in zip(pixels, there, strict=True))
        return kinds + min(0.9, 10.0 * pixels[-1])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._held.__exit__(*error)  # of a film that fails nothing is left

    def _frame(self) -> CameraFrame:
        return self.world.snapshot.clients[0].sensors.cameras[self._index]

    def _colours(self) -> U8:
        rgb = self._frame().rgb
        if rgb is None:
            raise ConfigError("the film's camera draws no colours; it is made with rgb=True")
        return rgb

    def _in_view(self, snapshot: Snapshot) -> int:
        """Actors within reach, in the camera's horizontal field of view, behind nothing nearer."""
        plant = snapshot.clients[0].plant
        frame = self._frame()
        half = np.tan(deg2rad(self.camera.hfov_deg) / 2)
        ahead = np.array([np.cos(plant.yaw_rad), np.sin(plant.yaw_rad)])
        right = np.array([ahead[1], -ahead[0]])
        count = 0
        for actor in snapshot.actors:
            gap = actor.p_W_m[:2] - plant.p_WB_m[:2]
            along, aside = float(gap @ ahead), float(gap @ right)
            if not 1.0 < along < _FIELD_OF_VIEW_M or abs(aside) > half * along:
                continue
            column = int((0.5 + 0.5 * aside / (half * along)) * (frame.class_id.shape[1] - 1))
            stripe = slice(max(0, column - 2), column + 3)
            seen = np.isin(frame.class_id[:, stripe], _ACTOR_CLASSES) & (
                frame.depth_m[:, stripe] > along - 4.0
            )
            count += bool(seen.any())
        return count


def _senses(driver: FilmDriver, seed: int, width: int) -> tuple[RunConfig, SeatSpec, Policy | None]:
    """The world's settings, its user, its policy if any; then the film's camera is the last."""
    camera = CameraConfig(width_px=width, height_px=width * 3 // 4, rgb=True, range_m=SIGHT_M)
    if not driver.policy:
        config = RunConfig(cameras=(camera,), world=WorldConfig(mirror_radius_m=SIGHT_M))
        return resolve(config, driver.settings), SeatSpec(profile=driver.profile), None
    own = resolve_policy_config(driver.policy, "quick", driver.settings)
    film = camera.model_copy(update={"name": _FILM_CAMERA})
    own = own.model_copy(update={"cameras": (*own.cameras, film)})
    policy = open_named_policy(driver.policy, own, seed, driver.network or None)
    return (
        resolve(own, list_policy_overrides(own, policy)),
        make_policy_seat_spec(policy, driver.profile),
        policy,
    )


class BusiestMoment:
    """Keeps the moment of a drive when most of a street was in the picture, see `business`."""

    def __init__(self, filmed: FilmedDrive, fits: bool = True) -> None:
        """Begins with now, which stays if nothing better comes; see `look`."""
        self._filmed, self._best = filmed, (fits, -1.0)
        self.shot = filmed.shot(0.0)

    @property
    def shows_all(self) -> bool:
        """Whether it shows what makes a street, and fits."""
        return self._best >= (True, _ALL)

    def look(self, after_s: float, fits: bool = True) -> bool:
        """Keep this moment if it has more, or is the first that fits; whether it was kept.

        Args:
            after_s: Since the beginning.
            fits: The caller wants such a moment; another is never kept after one that fits.
        """
        now = (fits, self._filmed.business())
        if now <= self._best:
            return False
        self.shot, self._best = self._filmed.shot(after_s), now
        return True


class _OwnCode(PolicyAgentAdapter):
    """What a user's own policy raises becomes a PolicyError that says where."""

    def reset(self, info: Info) -> None:
        """Begin an episode."""
        with calling(self.policy, "reset"):
            super().reset(info)

    def act(self, observation: Observation, info: Info) -> int:
        """Ask the policy."""
        with calling(self.policy, "act"):
            return super().act(observation, info)


def _triptych(rgb: U8, class_id: U8, depth_m: F32) -> U8:
    """Colour (H, W, 3), class and depth (H, W) side by side, (H, 3 W, 3) uint8, with captions."""
    classes = with_legend(class_colours(class_id), class_id)
    panels = {"camera": rgb, "class": classes, "depth": depth_colours(depth_m)}
    return np.hstack([captioned(panel, name) for name, panel in panels.items()])


def with_sticks(image: U8, asked: Joystick, given: Joystick, *, warning: bool) -> None:
    """Draw the user's stick, the executed one and a warning into an image (H, W, 3)."""
    height, width = image.shape[:2]
    side = max(24, round(_PAD_SHARE * height))
    left, top = width - side - 6, height - side - 6
    pad = image[top : top + side, left : left + side]
    darken(pad, 0.3)
    middle, reach = side // 2, 0.42 * side
    cv2.rectangle(
        pad, (0, 0), (side - 1, side - 1), WARN_RGB if warning else _RIM, 3 if warning else 1
    )
    cv2.line(pad, (middle, 4), (middle, side - 5), _RIM, 1)
    cv2.line(pad, (4, middle), (side - 5, middle), _RIM, 1)
    for stick, colour, size in ((given, GIVEN_RGB, 0.09), (asked, ASKED_RGB, 0.05)):
        at = (round(middle + reach * stick.x), round(middle - reach * stick.y))
        cv2.line(pad, (middle, middle), at, colour, 2, cv2.LINE_AA)
        cv2.circle(pad, at, max(2, round(size * side)), colour, -1, cv2.LINE_AA)
    scale = max(0.35, width / 1200.0)
    low = top - 3
    # Each word stands on a dark strip of its own, above the one before.
    for word, colour in (("user", ASKED_RGB), ("driven", GIVEN_RGB)):
        (wide, high), below = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        at = (left + 3, low - below - 1)
        strip_top = max(0, low - high - below - 4)
        darken(image[strip_top:low, left : left + wide + 6], 0.3)
        cv2.putText(image, word, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)
        low = strip_top
    if warning:
        cv2.putText(image, "WARNING", (8, height - 12), 0, 2.0 * scale, WARN_RGB, 2, cv2.LINE_AA)

"""Films and pictures of driven episodes, for people.

A video of a chair that a policy drives: a camera beside a map, the stick of the user and the one that was executed.
Moments of a recorded episode: what the network saw, and the street around the chair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import cv2
import numpy as np

from wcsim.agents.envs.episode_view import Info
from wcsim.agents.envs.seat_driver import Agent, PolicyAgent, SeatDriver
from wcsim.agents.evaluation.suite.named_policy import config_for, open_named, sensing
from wcsim.agents.evaluation.suite.playback import PlayedStep
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, VISIBLE_BOUND, Observation, Policy, SeesTruth, Warns, calling
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import CameraConfig, RunConfig, resolve
from wcsim.errors import ConfigError
from wcsim.supervisor.observation import decode_depth
from wcsim.towns.scenario.town import Town
from wcsim.types import U8, Joystick, Route, SeatSpec
from wcsim.view.filming import MAP_SPAN_M, SIGHT_M
from wcsim.view.map import MapView, map_view
from wcsim.view.pictures import VideoWriter, captioned, class_colours, depth_colours, side_by_side

FILM_CAMERA: Final = "film"  # beside those of the policy, which sees nothing of it
_PAD_SHARE: Final = 0.28  # of the picture's height
_DARK, _RIM = (28, 32, 38), (150, 156, 164)
ASKED_RGB, GIVEN_RGB, WARN_RGB = (90, 170, 255), (255, 170, 40), (230, 40, 40)
_FILM_PX = 480


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmDriver:
    """Who drives a filmed chair, and for whom."""

    policy: str  # as `wcsim test` names it
    profile: str  # of the user whose stick the policy sees
    network: str = ""  # a custom one, module:Class, that the policy may look with
    settings: tuple[str, ...] = ()  # section.key=value, laid over the policy's own


class DrivenFilm:
    """A world with one chair and a policy in it, filmed tick by tick; a context manager.

    Args:
        town: Where.
        seed: Of the world.
        width: Of the camera's picture in pixels.
        driver: Who drives.
        path: The video.
    """

    def __init__(self, town: Town, seed: int, width: int, driver: FilmDriver, path: Path) -> None:
        """Raises PolicyError, TownError, or ConfigError for what cannot be."""
        if not 64 <= width <= 1920:
            raise ConfigError(f"got a width of {width} pixels; expected 64 to 1920")
        own = config_for(driver.policy, "quick", driver.settings)
        film = CameraConfig(name=FILM_CAMERA, width_px=width, height_px=width * 3 // 4, rgb=True, range_m=SIGHT_M)
        own = own.model_copy(update={"cameras": (*own.cameras, film)})
        self._policy = open_named(driver.policy, own, seed, driver.network or None)
        config = resolve(own, sensing(own, self._policy))
        self.tick_s = config.world.tick_s
        truth = isinstance(self._policy, SeesTruth)
        spec = SeatSpec(profile=driver.profile, truth=truth, truth_visible=self._policy.name == VISIBLE_BOUND)
        self._world = World(town, config, (spec,), seed)
        self._ticks = 0
        self.taken_over = 0.0  # how far the stick that was driven last was from the user's, 0 to 2 and more
        try:
            self._map = MapView(self._world.street.mesh, film.height_px, MAP_SPAN_M)
            agent = _OwnCode(PolicyAgent(self._policy), self._policy)
            self._driver = SeatDriver(config, agent, self._world.snapshot.clients[0])
            self._steps = rollout(self._world, {0: self._driver.choose})
            path.parent.mkdir(parents=True, exist_ok=True)  # last: what failed before leaves no file
            self._writer = VideoWriter(path, 1.0 / self.tick_s, (width + film.height_px, film.height_px))
        except BaseException as error:
            self._world.close()
            if isinstance(error, OSError):
                raise ConfigError(f"{path.parent}: cannot be made ({error.strerror}); choose another place") from None
            raise

    def drive(self) -> Info:
        """Drive one tick without a picture; what an environment's `info` says of it."""
        (client,) = next(self._steps).after.clients
        info = self._driver.take(client).info
        self._ticks += 1
        self.taken_over = math.dist((info["given"].x, info["given"].y), (info["asked"].x, info["asked"].y))
        return info

    def add(self) -> U8:
        """Drive one tick and add its picture, which is returned."""
        info, policy = self.drive(), self._policy
        rgb = self._world.snapshot.clients[0].sensors.cameras[-1].rgb
        if rgb is None:
            raise ConfigError("the film's camera draws no colours; it is made with rgb=True")
        caption = f"{policy.name}   {self._ticks * self.tick_s:.1f} s   {info['speed_mps']:.2f} m/s"
        picture = captioned(rgb, caption + ("   CRASH" if info["events"].crashed else ""))
        warning = isinstance(policy, Warns) and policy.warning
        _with_sticks(picture, info["asked"], info["given"], warning=warning)
        frame = side_by_side(picture, map_view(self._map, self._world))
        self._writer.write(frame)
        return frame

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._writer.__exit__(kind, error, at)
        self._world.close()


class _OwnCode:
    """Around an agent: what a user's own policy raises becomes a PolicyError that says where."""

    def __init__(self, agent: Agent, policy: Policy) -> None:
        self._agent, self._policy = agent, policy

    def reset(self, info: Info) -> None:
        """Begin an episode."""
        with calling(self._policy, "reset"):
            self._agent.reset(info)

    def act(self, observation: Observation, info: Info) -> object:
        """Ask the agent."""
        with calling(self._policy, "act"):
            return self._agent.act(observation, info)


def _with_sticks(image: U8, asked: Joystick, given: Joystick, *, warning: bool) -> None:
    """Draw into an image (H, W, 3) where the user's stick is, where the executed one, and a warning."""
    height, width = image.shape[:2]
    side = max(24, round(_PAD_SHARE * height))
    left, top = width - side - 6, height - side - 6
    pad = image[top : top + side, left : left + side]
    pad[:] = (0.3 * pad + 0.7 * np.array(_DARK)).astype(np.uint8)
    middle, reach = side // 2, 0.42 * side
    cv2.rectangle(pad, (0, 0), (side - 1, side - 1), WARN_RGB if warning else _RIM, 3 if warning else 1)
    cv2.line(pad, (middle, 4), (middle, side - 5), _RIM, 1)
    cv2.line(pad, (4, middle), (side - 5, middle), _RIM, 1)
    for stick, colour, size in ((given, GIVEN_RGB, 0.09), (asked, ASKED_RGB, 0.05)):
        at = (round(middle + reach * stick.x), round(middle - reach * stick.y))
        cv2.line(pad, (middle, middle), at, colour, 2, cv2.LINE_AA)
        cv2.circle(pad, at, max(2, round(size * side)), colour, -1, cv2.LINE_AA)
    scale = max(0.35, width / 1200.0)
    low = top - 3
    for word, colour in (("user", ASKED_RGB), ("driven", GIVEN_RGB)):
        low = _with_word(image, (left, low), word, scale, colour)
    if warning:
        cv2.putText(image, "WARNING", (8, height - 12), 0, 2.0 * scale, WARN_RGB, 2, cv2.LINE_AA)


def _with_word(image: U8, place: tuple[int, int], word: str, scale: float, colour: tuple[int, int, int]) -> int:
    """Write a word on a dark strip of its own, from its lower left corner (column, row); returns the strip's top."""
    (wide, high), below = cv2.getTextSize(word, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    left, low = place
    top = max(0, low - high - below - 4)
    strip = image[top:low, left : left + wide + 6]
    strip[:] = (0.3 * strip + 0.7 * np.array(_DARK)).astype(np.uint8)
    cv2.putText(image, word, (left + 3, low - below - 1), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)
    return top


def seen_picture(seen: Observation, config: RunConfig) -> U8:
    """What an observation shows, (2 H, W, 3): the newest classes above, their depth below."""
    range_m = config.cameras[0].range_m
    if CLASS_KEY in seen:
        classes = class_colours(seen[CLASS_KEY][-1])
        depth_m = decode_depth(seen[DEPTH_KEY][-1], range_m)
    else:
        classes = np.rint(255.0 * np.moveaxis(seen["segmentation"], 0, -1)).astype(np.uint8)
        depth_m = seen["depth"][-1] * np.float32(range_m)
    return np.asarray(np.vstack([classes, depth_colours(depth_m, range_m)]), np.uint8)


def around_picture(view: MapView, step: PlayedStep, trail: Sequence[PlayedStep]) -> U8:
    """The street around a chair at a step, with those near it; where it came from is a green line."""
    points = np.array([item.p_W_m[:2] for item in trail], np.float64).reshape(-1, 2)
    come = Route(points_W_m=points, arc_m=np.zeros(len(points)), edge_index=np.zeros(len(points), np.int32))
    return view.draw(step.p_W_m, step.actors, step.chairs, come)


def film_steps(path: Path, view: MapView, steps: Sequence[PlayedStep], config: RunConfig) -> None:
    """A video of what was seen beside the street around, with sticks and speed. Raises ConfigError."""
    tick_s = config.world.tick_s
    frames = (_film_frame(view, steps, number, config) for number in range(len(steps)))
    first = next(frames)
    with VideoWriter(path, 1.0 / tick_s, (first.shape[1], first.shape[0])) as writer:
        writer.write(first)
        for frame in frames:
            writer.write(frame)


def _film_frame(view: MapView, steps: Sequence[PlayedStep], number: int, config: RunConfig) -> U8:
    step = steps[number]
    seen = seen_picture(step.seen, config)
    width = round(_FILM_PX * seen.shape[1] / seen.shape[0])
    large = cv2.resize(seen, (width, _FILM_PX), interpolation=cv2.INTER_NEAREST)
    before_s = (len(steps) - 1 - number) * config.world.tick_s
    street = around_picture(view, step, steps[: number + 1])
    caption = f"-{before_s:.1f} s  {step.speed_mps:.2f} m/s  user {sticks(step)[0]}  driven {sticks(step)[1]}"
    return side_by_side(np.asarray(large, np.uint8), captioned(street, caption))


def sticks(step: PlayedStep) -> tuple[str, str]:
    """The user's stick and the given one in words: x to the right, y ahead."""
    asked, given = (f"{stick.x:+.2f} {stick.y:+.2f}" for stick in (step.asked, step.given))
    return asked, given

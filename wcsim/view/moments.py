"""Moments of a recorded episode as pictures and as a film: what the network saw, and the street around the chair."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from wcsim.agents.evaluation.suite.playback import PlayedStep
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY, Observation
from wcsim.config import RunConfig
from wcsim.supervisor.observation import decode_depth
from wcsim.types import U8, Route
from wcsim.view.map import MapView
from wcsim.view.pictures import captioned, class_colours, depth_colours, open_video, side_by_side

_FILM_PX: Final = 480


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
    with open_video(path, config.world.tick_s) as write:
        for number in range(len(steps)):
            write(_film_frame(view, steps, number, config))


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

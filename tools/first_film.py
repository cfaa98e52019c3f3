"""Make the animation of the README: `python tools/first_film.py [FOLDER]`, by default docs/pictures.

The shipped policy assists a simulated user who looks away now and then: camera view, map, and both sticks.
"""

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from wcsim.towns.scenario.town import find_town
from wcsim.types import U8
from wcsim.view.filming import FilmDriver, FilmedDrive

TOWN, SEED, POLICY, PROFILE = "helsinki", 1, "shipped", "inattentive"
FIRST_TICK, TICKS = 578, 72  # a pedestrian stops in front of the chair, and the user pushes on
WIDTH_PX, MAP_PX, STRIP_PX, EDGE_PX = 640, 168, 20, 6
MAP_SHARE = 0.55  # of the film's map, from edge to edge
QUALITY, MOST_BYTES = 75, 2_500_000
NOTICE = "wcsim: shipped policy, inattentive user, Helsinki. Map: (c) OpenStreetMap contributors, ODbL 1.0"
_INK, _STRIP, _RIM = (230, 232, 235), (28, 32, 38), (250, 250, 250)


def main(folder: Path) -> Path:
    """Drive, and write FOLDER/ride.webp."""
    frames: list[U8] = []
    driver = FilmDriver(policy=POLICY, profile=PROFILE)
    with (
        tempfile.TemporaryDirectory() as work,
        FilmedDrive(find_town(TOWN), SEED, WIDTH_PX, driver, Path(work) / "ride.webm") as film,
    ):
        for tick in range(FIRST_TICK + TICKS):
            frame = film.add()
            if tick >= FIRST_TICK:
                frames.append(with_map_inset(frame, NOTICE))
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / "ride.webp"
    write_webp(out, frames, round(1000 * film.tick_s))
    return out


def with_map_inset(frame: U8, notice: str) -> U8:
    """A film frame (H, W + H, 3) with its map small in the upper right corner, and a line below: (H + strip, W, 3)."""
    height = frame.shape[0]
    picture, chart = frame[:, : frame.shape[1] - height], frame[:, frame.shape[1] - height :]
    out = np.full((height + STRIP_PX, picture.shape[1], 3), _STRIP, np.uint8)
    out[:height] = picture
    edge = round(height * (1.0 - MAP_SHARE) / 2.0)  # the middle alone: people are dots there that can be seen
    middle = np.ascontiguousarray(chart[edge : height - edge, edge : height - edge])
    small = cv2.resize(middle, (MAP_PX, MAP_PX), interpolation=cv2.INTER_AREA)
    left = picture.shape[1] - MAP_PX - EDGE_PX
    out[EDGE_PX : EDGE_PX + MAP_PX, left : left + MAP_PX] = small
    cv2.rectangle(out, (left, EDGE_PX), (left + MAP_PX - 1, EDGE_PX + MAP_PX - 1), _RIM, 1)
    cv2.putText(out, notice, (EDGE_PX, height + STRIP_PX - 6), 0, 0.34, _INK, 1, cv2.LINE_AA)
    return out


def write_webp(path: Path, frames: list[U8], frame_ms: int) -> None:
    """An animation that runs for ever. Raises SystemExit when it is too large for a page."""
    film = cv2.Animation()
    film.frames = [np.ascontiguousarray(frame[..., ::-1]) for frame in frames]
    film.durations = [frame_ms] * len(frames)
    cv2.imwriteanimation(str(path), film, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    if path.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{path}: {path.stat().st_size} bytes; expected at most {MOST_BYTES}: reduce QUALITY")


if __name__ == "__main__":
    made = main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/pictures"))
    print(f"{made}: {made.stat().st_size} bytes")

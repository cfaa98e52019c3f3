"""Little films, made by hand."""

from __future__ import annotations

import numpy as np

from wcsim.drive.playing.film_states import ACTOR_ROW, FilmAbout, FilmBody, FilmChair, FilmFrame, FilmStep, Flag
from wcsim.drive.playing.tick_film import TickFilm

ABOUT = FilmAbout(title="by hand", town="nowhere", tick_s=0.1, actions="square81", warns=True, tells_who=True)
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
NOTHING = Flag(0)
OUTLINE = (1.1, 0.65, 1.3, 0.3)


def chair(seat: int, at: int, flags: Flag = NOTHING, **changes: object) -> FilmChair:
    plain = {
        "seat": seat, "p_WB_m": (float(at), 2.0 * seat, 0.0), "q_WB": UPRIGHT, "outline": OUTLINE, "speed_mps": 0.5,
        "stick": (0.0, 1.0), "commanded": (0.0, 0.75), "flags": int(flags), "step": at + 1, "way": 0,
    }  # fmt: skip
    return FilmChair(**{**plain, **changes})


def step(at: int, *chairs: FilmChair) -> FilmStep:
    """A tick with a car that drives east beside the chairs."""
    row = np.zeros(1, ACTOR_ROW)
    row["p_W_m"], row["v_W_mps"] = (at, -5.0, 0.0), (10.0, 0.0)
    frame = FilmFrame(epoch=0, tick=at + 1, time_s=0.1 * (at + 1), actors=row.tobytes(), signals=0, chairs=list(chairs))
    if at:
        return FilmStep(frame=frame)
    way = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]], "<f4").tobytes()
    bodies = [FilmBody("car", "car", (4.5, 1.8, 1.5))]
    return FilmStep(frame=frame, bodies=bodies, ways=[way], signals=[[("x", "Gr")]])


def film_of(ticks: int, flags: dict[int, Flag], most_bytes: int = 1 << 30) -> TickFilm:
    """Chairs 0 and 1, of which the first does what `flags` say, by frame."""
    film = TickFilm(ABOUT, most_bytes)
    for at in range(ticks):
        film.add(step(at, chair(0, at, flags.get(at, Flag(0))), chair(1, at)))
    return film

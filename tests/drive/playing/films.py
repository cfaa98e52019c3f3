"""Little films, made by hand."""

import numpy as np

from wcsim.drive.playing.film_states import FilmAbout, FilmChair, FilmFrame, _FilmBody
from wcsim.drive.playing.tick_film import TickFilm
from wcsim.types import ActorKind, Outline, SignalState

ABOUT = FilmAbout(title="by hand", town="nowhere", tick_s=0.1, actions="square81", warns=True, tells_who=True)
OUTLINE = Outline(length_m=1.1, width_m=0.65, height_m=1.3, middle_x_m=0.3)
WAY = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 10.0]], "<f4").tobytes()


def chair(seat: int, at: int, happened: str = "", **changes: object) -> FilmChair:
    """A chair to which this happened, in names of its fields."""
    plain = {
        "seat": seat, "p_WB_m": [float(at), 2.0 * seat, 0.0], "q_WB": [0.0, 0.0, 0.0, 1.0], "outline": OUTLINE,
        "speed_mps": 0.5, "stick": (0.0, 1.0), "commanded": (0.0, 0.75), "step": at + 1,
    }  # fmt: skip
    return FilmChair(**{**plain, **dict.fromkeys(happened.split(), True), **changes})


def frame(at: int, *chairs: FilmChair) -> FilmFrame:
    """A tick with a car that drives east beside the chairs."""
    return FilmFrame(
        epoch=0,
        tick=at + 1,
        time_s=0.1 * (at + 1),
        bodies=[_FilmBody(id="car", kind=ActorKind.CAR)],
        rows=np.array([at, -5.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 4.5, 1.8, 1.5], "<f4").tobytes(),
        chairs=list(chairs),
        ways={chair.seat: WAY for chair in chairs},
        signals=(SignalState(tls_id="x", colours="Gr"),),
    )


def film_of(ticks: int, happened: dict[int, str], most_bytes: int = 1 << 30) -> TickFilm:
    """Chairs 0 and 1, of which to the first this happens, by frame."""
    film = TickFilm(ABOUT, most_bytes)
    for at in range(ticks):
        film.add(frame(at, chair(0, at, happened.get(at, "")), chair(1, at)))
    return film

"""Pictures and films of a chair that its user drives, or a policy."""

from types import SimpleNamespace

import numpy as np
import pytest

from wcsim.errors import PolicyError
from wcsim.types import Joystick
from wcsim.view import filming
from wcsim.view.filming import ASKED_RGB, GIVEN_RGB, BusiestMoment, FilmDriver, FilmedDrive, with_sticks
from wcsim.view.map import _draw_scale


def test_a_moment_that_does_not_fit_is_kept_only_till_one_does():
    business = iter([5.0, -1.0, 3.0, 9.0, 1.0])
    film = SimpleNamespace(shot=lambda after_s: after_s, business=lambda: next(business))
    kept = BusiestMoment(film, fits=False)
    taken = [kept.look(float(second), second in (2, 3, 5)) for second in (1, 2, 3, 4, 5)]
    assert taken == [True, True, True, False, False]
    assert kept.shot == 3.0


@pytest.mark.parametrize("width", [320, 480, 960])
def test_the_words_of_both_sticks_stand_apart_on_dark_ground(width):
    image = np.full((width * 3 // 4, width, 3), 255, np.uint8)
    with_sticks(image, Joystick(0.0, 1.0), Joystick(0.0, 1.0), warning=False)
    top = round(image.shape[0] * (1 - 0.28)) - 8
    above, rows = image[:top].astype(int), {}
    for colour in (ASKED_RGB, GIVEN_RGB):
        at = np.nonzero(np.abs(above - colour).max(axis=2) < 40)
        assert len(at[0]) > 10
        rows[colour] = at[0]
    assert rows[GIVEN_RGB].max() + 2 < rows[ASKED_RGB].min()
    around = above[rows[ASKED_RGB].min() : rows[ASKED_RGB].max(), width - round(0.28 * image.shape[0]) - 4]
    assert around.max() < 130, "light letters on light ground cannot be read"


def test_the_clock_counts_from_the_beginning_of_the_film(corner_town, tmp_path, monkeypatch):
    said = []
    real = filming.captioned
    monkeypatch.setattr(filming, "captioned", lambda image, text: said.append(text) or real(image, text))
    settings = ("world.warmup_s=5", "cameras.0.width_px=32", "cameras.0.height_px=24", "chair.v_max_mps=0.5")
    driver = FilmDriver(policy="follow", profile="inattentive", settings=settings)
    film = FilmedDrive(corner_town, 0, 80, driver, tmp_path / "a.webm")
    with film:
        frames = [film.add() for _ in range(12)]
    assert said[0].split()[:3] == ["follow", "0.1", "s"] and said[-1].split()[:3] == ["follow", "1.2", "s"]
    assert frames[0].shape == (60, 140, 3)
    assert max(float(text.split()[3]) for text in said) < 0.6, "settings are laid over those of the policy"


def test_a_film_that_begins_later_shows_the_same_street(corner_town, tmp_path):
    settings = ("world.warmup_s=5", "cameras.0.width_px=32", "cameras.0.height_px=24")

    driver = FilmDriver(policy="follow", profile="inattentive", settings=settings)

    def last_of_eight(before: int, name: str) -> list[np.ndarray]:
        with FilmedDrive(corner_town, 0, 80, driver, tmp_path / name) as film:
            for _ in range(before):
                film.drive()
            return [film.add() for _ in range(8 - before)][-3:]

    whole, part = last_of_eight(0, "whole.webm"), last_of_eight(5, "part.webm")
    assert all(np.array_equal(one, other) for one, other in zip(whole, part, strict=True))
    assert not np.array_equal(part[0], part[-1])


@pytest.mark.parametrize("call", ["begin", "reset"])
def test_a_policy_that_fails_at_once_leaves_no_half_video(corner_town, tmp_path, monkeypatch, call):
    from wcsim.bridge.sumo.session import world_in_this_process

    real = filming.open_named_policy

    def broken(*words):
        def fails(self):
            raise PolicyError("it failed")

        policy = real(*words)
        monkeypatch.setattr(type(policy), call, fails)
        return policy

    monkeypatch.setattr(filming, "open_named_policy", broken)
    settings = ("world.warmup_s=0", "cameras.0.width_px=32", "cameras.0.height_px=24")
    driver = FilmDriver(policy="follow", profile="inattentive", settings=settings)
    with pytest.raises(PolicyError, match="it failed"):
        FilmedDrive(corner_town, 0, 80, driver, tmp_path / "a.webm")
    assert list(tmp_path.iterdir()) == []
    assert not world_in_this_process()


def test_a_picture_shows_each_camera_the_front_one_first(corner_town):
    both = FilmDriver(settings=('env.camera=["front","rear"]',))
    shots = []
    for driver in (FilmDriver(), both):
        with FilmedDrive(corner_town, 0, 80, driver) as film:
            shots.append(film.shot(0.0).picture)
    front, rows = shots
    assert rows.shape == (2 * len(front), *front.shape[1:])
    assert (rows[: len(front)] == front).all() and (rows[len(front) :] != front).any()


@pytest.mark.parametrize("size, span_m", [(360, 60.0), (900, 60.0), (480, 30.0)])
def test_the_bar_of_the_scale_is_ten_metres_long(size, span_m):
    ground = np.full((size, size, 3), 200, np.uint8)
    image = ground.copy()
    _draw_scale(image, size / span_m)
    white = (image == 250).all(axis=2)
    low = int(white.sum(axis=1).argmax())
    assert np.ptp(np.nonzero(white[low])[0]) == pytest.approx(10.0 * size / span_m, abs=1)
    assert (image != ground).any(axis=2).sum() < 0.05 * size**2
    assert (image[: low - 4] > 230).all(axis=2).sum() > 10, "the bar says how long it is"
    assert image[low - 2, size // 10].max() < 130, "light letters on light ground cannot be read"

"""How a frame of the moving picture is put together, and what is too large for a page."""

import cv2
import numpy as np
import pytest

from tools import first_film as film


def test_the_map_lies_in_the_corner_and_the_notice_below():
    frame = np.zeros((480, 640 + 480, 3), np.uint8)
    frame[:, :640] = (10, 120, 10)
    frame[:, 640:] = (200, 0, 0)
    frame[200:280, 640 + 200 : 640 + 280] = (0, 0, 250)
    made = film.with_map_inset(frame, "(c) somebody")
    assert made.shape == (480 + film.STRIP_PX, 640, 3)
    corner = made[film.EDGE_PX : film.EDGE_PX + film.MAP_PX, -film.MAP_PX - film.EDGE_PX : -film.EDGE_PX]
    assert tuple(corner[film.MAP_PX // 2, film.MAP_PX // 2]) == (0, 0, 250), "the chair is in the middle"
    assert tuple(corner[10, 10]) == (200, 0, 0)
    assert (made[300:480] == (10, 120, 10)).all()
    assert made[480:].max() > 150, "something is written there"


def test_a_film_that_is_too_large_is_refused(tmp_path, monkeypatch):
    frames = [np.full((24, 32, 3), shade, np.uint8) for shade in (0, 250)]
    film.write_webp(tmp_path / "a.webp", frames, 100)
    found, animation = cv2.imreadanimation(str(tmp_path / "a.webp"))
    assert found and len(animation.frames) == 2 and list(animation.durations) == [100, 100]
    monkeypatch.setattr(film, "MOST_BYTES", 10)
    with pytest.raises(SystemExit, match="expected at most 10"):
        film.write_webp(tmp_path / "a.webp", frames, 100)

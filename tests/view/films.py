"""Films, read back."""

from pathlib import Path

import cv2
import numpy as np


def frames_of(path: Path | str) -> list[np.ndarray]:
    """All pictures of a film."""
    film, frames = cv2.VideoCapture(str(path)), list[np.ndarray]()
    while (read := film.read())[0]:
        frames.append(read[1])
    film.release()
    return frames

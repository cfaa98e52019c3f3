"""Videos that a browser plays (WebM files with VP8, through OpenCV) and the pictures they are put together from."""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np

from wcsim.core.native_output import without_line
from wcsim.errors import ConfigError
from wcsim.types import U8
from wcsim.view.map import MapView, map_view

__all__ = ["MapView", "VideoWriter", "map_view", "side_by_side"]


class VideoWriter:
    """Writes frames to a .webm file; the file appears under its name when it is closed without an error.

    Use it as a context manager: after an error inside the block nothing is left on disk.
    """

    def __init__(self, path: Path, fps: float, size: tuple[int, int]) -> None:
        """Open the file.

        Args:
            path: where the video goes; must end in .webm.
            fps: frames a second of playing time.
            size: width and height in pixels.

        Raises:
            ConfigError: when the name, the rate or the size cannot be used, or the folder cannot be written.
        """
        if path.suffix != ".webm":
            raise ConfigError(f"{path}: expected a name that ends in .webm, the only video format that is written here")
        if fps <= 0 or min(size) < 2:
            raise ConfigError(f"{path}: got {fps} frames a second of {size} pixels; expected a positive rate and size")
        self.path = path
        self.size = size
        self.frames = 0
        self._part = path.with_name(f".{path.stem}.part.webm")
        # FFmpeg's VP8 wants even sides; an odd one is padded by repeating the last row or column.
        self._padded = (size[0] + size[0] % 2, size[1] + size[1] % 2)
        self._writer: cv2.VideoWriter | None = None
        if path.parent.is_dir() and os.access(path.parent, os.W_OK):
            # OpenCV says of every WebM file that its tag is not supported, and writes a sound one.
            with without_line(b"OpenCV: FFMPEG: tag"):
                self._writer = cv2.VideoWriter(str(self._part), cv2.VideoWriter.fourcc(*"VP80"), fps, self._padded)
        if self._writer is None or not self._writer.isOpened():
            self._drop()
            raise ConfigError(f"{path}: cannot be written; choose a folder that exists and is writable")

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self._drop()

    def write(self, image: U8) -> None:
        """Add a frame (H, W, 3), RGB. Raises ConfigError when it has another size or the video is closed."""
        width, height = self.size
        if self._writer is None:
            raise ConfigError(f"{self.path}: this video is closed; open another to write more frames")
        if image.shape != (height, width, 3):
            raise ConfigError(f"{self.path}: got a frame of {image.shape}; expected {(height, width, 3)} as at first")
        padding = ((0, self._padded[1] - height), (0, self._padded[0] - width), (0, 0))
        self._writer.write(np.pad(image[..., ::-1], padding, mode="edge"))
        self.frames += 1

    def close(self) -> None:
        """Finish the file and put it under its name; a second call does nothing. A video without frames is dropped."""
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        if self.frames:
            self._part.replace(self.path)
        else:
            self._part.unlink(missing_ok=True)

    def _drop(self) -> None:
        if self._writer is not None:
            self._writer.release()
            self._writer = None
        self._part.unlink(missing_ok=True)


def side_by_side(*images: U8) -> U8:
    """Images (H, W, 3) next to each other, each scaled to the height of the first."""
    height = images[0].shape[0]
    fitted = []
    for image in images:
        width = round(image.shape[1] * height / image.shape[0])
        same = image.shape[0] == height
        fitted.append(image if same else cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))
    return np.asarray(np.hstack(fitted), np.uint8)

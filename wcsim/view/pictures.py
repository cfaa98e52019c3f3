"""Pictures for people: class and depth images in colour, with captions, as PNG and video.

Videos are WebM files with VP8, written through OpenCV, which a browser plays.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from wcsim.core.files import write_bytes, write_file_atomically
from wcsim.core.processes import drop_stderr_lines
from wcsim.errors import ConfigError, DiskFullError
from wcsim.supervisor.palette import make_class_palette
from wcsim.types import F32, U8, ClassId

INK_RGB = (255, 255, 255)
_STRIP_RGB = (28, 32, 38)
_MOST_NAMES = 8  # of a legend


def class_colours(class_id: U8) -> U8:
    """Class ids (H, W) as an image (H, W, 3) in the Cityscapes colours; unknown ids are black."""
    return np.asarray(make_class_palette()[class_id], np.uint8)


def depth_colours(depth_m: F32, range_m: float | None = None) -> U8:
    """Depth (H, W) as a colour image (H, W, 3): near is red, far is blue, `range_m` is black.

    Without `range_m` the largest depth is black. Where nothing was measured (0) it is white. The
    scale is logarithmic from 0.3 m on, since what is near matters most.
    """
    far = float(range_m if range_m is not None else depth_m.max(initial=1.0))
    near = min(0.3, 0.5 * far)
    share = np.log(np.clip(depth_m, near, far) / near) / np.log(far / near)
    bgr = cv2.applyColorMap(np.asarray(230 - 210 * share, np.uint8), cv2.COLORMAP_TURBO)
    bgr[depth_m >= far] = 0
    bgr[depth_m <= 0.0] = 255
    return np.ascontiguousarray(bgr[..., ::-1])


def with_legend(image: U8, class_id: U8) -> U8:
    """A copy of a class picture (H, W, 3) that names the classes (H, W) which cover most of it."""
    out = np.array(image, np.uint8, order="C")
    scale = max(0.35, out.shape[1] / 1200.0)
    numbers, counts = np.unique(class_id, return_counts=True)
    known = [number for number in numbers[np.argsort(-counts)].tolist() if number in {*ClassId}][
        :_MOST_NAMES
    ]
    size = round(34.0 * scale)
    for line, number in enumerate(reversed(known)):
        low = out.shape[0] - 4 - line * (size + 2)
        name = ClassId(number).name.replace("_", " ").lower()
        (wide, _), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
        cv2.rectangle(out, (4, low - size), (size + wide + 14, low), _STRIP_RGB, cv2.FILLED)
        cv2.rectangle(
            out,
            (7, low - size + 3),
            (size, low - 3),
            make_class_palette()[number].tolist(),
            cv2.FILLED,
        )
        cv2.putText(
            out,
            name,
            (size + 8, low - size // 4),
            cv2.FONT_HERSHEY_SIMPLEX,
            scale,
            INK_RGB,
            1,
            cv2.LINE_AA,
        )
    return out


def captioned(image: U8, text: str) -> U8:
    """A copy of an image (H, W, 3) with a line of text at its upper left, on a dark strip."""
    out = np.array(image, np.uint8, order="C")
    scale = max(0.35, out.shape[1] / 800.0)
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    darken(out[: height + below + 6, : width + 10], 0.35)
    cv2.putText(
        out, text, (5, height + 4), cv2.FONT_HERSHEY_SIMPLEX, scale, INK_RGB, 1, cv2.LINE_AA
    )
    return out


def darken(area: U8, share: float) -> None:
    """Darken a part (H, W, 3) of a picture for words on it; a share of its own colours stays."""
    area[:] = (share * area + (1.0 - share) * np.array(_STRIP_RGB)).astype(np.uint8)


def write_png(path: Path, image: U8) -> None:
    """Write an image (H, W, 3), RGB, or (H, W), whole or not at all. Raises DiskFullError."""
    bgr = image[..., ::-1] if image.ndim == 3 else image
    _, data = cv2.imencode(".png", np.ascontiguousarray(bgr))
    write_bytes(path, data.tobytes())


@contextmanager
def open_video(path: Path, tick_s: float) -> Iterator[Callable[[U8], None]]:
    """Writes frames (H, W, 3), RGB, to a .webm file; it gets its name at the end, without an error.

    A video without frames is not written.

    Args:
        path: Where the video goes; must end in .webm.
        tick_s: From a frame to the next.

    Raises:
        ConfigError: The name cannot be used, the folder cannot be written, or a frame has another
            size than the first.
        DiskFullError: There is no room.
    """
    if path.suffix != ".webm":
        raise ConfigError(
            f"{path}: expected a name that ends in .webm, "
            "the only video format that is written here"
        )
    refused = ConfigError(f"{path}: cannot be written; choose a folder that exists and is writable")
    if not path.parent.is_dir():
        raise refused
    shape: tuple[int, ...] = ()
    frames = 0
    with write_file_atomically(path) as part:
        video = cv2.VideoWriter()

        def write(image: U8) -> None:
            nonlocal shape, frames
            height, width = image.shape[:2]
            pad_v, pad_u = (
                height % 2,
                width % 2,
            )  # FFmpeg's VP8 wants even sides: the last row or column is repeated
            if not shape:
                # OpenCV warns of every WebM file that its tag is not supported, but writes it well.
                with drop_stderr_lines(b"OpenCV: FFMPEG: tag"):
                    code = cv2.VideoWriter.fourcc(*"VP80")
                    if not video.open(
                        str(part), code, 1.0 / tick_s, (width + pad_u, height + pad_v)
                    ):
                        raise refused
                shape = image.shape
            if image.shape != shape:
                raise ConfigError(
                    f"{path}: got a frame of {image.shape}; expected {shape} as at first"
                )
            frames += 1
            video.write(np.pad(image[..., ::-1], ((0, pad_v), (0, pad_u), (0, 0)), mode="edge"))

        level = cv2.utils.logging.setLogLevel(
            cv2.utils.logging.LOG_LEVEL_ERROR
        )  # a line a frame on a full disk
        try:
            yield write
        finally:
            video.release()
            cv2.utils.logging.setLogLevel(level)
        # OpenCV does not say whether it could write.
        film = cv2.VideoCapture(str(part))
        with drop_stderr_lines(b"[matroska"):
            whole = all(film.grab() for _ in range(frames))
        if not whole:
            raise DiskFullError(
                f"{path}: could not be written whole; make room, or choose another place"
            )


def side_by_side(*images: U8) -> U8:
    """Images (H, W, 3) next to each other, each scaled to the height of the first."""
    height = images[0].shape[0]
    fitted = []
    for image in images:
        width = round(image.shape[1] * height / image.shape[0])
        same = image.shape[0] == height
        fitted.append(
            image if same else cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        )
    return np.asarray(np.hstack(fitted), np.uint8)

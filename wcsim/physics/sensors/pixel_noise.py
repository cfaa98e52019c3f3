"""Random numbers without a state, by 64-bit key and place, and kernels that disturb pictures.

A picture's key comes from the seed tree by seat and camera, and from the tick; each pixel then has
its own word of random bits. So noise does not depend on the order of pictures, nor on other
cameras. The words are those of the generator splitmix64. A word becomes normal by a table of
quantiles, which is many times faster than logarithm and sine. All that a kernel calls is in this
file, see `physics/renderer/kernels.py`.
"""

from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from wcsim.core.jit import compile_fast_kernel
from wcsim.types import F32, F64, U8

_MASK = (1 << 64) - 1
_STEP, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB  # of splitmix64
STEP, FIRST, SECOND = np.uint64(_STEP), np.uint64(_FIRST), np.uint64(_SECOND)
S11, S16, S27, S30, S31, S32 = (np.uint64(n) for n in (11, 16, 27, 30, 31, 32))
LOW16, LOW21, LOW32 = np.uint64(0xFFFF), np.uint64(0x1FFFFF), np.uint64(0xFFFFFFFF)
CELLS = 4096  # of the table of quantiles
CELL_BITS, REST_BITS = np.uint64(20), np.uint64((1 << 20) - 1)
PER_REST = np.float32(1.0 / (1 << 20))
TAIL = 4.0  # standard deviations at the ends of the table
HALF = np.float32(0.5)
VOID_ID = np.uint8(0)


class DepthNoise(NamedTuple):
    """A stereo camera's numbers for the kernel; lengths in metres, disparities in pixels."""

    focal_px: float  # of the picture
    # Focal length times baseline: the shift of a surface at 1 m between the imagers.
    shift_px_m: float  # in the picture
    match_px_m: float  # in the images that are matched
    sigma_px: float
    step_px: float  # 0: not rounded
    range_m: float
    z_min_m: float
    shadow: bool
    dropout: float
    grazing_sin: float
    grazing_dropout: float
    patch_px: int

    def lay_over(self, depth_m: F32, key: int) -> None:
        """Measure a true depth picture (H, W), see `_disturb_depth`; `key` has 64 bits."""
        _disturb_depth(depth_m, np.uint64(key), self, normal_quantiles())


class ClassNoise(NamedTuple):
    """The numbers of a network that names pixels."""

    border_px: int
    border_share: float
    grain_px: int
    dropout: float
    patch_px: int

    def lay_over(self, class_id: U8, key: int) -> None:
        """Name the pixels of a true picture (H, W), see `_disturb_classes`; `key` has 64 bits."""
        _disturb_classes(class_id, np.uint64(key), self)


class ColourNoise(NamedTuple):
    """The number of an imager: the standard deviation of a colour, in steps of 255."""

    sigma: float

    def lay_over(self, rgb: U8, key: int) -> None:
        """Disturb colours (H, W, 3), see `_disturb_colours`; `key` has 64 bits."""
        _disturb_colours(rgb, np.uint64(key), self.sigma, normal_quantiles())


def child(key: int, number: int) -> int:
    """The 64-bit key of one tick (or part) under a key.

    >>> child(1, 2) == child(1, 2), child(1, 2) == child(1, 3)
    (True, False)
    """
    word = (key + (number + 1) * _STEP) & _MASK
    word = ((word ^ (word >> 30)) * _FIRST) & _MASK
    word = ((word ^ (word >> 27)) * _SECOND) & _MASK
    return word ^ (word >> 31)


def normals(key: int, count: int) -> F64:
    """Standard normal numbers (count,) float64 of a key; none is beyond 4 standard deviations."""
    return _normals(np.uint64(key), count, normal_quantiles())


@lru_cache(maxsize=1)
def normal_quantiles() -> F32:
    """Normal quantiles (CELLS + 1,) float32 at 0, 1/CELLS, ..., 1; the ends stand at TAIL."""
    normal = NormalDist()
    inner = [normal.inv_cdf(k / CELLS) for k in range(1, CELLS)]
    return np.array([-TAIL, *inner, TAIL], np.float32)


@compile_fast_kernel
def random_word(key: np.uint64, place: int) -> np.uint64:
    """64 random bits of a place."""
    x = key + np.uint64(place + 1) * STEP
    x = (x ^ (x >> S30)) * FIRST
    x = (x ^ (x >> S27)) * SECOND
    return x ^ (x >> S31)


@compile_fast_kernel
def random_normal(bits: np.uint64, table: F32) -> np.float32:
    """A standard normal number from 32 random bits: a cell of the table, and a place in it."""
    cell = bits >> CELL_BITS
    low = table[cell]
    rest = np.float32(np.int64(bits & REST_BITS)) * PER_REST
    return np.float32(low + rest * (table[np.int64(cell) + 1] - low))


@compile_fast_kernel
def _normals(key: np.uint64, count: int, table: F32) -> F64:
    out = np.empty(count, np.float64)
    for i in range(count):
        out[i] = random_normal(random_word(key, i) >> S32, table)
    return out


@compile_fast_kernel
def _least(a: np.float32, b: np.float32) -> np.float32:
    """The one of two numbers that is nearer to 0."""
    return a if abs(a) < abs(b) else b


@compile_fast_kernel
def _disturb_depth(depth_m: F32, key: np.uint64, noise: DepthNoise, table: F32) -> None:
    """Measure a true depth picture (H, W) as a stereo camera does, in place; 0 is no measurement.

    The picture is that of the left imager. A pixel is lost in the shadow of something nearer on its
    right, which hides it from the right imager, and where the right imager's picture ends. It is
    lost in a patch, more often where the surface is seen flat, and when it is nearer than
    `z_min_m`. The others get an error in their disparity.
    """
    height, width = depth_m.shape
    shift, match = np.float32(noise.shift_px_m), np.float32(noise.match_px_m)
    sigma, step = np.float32(noise.sigma_px), np.float32(noise.step_px)
    per_step = np.float32(1.0 / noise.step_px) if noise.step_px > 0.0 else np.float32(0.0)
    range_m, z_min = np.float32(noise.range_m), np.float32(noise.z_min_m)
    least_px, flat = match / range_m, np.float32(noise.grazing_sin * noise.grazing_sin)
    focal, per_focal = np.float32(noise.focal_px), np.float32(1.0 / noise.focal_px)
    # Shares as 32 bits: random words are compared with them as they are, without a conversion.
    lost_below = np.uint64(noise.dropout * 4294967295.0)
    flat_below = np.uint64(noise.grazing_dropout * 4294967295.0)
    # A place that no pixel has: patches draw apart from the noise of pixels.
    patch_key = random_word(key, -2)
    lost = np.empty((width + noise.patch_px - 1) // noise.patch_px, np.uint64)
    inverse = np.float32(1.0) / depth_m
    patch_of = np.arange(width) // noise.patch_px
    for row in range(height):
        if row % noise.patch_px == 0:
            for k in range(len(lost)):
                # A word for all rows of a patch: a matcher loses patches, not single pixels.
                lost[k] = random_word(patch_key, row * width + k)
        v = (np.float32(row) + HALF - HALF * np.float32(height)) * per_focal
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        leftmost = np.float32(2.0 * width)
        # From the right, as what hides a pixel from the right imager is to its right here.
        for i in range(width - 1, -1, -1):
            z, q = depth_m[row, i], inverse[row, i]
            # Lost before: it hides nothing.
            if z == 0.0:
                continue
            at = np.float32(i) - shift * q
            hidden = noise.shadow and (at > leftmost - HALF or at < -HALF)
            leftmost = min(leftmost, at)
            bits = lost[patch_of[i]]
            if hidden or (z < range_m and bits >> S32 < lost_below):
                depth_m[row, i] = 0.0
                continue
            if z >= range_m:
                continue
            if flat > 0.0 and bits & LOW32 < flat_below:
                u = (np.float32(i) + HALF - HALF * np.float32(width)) * per_focal
                # The smaller slope of both sides: beyond an edge there is another surface.
                a = focal * _least(
                    inverse[row, min(i + 1, width - 1)] - q, q - inverse[row, max(i - 1, 0)]
                )
                b = focal * _least(inverse[below, i] - q, q - inverse[above, i])
                c = q - u * a - v * b
                if q * q < flat * (a * a + b * b + c * c) * (u * u + v * v + np.float32(1.0)):
                    depth_m[row, i] = 0.0
                    continue
            # Normal in disparity, so that errors in depth grow with the square of the distance.
            px = match * q + sigma * random_normal(random_word(key, row * width + i) >> S32, table)
            if per_step > 0.0:
                px = step * np.rint(px * per_step)
            # Noise may push a disparity to 0 or below, which would be a depth behind the camera.
            measured = match / px if px > least_px else range_m
            depth_m[row, i] = measured if measured >= z_min else np.float32(0.0)


@compile_fast_kernel
def _disturb_classes(class_id: U8, key: np.uint64, noise: ClassNoise) -> None:
    """Name pixels (H, W) as a network does, in place: borders fray, and patches have no class.

    A square of `grain_px` takes, with probability `border_share`, the classes at most `border_px`
    away. That shows at borders alone.
    """
    height, width = class_id.shape
    source = class_id.copy()
    reach, grain = noise.border_px, noise.grain_px
    span = np.uint64(2 * reach + 1)
    frayed_below = np.uint64(noise.border_share * 65536.0)
    lost_below = np.uint64(noise.dropout * 4294967295.0)
    patch_key = random_word(key, -2)
    patch_of, grain_of = np.arange(width) // noise.patch_px, np.arange(width) // grain
    lost = np.zeros(patch_of[-1] + 1, np.bool_)
    down, right = np.zeros(grain_of[-1] + 1, np.int64), np.zeros(grain_of[-1] + 1, np.int64)
    for row in range(height):
        if row % noise.patch_px == 0:
            for k in range(len(lost)):
                lost[k] = random_word(patch_key, row * width + k) >> S32 < lost_below
        if row % grain == 0:
            for k in range(len(down)):
                bits = random_word(key, row * width + k)
                frayed = np.int64(bits & LOW16 < frayed_below)
                down[k] = frayed * (np.int64((bits >> S32 & LOW16) * span >> S16) - reach)
                right[k] = frayed * (np.int64((bits >> S16 & LOW16) * span >> S16) - reach)
        for i in range(width):
            k = grain_of[i]
            seen = source[
                min(max(row + down[k], 0), height - 1), min(max(i + right[k], 0), width - 1)
            ]
            class_id[row, i] = VOID_ID if lost[patch_of[i]] else seen


@compile_fast_kernel
def _disturb_colours(rgb: U8, key: np.uint64, sigma: float, table: F32) -> None:
    """Add normal noise of `sigma` steps of 255 to each colour of a picture (H, W, 3), in place."""
    height, width, _ = rgb.shape
    scale = np.float32(sigma)
    for row in range(height):
        for i in range(width):
            # One word of 64 bits has 21 for each of the three colours.
            bits = random_word(key, row * width + i)
            for k in range(3):
                value = np.float32(rgb[row, i, k]) + scale * random_normal(
                    (bits & LOW21) << S11, table
                )
                rgb[row, i, k] = np.uint8(
                    min(max(value, np.float32(0.0)), np.float32(255.0)) + HALF
                )
                bits >>= np.uint64(21)

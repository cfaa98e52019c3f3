"""Errors about whole things, which last: actors missed, taken for others or false, borders, stereo.

No state is held between pictures. Each thing that errs has its own key, and under it a word for
each tick (or slot of time). A walk back to the word that decides gives the same state in any order
of pictures, for any number of threads, and in a replay. The rates of each level and their sources
are in `object_noise.toml`.
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wcsim.core.jit import compile_fast_kernel
from wcsim.core.reading import read_module_toml
from wcsim.physics.buffers import Images
from wcsim.physics.renderer.base import Pinhole
from wcsim.physics.renderer.instances import Instances
from wcsim.physics.renderer.kernels import U32Array
from wcsim.physics.sensors.pixel_noise import (
    LOW32,
    S32,
    child,
    normal_quantiles,
    random_normal,
    random_word,
)
from wcsim.types import F32, F64, I32, U8, Bool, ClassId

CLASSES, NAMES, MISSED = 40, 4, 255
VOID_ID, PERSON_ID = int(ClassId.VOID), int(ClassId.PERSON)
WORDS = 4294967296.0  # of 32 bits
LONGEST = 4096  # ticks to walk back: by then nearly everything has been drawn again
STATED_PX, STATED_WIDTH_PX = 320 * 240, 320
AHEAD_M = 0.5  # what is nearer by so much hides; the ground before a person's feet does not
SQUARE_M = 4.0  # one false person at a time stands in one
FALSE_HALF_M, FALSE_TALL_M = 0.25, 1.7
# Of a cell: borders of cells lie off round coordinates, where ground, kerbs and walls often are.
OFF = 1.0 / 3.0
_STANDING = (ClassId.POLE, ClassId.KERB, ClassId.LOWERED_KERB)
_FLAT = (
    ClassId.GROUND,
    ClassId.ROAD,
    ClassId.SIDEWALK,
    ClassId.PARKING,
    ClassId.RAIL_TRACK,
    ClassId.TERRAIN,
    *_STANDING[1:],
    ClassId.CROSSWALK,
)


class _Law(NamedTuple):
    """A level's rates for one camera, as the kernels take them; see `object_noise.toml`."""

    # (CLASSES,) share of the time that a whole and near thing has a wrong name; 0: never
    wrong: F64
    upto: F64  # (CLASSES, NAMES) shares of that time by name, added up
    names: U8  # (CLASSES, NAMES) those names, MISSED for none
    stands: Bool  # (CLASSES,) what errs by its place in the world; the others err by actor
    flat: Bool  # (CLASSES,) what lies on the ground, whose borders wander
    leaves: float  # chance of a tick to end an error
    tick_s: float
    focal_px: float
    range_m: float
    whole_px: float
    hidden: float
    whole_m: float
    piece_m: float
    false_chance: float  # that a false person stands in a square in a slot of time
    false_least_s: float
    false_most_s: float
    false_near_m: float
    false_far_m: float
    border_px: float
    border_grid_px: int
    border_s: float
    stereo_share: float
    patch_m: float
    patch_s: float
    invented: float
    invented_by: float
    block_px: int  # pixels that wander and fail together


class ObjectNoise:
    """The errors of one camera about whole things."""

    def __init__(self, level: str, camera: Pinhole, tick_s: float) -> None:
        """`level` is one of `good`, `usual` and `poor`; a tick lasts `tick_s`."""
        rates = object_rates()["law"] | object_rates()[level]

        # 1. The names that are wrong, by class.
        wrong = np.zeros(CLASSES)
        upto = np.ones((CLASSES, NAMES))
        names = np.zeros((CLASSES, NAMES), np.uint8)
        for name, row in rates["wrong"].items():
            c, shares = ClassId[name], np.array(list(row.values()))
            wrong[c] = shares.sum()
            # The last one reaches to the end.
            upto[c, : len(shares) - 1] = (np.cumsum(shares) / shares.sum())[:-1]
            names[c, : len(row)] = [MISSED if each == "missed" else ClassId[each] for each in row]

        # 2. The rates, for this camera.
        least_s, most_s = rates["false_least_s"], rates["false_most_s"]
        people = rates["false_100_m2"] / 100.0 * SQUARE_M**2
        scale = camera.width_px / STATED_WIDTH_PX
        known = rates | {
            "wrong": wrong,
            "upto": upto,
            "names": names,
            "stands": np.isin(np.arange(CLASSES), _STANDING),
            "flat": np.isin(np.arange(CLASSES), _FLAT),
            "leaves": min(1.0, tick_s / rates["wrong_s"]),
            "tick_s": tick_s,
            "focal_px": camera.focal_px,
            "range_m": camera.range_m,
            "whole_m": camera.focal_px / scale / rates["whole_px_m"],
            "false_chance": people * 2.0 * most_s / (least_s + most_s),
            "border_px": rates["border_px"] * scale,
            "border_grid_px": max(1, round(rates["border_grid_px"] * scale)),
            "block_px": max(1, round(4 * scale)),
        }
        self._law = _Law(**{name: known[name] for name in _Law._fields})

    def lay_over(
        self,
        images: Images,
        instance: I32,
        T_CW: F64,
        rows: Instances,
        tick: int,
        ground_m: float,
        key: int,
    ) -> None:
        """Err about a true picture, in place: first its classes, then its depth; colours stay.

        Args:
            images: the picture.
            instance: (H, W) the row of the instance that each pixel shows, -1 for none.
            T_CW: (3, 4) world to camera frame.
            rows: those instances.
            tick: of the picture.
            ground_m: height in W of the ground on which a false person stands.
            key: 64 bits, the same for all pictures of a camera.
        """
        _err(
            images.class_id,
            images.depth_m,
            instance,
            T_CW,
            rows.colour_seed,
            tick,
            ground_m,
            np.array([child(key, part) for part in range(5)], np.uint64),
            self._law,
            normal_quantiles(),
        )


@cache
def object_rates() -> dict[str, Any]:
    """`object_noise.toml`: what all levels share as `law`, and each level by its name."""
    return read_module_toml(__file__)


@compile_fast_kernel
def _share(key: np.uint64, number: int) -> float:
    """A number from 0 to 1 of a key."""
    return np.float64(random_word(key, number) >> S32) / WORDS


@compile_fast_kernel
def _cell_key(key: np.uint64, x: float, y: float, z: float) -> np.uint64:
    """The key of the cell of the world in which a point is; cells have edges of 1."""
    column, row, level = int(np.floor(x + OFF)), int(np.floor(y + OFF)), int(np.floor(z + OFF))
    column, row, level = column & 0x1FFFFF, row & 0x1FFFFF, level & 0x1FFFFF
    return random_word(key, column << 42 | row << 21 | level)


@compile_fast_kernel
def _name_of(key: np.uint64, tick: int, c: int, factor: float, law: _Law) -> int:
    """The name of a thing of class c in this tick; `factor` multiplies the odds of a wrong one.

    In each tick a word is drawn anew with a chance r, else it stays; a walk back leads to the last
    one drawn. It names wrong if it lies below the share s that the odds give. So right and wrong
    are the two states of a Markov chain, and an error lasts 1 / (r (1 - s)) ticks in the mean. r
    makes that `wrong_s` at factor 1. It does not depend on the factor: one that changes ends an
    error only where s passes the word. Small and hidden things err for longer.
    """
    odds = factor * law.wrong[c] / (1.0 - law.wrong[c])
    share = odds / (1.0 + odds)
    named_below = np.uint64(min(1.0, law.leaves / (1.0 - law.wrong[c])) * WORDS)
    bits = np.uint64(0)
    for back in range(LONGEST):
        bits = random_word(key, tick - back)
        if bits >> S32 < named_below:
            break
    # The lower half of a word gives the name. The upper half, which says whether the word was drawn
    # in this tick, has nothing to do with it.
    drawn = np.float64(bits & LOW32) / WORDS
    if drawn >= share:
        return c
    k = 0
    while drawn >= share * law.upto[c, k]:
        k += 1
    return int(law.names[c, k])


@compile_fast_kernel
def _names(
    instance: I32, depth_m: F32, seeds: U32Array, key: np.uint64, tick: int, law: _Law
) -> U8:
    """Names (n, CLASSES) of each actor's pixels, by class; only of those in the picture (H, W)."""
    height, width = instance.shape
    counts, outline, covered = np.zeros((3, len(seeds)))
    for row in range(height):
        for i in range(width):
            k = instance[row, i]
            if k < 0:
                continue
            counts[k] += 1.0
            for r, c in ((row - 1, i), (row + 1, i), (row, i - 1), (row, i + 1)):
                if 0 <= r < height and 0 <= c < width and instance[r, c] != k:
                    outline[k] += 1.0
                    covered[k] += depth_m[r, c] < depth_m[row, i] - AHEAD_M
    names = np.empty((len(seeds), CLASSES), np.uint8)
    for k in np.flatnonzero(counts):
        few = max(1.0, law.whole_px * instance.size / (STATED_PX * counts[k]))
        factor = few * np.exp(law.hidden * covered[k] / max(1.0, outline[k]))
        own = random_word(key, int(seeds[k]))
        for c in range(CLASSES):
            names[k, c] = _name_of(own, tick, c, factor, law) if law.wrong[c] > 0.0 else c
    return names


@compile_fast_kernel
def _err(
    class_id: U8,
    depth_m: F32,
    instance: I32,
    T_CW: F64,
    seeds: U32Array,
    tick: int,
    ground_m: float,
    keys: npt.NDArray[np.uint64],
    law: _Law,
    table: F32,
) -> None:
    """Lay all errors over a picture.

    The keys (5,) are those of actors, of what stands, of what is false, of borders, of stereo.
    """
    now_s = tick * law.tick_s
    names = _names(instance, depth_m, seeds, keys[0], tick, law)
    _rename(class_id, depth_m, instance, names, T_CW, keys[1], tick, law)
    _add_false(class_id, depth_m, T_CW, ground_m, keys[2], now_s, law)
    _wander(class_id, keys[3], now_s / law.border_s, law, table)
    _fail_stereo(depth_m, T_CW, keys[4], now_s / law.patch_s, law)


@compile_fast_kernel
def _in_world(T_CW: F64, u: float, v: float, z: float) -> tuple[float, float, float]:
    """Where in W is what is seen at depth z in the direction (u, v, 1) of the camera frame."""
    x, y, z = z * u - T_CW[0, 3], z * v - T_CW[1, 3], z - T_CW[2, 3]
    R = T_CW
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@compile_fast_kernel
def _rename(
    class_id: U8,
    depth_m: F32,
    instance: I32,
    names: U8,
    T_CW: F64,
    key: np.uint64,
    tick: int,
    law: _Law,
) -> None:
    """Give pixels the names of their actors, or of their piece of a kerb, or of their pole."""
    height, width = class_id.shape
    for row in range(height):
        v = (row + 0.5 - 0.5 * height) / law.focal_px
        missed, old, old_name = False, np.uint64(0), 0
        for i in range(width):
            c = int(class_id[row, i])
            if law.wrong[c] == 0.0:
                continue
            name = c
            if law.stands[c]:
                z = float(depth_m[row, i])
                x_m, y_m, _ = _in_world(T_CW, (i + 0.5 - 0.5 * width) / law.focal_px, v, z)
                piece = _cell_key(key, x_m / law.piece_m, y_m / law.piece_m, float(c))
                if piece != old:
                    factor = max(1.0, (z / law.whole_m) ** 2)
                    old, old_name = piece, _name_of(piece, tick, c, factor, law)
                name = old_name
            elif instance[row, i] >= 0:
                name = int(names[instance[row, i], c])
            class_id[row, i] = name
            missed |= name == MISSED
        if missed:
            _see_through(class_id[row], depth_m[row])


@compile_fast_kernel
def _see_through(class_id: U8, depth_m: F32) -> None:
    """Give what is missed in a row (W,) the class of its farther neighbour; none without one."""
    width, start = len(class_id), 0
    while start < width:
        if class_id[start] != MISSED:
            start += 1
            continue
        end = start
        while end < width and class_id[end] == MISSED:
            end += 1
        behind, behind_m = VOID_ID, np.float32(-1.0)
        if start > 0:
            behind, behind_m = int(class_id[start - 1]), depth_m[start - 1]
        if end < width and depth_m[end] > behind_m:
            behind = int(class_id[end])
        class_id[start:end] = behind
        start = end


@compile_fast_kernel
def _add_false(
    class_id: U8,
    depth_m: F32,
    T_CW: F64,
    ground_m: float,
    key: np.uint64,
    now_s: float,
    law: _Law,
) -> None:
    """Name pixels of people that are not there; space is cut into squares, time into slots."""
    reach = int(np.ceil(law.false_far_m / SQUARE_M))
    east_m, north_m, _ = _in_world(T_CW, 0.0, 0.0, 0.0)
    east, north = int(np.floor(east_m / SQUARE_M)), int(np.floor(north_m / SQUARE_M))
    for x in range(east - reach, east + reach + 1):
        for y in range(north - reach, north + reach + 1):
            # Each square has slots of its own: people do not all come and go at once.
            square = _cell_key(key, float(x), float(y), 0.0)
            slots = now_s / law.false_most_s + np.float64(square >> S32) / WORDS
            own = random_word(square, int(np.floor(slots)))
            lasts_s = law.false_least_s + (law.false_most_s - law.false_least_s) * _share(own, 0)
            # Somewhere within the slot, so that no other slot has to be known.
            since_s = law.false_most_s * (slots - np.floor(slots))
            age_s = since_s - (law.false_most_s - lasts_s) * _share(own, 1)
            if np.float64(own >> S32) < law.false_chance * WORDS and 0.0 <= age_s < lasts_s:
                p_C_m = T_CW[:, 3] + T_CW[:, 2] * (ground_m + 0.5 * FALSE_TALL_M)
                p_C_m += SQUARE_M * (
                    T_CW[:, 0] * (x + _share(own, 2)) + T_CW[:, 1] * (y + _share(own, 3))
                )
                _draw_false(class_id, depth_m, p_C_m, law)


@compile_fast_kernel
def _draw_false(class_id: U8, depth_m: F32, p_C_m: F64, law: _Law) -> None:
    """Name the pixels of an ellipse round a point (3,) of the camera frame that nothing hides."""
    height, width = class_id.shape
    x, y, z = p_C_m
    if z <= 0.0 or not law.false_near_m < np.hypot(x, z) < law.false_far_m:
        return
    u, v = 0.5 * width + law.focal_px * x / z, 0.5 * height + law.focal_px * y / z
    across, down = law.focal_px * FALSE_HALF_M / z, 0.5 * law.focal_px * FALSE_TALL_M / z
    for row in range(max(0, int(v - down)), min(height, int(v + down) + 1)):
        for i in range(max(0, int(u - across)), min(width, int(u + across) + 1)):
            inside = ((i + 0.5 - u) / across) ** 2 + ((row + 0.5 - v) / down) ** 2 < 1.0
            if inside and depth_m[row, i] > z - AHEAD_M:
                class_id[row, i] = PERSON_ID


@compile_fast_kernel
def _wander(class_id: U8, key: np.uint64, now: float, law: _Law, table: F32) -> None:
    """Shift borders on the ground by an offset that changes slowly over picture and time.

    `now` is in units of `border_s`. The outline of what stands on the ground stays: a shift of
    whole pixels would swallow people that are far away.
    """
    height, width = class_id.shape
    source, flat, block, grid = class_id.copy(), law.flat, law.block_px, law.border_grid_px
    then = int(np.floor(now))
    # A quarter of a circle from one knot to the next: the variance is the same at each time.
    turn = 0.5 * np.pi * (now - then)
    before, after = law.border_px * np.cos(turn), law.border_px * np.sin(turn)
    knots = np.empty((height // grid + 2, width // grid + 2, 2))
    old, new = random_word(key, then), random_word(key, then + 1)
    for at in range(knots.size):
        was, becomes = random_word(old, at) >> S32, random_word(new, at) >> S32
        knots.flat[at] = before * random_normal(was, table) + after * random_normal(becomes, table)
    # Here, and once: a root for each block would cost a third of it all.
    a = np.arange(0, width, block) % grid / grid
    here, there = (1.0 - a) / np.hypot(1.0 - a, a), a / np.hypot(1.0 - a, a)
    for top in range(0, height, block):
        row, b = top // grid, (top % grid) / grid
        # Over the root of the squared weights: the offset has the same variance between knots.
        near = ((1.0 - b) * knots[row] + b * knots[row + 1]) / np.hypot(1.0 - b, b)
        for left in range(0, width, block):
            column, k = left // grid, left // block
            down = int(np.rint(here[k] * near[column, 0] + there[k] * near[column + 1, 0]))
            right = int(np.rint(here[k] * near[column, 1] + there[k] * near[column + 1, 1]))
            if down == 0 and right == 0:
                continue
            for r in range(top, min(top + block, height)):
                of = min(max(r + down, 0), height - 1)
                for i in range(left, min(left + block, width)):
                    if not flat[class_id[r, i]]:
                        continue
                    name = source[of, min(max(i + right, 0), width - 1)]
                    if flat[name]:
                        class_id[r, i] = name


@compile_fast_kernel
def _fail_stereo(depth_m: F32, T_CW: F64, key: np.uint64, now: float, law: _Law) -> None:
    """Lose or invent surfaces in some cubes of the world, each for `patch_s`, the unit of `now`."""
    height, width = depth_m.shape
    block = law.block_px
    below = np.uint64(law.stereo_share * WORDS)
    old, fails, factor = np.uint64(0), False, np.float32(0.0)
    for top in range(0, height, block):
        v = (top + 0.5 * block - 0.5 * height) / law.focal_px
        for left in range(0, width, block):
            z = float(depth_m[min(top + block // 2, height - 1), min(left + block // 2, width - 1)])
            if z <= 0.0 or z >= law.range_m:
                continue
            x_m, y_m, z_m = _in_world(T_CW, (left + 0.5 * block - 0.5 * width) / law.focal_px, v, z)
            cube = _cell_key(key, x_m / law.patch_m, y_m / law.patch_m, z_m / law.patch_m)
            if cube != old:
                # Each cube has a slot of time of its own: they do not all change at once.
                own = random_word(cube, int(np.floor(now + np.float64(cube >> S32) / WORDS)))
                old, fails, factor = cube, bool(own >> S32 < below), np.float32(0.0)
                if fails and _share(own, 0) < law.invented:
                    factor = np.float32(1.0 + law.invented_by * (2.0 * _share(own, 1) - 1.0))
            if fails:
                for row in range(top, min(top + block, height)):
                    for i in range(left, min(left + block, width)):
                        depth_m[row, i] = min(depth_m[row, i] * factor, np.float32(law.range_m))

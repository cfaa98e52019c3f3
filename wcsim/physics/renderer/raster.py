"""The default renderer: a span rasteriser on the CPU, with colours on demand.

Its first pass draws depth and class. Its second turns face numbers and depth into shaded,
patterned, hazy colours, or into rows of instances. No kernel here is called by a kernel of another
module, see `kernels`.
"""

import numpy as np

from wcsim.core.jit import compile_fast_kernel
from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer.base import Pinhole, check_images
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances, actor_instances
from wcsim.physics.renderer.kernels import (
    COLOURED,
    GRASS,
    OUT,
    PLAIN,
    SKY_ID,
    SLABS,
    STRIPES,
    WINDOWS,
    StreetArrays,
    Target,
    U32Array,
    View,
    cull,
    draw,
    draw_chunk,
)
from wcsim.physics.renderer.models.catalog import actor_templates
from wcsim.physics.renderer.models.paint import AMBIENT, DIFFUSE, HORIZON_RGB, SUN_W, ZENITH_RGB
from wcsim.types import F32, F64, I32, U8, Bool
from wcsim.types.street import join_meshes

# All is float32, for speed. Windows are in storeys of 3.2 m; the widths of stripes and bays are in
# the frame of a face.
HALF = np.float32(0.5)
PER_STOREY = np.float32(1 / 3.2)
WINDOW_HALF, WINDOW_MIDDLE = np.float32(0.225), np.float32(0.53)
SKY_STEPS = 255
SKY_GROWTH = np.float32(1.8 * SKY_STEPS)
CLEAR = np.float32(0.2)  # share of the range from which on there is haze, up to 160/256 at its end
HAZE_GROWTH = np.float32(160.0 / 0.64)
FULL, EVEN, LOW, HIGH = np.uint32(256), np.uint32(0xFF00FF), np.uint32(0xFF), np.uint32(0xFF00)
BYTE, TWO_BYTES = np.uint32(8), np.uint32(16)
NO_WORD = np.uint32(0)
STRIPE_WORD = np.uint32(0xE8ECEC)  # blue, green, red from the highest byte down
WINDOW_WORD = np.uint32(0x6C5C4E)
# The ground: slabs of 60 cm, patches of 6 cm and 1.7 m in asphalt, 30 cm and 1 m in grass.
PER_SLAB, JOINT = np.float32(1 / 0.6), np.float32(0.012)
JOINT_GROWTH, NEAR_GROUND = np.float32(0.0016), np.float32(0.04)
ASPHALT_FINE, ASPHALT_COARSE, NO_FINE_M = np.float32(16.0), np.float32(0.6), np.float32(12.0)
GRASS_FINE, GRASS_COARSE = np.float32(3.3), np.float32(1.0)
SHADOW_M, SHADOWS_M, FOOT_M, DARKEST = 0.18, 40.0, 0.2, 0.42
FOOT_OF_WALL_M, NO_M = np.float32(0.7), np.float32(0.0)


class RasterRenderer:
    """Draws a `GeometryStore` with the compiled kernels, which release the GIL.

    It holds nothing between pictures, so it may draw from several threads at once, into buffers of
    their own.
    """

    def __init__(self, store: GeometryStore, cull: bool = True) -> None:
        """`cull=False` draws what is out of view too; it is for tests."""
        self._cull = cull
        self._street = store.arrays
        self._marks = (store.marks or GeometryStore(join_meshes(()))).arrays
        self._models = actor_templates()
        self._light = np.array([AMBIENT, DIFFUSE, *HORIZON_RGB, *ZENITH_RGB])

    def render(
        self,
        camera: Pinhole,
        T_CW: F64,
        instances: Instances,
        out: Images,
        shown: Bool | None = None,
    ) -> None:
        """Draw into `out`; see `Renderer.render`."""
        check_images(camera, out)
        # 1. What is drawn, and from where.
        wordless = out.rgb is None and out.instance is None
        words = np.empty((0, 0) if wordless else out.class_id.shape, np.uint32)
        target = Target(out.depth_m, out.class_id, words)
        T_CW = np.ascontiguousarray(T_CW, np.float64)
        view = View(
            T_CW=T_CW,
            focal_px=float(camera.focal_px),
            near_m=float(camera.near_m),
            range_m=float(camera.range_m),
            sun_C=T_CW[:, :3] @ SUN_W,
            light=self._light,
        )
        actors = instances.placed
        if shown is None:
            shown = np.ones(len(instances), np.bool_)

        # 2. Depth and class. A word holds a row or a colour: for both, all is drawn twice.
        if out.instance is not None:
            draw(self._street, self._models, actors, shown, view, self._cull, True, target)
            _write_instances(words, out.class_id, out.instance)
        if out.instance is None or out.rgb is not None:
            draw(self._street, self._models, actors, shown, view, self._cull, False, target)
        if out.rgb is None:
            return

        # 3. Colours, by the camera's pose in W: a rotation's inverse is its transpose, which is
        # exact and needs no solver.
        _draw_marks(self._marks, view, target)
        T_WC, R_WC = np.empty((3, 4)), T_CW[:, :3].T
        T_WC[:, :3] = R_WC
        T_WC[:, 3] = -R_WC @ T_CW[:, 3]
        _colour(self._street, view, T_WC, out.depth_m, words, out.rgb)
        _stand(actors.T_WM, shown, view, T_WC, out.depth_m, words, out.rgb)


def warm_up(renderer: RasterRenderer) -> None:
    """Compile the kernels now (seconds on a fresh machine) instead of at the first picture."""
    camera = Pinhole(width_px=16, height_px=12, focal_px=8.0, near_m=0.1, range_m=40.0)
    T_CW = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    renderer.render(camera, T_CW, actor_instances(()), new_images(16, 12, rgb=True, instance=True))


@compile_fast_kernel
def brighten(rgb: U8, table: U8) -> None:
    """Replace each colour value of a picture (H, W, 3) by that of the table (256,), in place."""
    height, width, _ = rgb.shape
    for row in range(height):
        for i in range(width):
            for k in range(3):
                rgb[row, i, k] = table[rgb[row, i, k]]


@compile_fast_kernel
def _draw_marks(marks: StreetArrays, view: View, out: Target) -> None:
    """Put the colours of marks on the ground into a picture's words; depth and classes stay."""
    height, width = out.inverse_z.shape
    depth = np.zeros(len(marks.spheres), np.float32)
    cull(marks.spheres, view, width, height, depth)
    if not np.any(depth > OUT):
        return
    size = 1
    for chunk in range(len(depth)):
        size = max(size, marks.chunk_vertices[chunk + 1] - marks.chunk_vertices[chunk])
    p, screen = np.empty((size, 3), np.float32), np.empty((3, size))
    # Copies of depth and classes are tested and written: marks change colours alone.
    beside = Target(np.float32(1.0) / out.inverse_z, np.empty_like(out.class_id), out.words)
    for chunk in range(len(depth)):
        if depth[chunk] > OUT:
            draw_chunk(marks, chunk, True, view, p, screen, beside)


@compile_fast_kernel
def _overlay(street: StreetArrays, face: int, x: float, y: float, z: float) -> np.uint32:
    """The colour word that a face's pattern puts over its own colour at a point of W, or 0."""
    bay = x * street.frame[face, 0] + y * street.frame[face, 1] - street.frame[face, 2]
    if street.pattern[face] == STRIPES:
        return STRIPE_WORD if bay - np.floor(bay) < HALF else NO_WORD
    storey = (z - street.frame[face, 3]) * PER_STOREY
    beside = abs(bay - np.floor(bay) - HALF)
    above = abs(storey - np.floor(storey) - WINDOW_MIDDLE)
    return WINDOW_WORD if beside < WINDOW_HALF and above < WINDOW_HALF else NO_WORD


@compile_fast_kernel
def _dice(i: int, j: int) -> np.float32:
    """A number from 0 to 1 for a cell of the ground, the same each time."""
    n = (i * 374761393 + j * 668265263) & 0xFFFFFFFF
    n = ((n ^ n >> 13) * 1274126177) & 0xFFFFFFFF
    return np.float32(n >> 16) * np.float32(1.0 / 65535.0)


@compile_fast_kernel
def _grain(pattern: int, x: np.float32, y: np.float32, far_m: np.float32) -> np.uint32:
    """Brightness of the ground at a point of W, in 256ths: slabs with joints, or patches.

    All fades with the distance.
    """
    near = np.float32(1.0) - min(far_m * NEAR_GROUND, np.float32(0.85))
    if pattern == SLABS:
        across = y * PER_SLAB
        line = np.floor(across)
        along = x * PER_SLAB + (HALF if int(line) & 1 else np.float32(0.0))
        slab = np.floor(along)
        edge = max(abs(along - slab - HALF), abs(across - line - HALF))
        if edge > HALF - (JOINT + far_m * JOINT_GROWTH):
            return np.uint32(256.0 - 62.0 * near)
        return np.uint32(
            248.0 + 8.0 * near * (np.float32(2.0) * _dice(int(slab), int(line)) - np.float32(1.0))
        )
    fine, coarse = ASPHALT_FINE, ASPHALT_COARSE
    if pattern == GRASS:
        fine, coarse = GRASS_FINE, GRASS_COARSE
    patch = _dice(int(np.floor(x * coarse)), int(np.floor(y * coarse)))
    if far_m < NO_FINE_M:
        patch = HALF * (patch + _dice(int(np.floor(x * fine)), int(np.floor(y * fine))))
    return np.uint32(240.0 + 16.0 * (patch * (np.float32(2.0) * near) + np.float32(1.0) - near))


@compile_fast_kernel
def _dimmed(word: np.uint32, share: np.uint32) -> np.uint32:
    """A colour word, so bright in 256ths."""
    even = (word & EVEN) * share >> BYTE & EVEN  # red and blue at once
    return even | (word >> BYTE & LOW) * share & HIGH


@compile_fast_kernel
def _stand(
    T_WM: F64, shown: Bool, view: View, T_WC: F64, depth_m: F32, words: U32Array, rgb: U8
) -> None:
    """Soft shadows on the ground under all that stands on it: darker towards the middle."""
    height, width = depth_m.shape
    T, f = view.T_CW, view.focal_px
    for i in range(len(T_WM)):
        M = T_WM[i]
        long = np.sqrt(M[0, 0] ** 2 + M[1, 0] ** 2) + 1e-6
        wide = np.sqrt(M[0, 1] ** 2 + M[1, 1] ** 2) + 1e-6
        at = T[2, 0] * M[0, 3] + T[2, 1] * M[1, 3] + T[2, 2] * M[2, 3] + T[2, 3]
        reach = 0.5 * long + 0.5 * wide + SHADOW_M
        if not shown[i] or at - reach < view.near_m or at > SHADOWS_M:
            continue
        x_C = T[0, 0] * M[0, 3] + T[0, 1] * M[1, 3] + T[0, 2] * M[2, 3] + T[0, 3]
        u = 0.5 * width + f * x_C / at
        y_C = T[1, 0] * M[0, 3] + T[1, 1] * M[1, 3] + T[1, 2] * M[2, 3] + T[1, 3]
        v = 0.5 * height + f * y_C / at
        aside = f * reach / (at - reach)
        for row in range(max(0, int(v - aside)), min(height, int(v + aside) + 1)):
            for column in range(max(0, int(u - aside)), min(width, int(u + aside) + 1)):
                if words[row, column] & COLOURED:
                    continue
                z = depth_m[row, column]
                right = z * (column + 0.5 - 0.5 * width) / f
                down = z * (row + 0.5 - 0.5 * height) / f
                dz = T_WC[2, 3] + T_WC[2, 0] * right + T_WC[2, 1] * down + T_WC[2, 2] * z - M[2, 3]
                if abs(dz) > FOOT_M:
                    continue
                dx = T_WC[0, 3] + T_WC[0, 0] * right + T_WC[0, 1] * down + T_WC[0, 2] * z - M[0, 3]
                dy = T_WC[1, 3] + T_WC[1, 0] * right + T_WC[1, 1] * down + T_WC[1, 2] * z - M[1, 3]
                along = (dx * M[0, 0] + dy * M[1, 0]) / (long * (0.5 * long + SHADOW_M))
                across = (dx * M[0, 1] + dy * M[1, 1]) / (wide * (0.5 * wide + SHADOW_M))
                q = along * along + across * across
                if q < 1.0:
                    light = DARKEST + (1.0 - DARKEST) * q * q
                    for k in range(3):
                        rgb[row, column, k] = np.uint8(rgb[row, column, k] * light)


@compile_fast_kernel
def _sky_ramp(view: View) -> U8:
    """Colours (SKY_STEPS + 1, 3) of the sky from the horizon up."""
    ramp = np.empty((SKY_STEPS + 1, 3), np.uint8)
    for i in range(SKY_STEPS + 1):
        for k in range(3):
            horizon, zenith = view.light[2 + k], view.light[5 + k]
            ramp[i, k] = np.uint8(horizon + i * (zenith - horizon) / SKY_STEPS)
    return ramp


@compile_fast_kernel
def _colour(
    street: StreetArrays, view: View, T_WC: F64, depth_m: F32, words: U32Array, rgb: U8
) -> None:
    """Write the shaded picture (H, W, 3) from words and depth: street, actors, haze, sky."""
    height, width = depth_m.shape
    far, limit = np.float32(view.range_m), np.float32(1.0 / view.range_m)
    left, step = np.float32(0.5 - 0.5 * width), np.float32(1.0 / view.focal_px)
    clear_m = CLEAR * far
    fog_even = np.uint32(int(view.light[2]) | int(view.light[4]) << 16)
    fog_green = np.uint32(view.light[3])
    T = T_WC.astype(np.float32)
    ramp = _sky_ramp(view)
    for row in range(height):
        v = np.float32((row + 0.5 - 0.5 * height) / view.focal_px)
        ray_x, ray_y, ray_z = T[0, 1] * v + T[0, 2], T[1, 1] * v + T[1, 2], T[2, 1] * v + T[2, 2]
        for i in range(width):
            u = (np.float32(i) + left) * step
            z = depth_m[row, i]
            if z >= far:
                rise = min(max(int(SKY_GROWTH * (T[2, 0] * u + ray_z)), 0), SKY_STEPS)
                rgb[row, i, 0] = ramp[rise, 0]
                rgb[row, i, 1] = ramp[rise, 1]
                rgb[row, i, 2] = ramp[rise, 2]
                continue
            word = words[row, i]
            if not word & COLOURED:
                face, word = word, street.rgb[word]
                if street.pattern[face] != PLAIN:
                    x, y = T[0, 3] + z * (T[0, 0] * u + ray_x), T[1, 3] + z * (T[1, 0] * u + ray_y)
                    if street.pattern[face] >= SLABS:
                        word = _dimmed(word, _grain(street.pattern[face], x, y, z))
                    else:
                        height_m = T[2, 3] + z * (T[2, 0] * u + ray_z)
                        word = _overlay(street, face, x, y, height_m) or word
                        above = height_m - street.frame[face, 3]
                        if street.pattern[face] == WINDOWS and above < FOOT_OF_WALL_M:
                            word = _dimmed(
                                word, np.uint32(176.0 + 80.0 * max(above, NO_M) / FOOT_OF_WALL_M)
                            )
            if z > clear_m:
                share = z * limit - CLEAR
                haze = np.uint32(HAZE_GROWTH * share * share)
                # Red and blue at once.
                even = ((word & EVEN) * (FULL - haze) + fog_even * haze) >> BYTE & EVEN
                green = ((word >> BYTE & LOW) * (FULL - haze) + fog_green * haze) & HIGH
                word = even | green
            rgb[row, i, 0] = word & LOW
            rgb[row, i, 1] = word >> BYTE & LOW
            rgb[row, i, 2] = word >> TWO_BYTES & LOW


@compile_fast_kernel
def _write_instances(words: U32Array, class_id: U8, instance: I32) -> None:
    """Write each pixel's row of an instance, -1 for street and sky, from a numbered picture."""
    height, width = words.shape
    for row in range(height):
        for i in range(width):
            word = words[row, i]
            shown = class_id[row, i] != SKY_ID and word & COLOURED
            instance[row, i] = np.int32(word ^ COLOURED) if shown else np.int32(-1)

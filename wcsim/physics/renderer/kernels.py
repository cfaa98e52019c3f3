"""The compiled code of the rasteriser: place models, cull, transform, clip, fill spans of 1/z.

Camera frame: x right, y down, z forward. While a picture is drawn the depth buffer holds 1/z, 0 for
nothing. The word buffer is there for some pictures only. A word is a face's number in the street,
or with bit 31 set a plain colour or, in a picture of instances, an actor's row.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wcsim.core.jit import compile_fast_kernel
from wcsim.types import F32, F64, I32, U8, Bool

U32Array = npt.NDArray[np.uint32]
Word = np.uint32 | int

COLOURED = np.uint32(0x80000000)
SKY_ID = np.uint8(23)
# Near to far only roughly: that saves writes, while the depth test decides what is seen.
BUCKETS = 256
OUT = np.float32(-1e30)  # the depth of what is out of view
PLAIN, STRIPES, WINDOWS, SLABS, ASPHALT, GRASS = range(6)  # patterns of the street's faces
# Numbers of `paint.Paint`.
TAILLIGHT, LEFT_LAMP, RIGHT_LAMP, SHINING, BRAKING, TURNING = 4, 19, 20, 22, 22, 23
# Bits of SUMO's vehicle signals that light them: 1 right, 2 left, 4 both, 8 brake.
LEFT_BITS, RIGHT_BITS, BRAKE_BIT = 6, 5, 8


class StreetArrays(NamedTuple):
    """The standing street; chunk c has faces `chunk_faces[c]:chunk_faces[c + 1]`, like vertices."""

    vertices: F32  # (V, 3) in W
    faces: I32  # (F, 3) indices from the chunk's first vertex on
    face_class: U8  # (F,) ClassId
    chunk_vertices: I32  # (C + 1,)
    chunk_faces: I32  # (C + 1,)
    spheres: F32  # (C, 4) x, y, z, radius: each chunk is inside
    rgb: U32Array  # (F,) colour with the sun's shading in it, red in the lowest byte
    pattern: U8  # (F,) PLAIN, STRIPES, WINDOWS, SLABS, ASPHALT or GRASS
    # (F, 4): a point's bay, a window or a pair of bars, is x f[0] + y f[1] - f[2]; f[3] is the
    # foot of the house.
    frame: F32


class ModelArrays(NamedTuple):
    """All models; template t has faces `faces_of[t]:faces_of[t + 1]`, likewise its vertices.

    A model fills x, y in [-0.5, 0.5] and z in [0, 1], x forward, so that scaling by `size_lwh_m`
    gives the actor's box. The hands and feet of a walking pedestrian reach out of it to front and
    rear.
    """

    vertices: F32  # (V, 3)
    # (T, 3) indices from the template's first vertex on, counter-clockwise seen from outside
    faces: I32
    face_class: U8  # (T,) ClassId
    face_paint: U8  # (T,) Paint
    vertices_of: I32  # (n + 1,)
    faces_of: I32  # (n + 1,)
    paints: F32  # (paints, variants, 3)


class InstanceArrays(NamedTuple):
    """The actors, see `Instances`, in their places."""

    template: I32
    T_WM: F64  # (n, 3, 4) unit model box to world
    balls: F32  # (n, 4) x, y, z of W, radius: all of each is inside
    colour_seed: U32Array
    lamps: I32  # (n,) SUMO's vehicle signals


class View(NamedTuple):
    """A camera."""

    T_CW: F64  # (3, 4)
    focal_px: float
    near_m: float
    range_m: float
    sun_C: F64  # (3,)
    light: F64  # (8,) ambient, diffuse, horizon rgb, zenith rgb


class Target(NamedTuple):
    """The buffers of one picture."""

    inverse_z: F32  # (H, W), becomes the depth
    class_id: U8  # (H, W)
    words: U32Array  # (H, W), or (0, 0) when neither colours nor instances are drawn


@compile_fast_kernel
def place_models(p_W_m: F64, yaw: F64, pitch: F64, roll: F64, scale: F64, T_WM: F64) -> None:
    """Unit model box to world: T_WM (n, 3, 4) = place . yaw . pitch (nose up) . roll . size."""
    for i in range(len(yaw)):
        cy, sy, cp, sp = np.cos(yaw[i]), np.sin(yaw[i]), np.cos(pitch[i]), np.sin(pitch[i])
        cr, sr = np.cos(roll[i]), np.sin(roll[i])
        T = T_WM[i]
        T[0, 0], T[0, 1], T[0, 2] = cy * cp, -cy * sp * sr - sy * cr, -cy * sp * cr + sy * sr
        T[1, 0], T[1, 1], T[1, 2] = sy * cp, -sy * sp * sr + cy * cr, -sy * sp * cr - cy * sr
        T[2, 0], T[2, 1], T[2, 2] = sp, cp * sr, cp * cr
        for row in range(3):
            for k in range(3):
                T[row, k] *= scale[i, k]
            T[row, 3] = p_W_m[i, row]


@compile_fast_kernel
def put_round(T_WM: F64, balls: F32) -> None:
    """Write balls (n, 4), x, y, z of W and radius, round the models placed by T_WM (n, 3, 4)."""
    for i in range(len(T_WM)):
        for row in range(3):
            balls[i, row] = T_WM[i, row, 3] + 0.5 * T_WM[i, row, 2]
        balls[i, 3] = _half_diagonal(T_WM[i])


@compile_fast_kernel
def draw(
    street: StreetArrays,
    models: ModelArrays,
    actors: InstanceArrays,
    shown: Bool,
    view: View,
    culling: bool,
    numbered: bool,
    out: Target,
) -> None:
    """Draw a picture with the actors that are `shown` (n,): depth, class, and words if buffered."""
    height, width = out.inverse_z.shape
    out.inverse_z[:] = 0.0
    out.class_id[:] = SKY_ID
    chunks, n = len(street.spheres), len(shown)
    order = np.empty(chunks + n, np.int32)
    count = _visible(street, actors, shown, view, width, height, culling, order)
    size = 1
    for k in range(count):
        i = order[k]
        if i < chunks:
            size = max(size, street.chunk_vertices[i + 1] - street.chunk_vertices[i])
        else:
            t = actors.template[i - chunks]
            size = max(size, models.vertices_of[t + 1] - models.vertices_of[t])
    # One workspace, large enough for everything in view: no memory is claimed while drawing.
    p, screen = np.empty((size, 3), np.float32), np.empty((3, size))
    T_CM = np.empty((3, 4))
    for k in range(count):
        i = order[k]
        if i < chunks:
            draw_chunk(street, i, False, view, p, screen, out)
            continue
        i -= chunks
        T = actors.T_WM[i]
        for row in range(3):
            for column in range(4):
                total = view.T_CW[row, 3] if column == 3 else 0.0
                for j in range(3):
                    total += view.T_CW[row, j] * T[j, column]
                T_CM[row, column] = total
        away = 0.0
        for row in range(3):
            away += (T_CM[row, 3] + 0.5 * T_CM[row, 2]) ** 2
        # From inside, or where the near plane cuts it open, a model's back faces can be seen, too.
        solid = np.sqrt(away) > _half_diagonal(T) + 2.0 * view.near_m
        seed, lamps = actors.colour_seed[i], actors.lamps[i]
        number = i if numbered else -1
        _draw_model(
            models, actors.template[i], seed, lamps, T_CM, solid, number, view, p, screen, out
        )
    _finish(view, out)


@compile_fast_kernel
def draw_chunk(
    street: StreetArrays, chunk: int, plain: bool, view: View, p: F32, screen: F64, out: Target
) -> None:
    """Draw one chunk of the street; its words are its faces, or with `plain` their colours.

    Here and in `_draw_model` only triangles on the screen are filled: a call with arrays costs more
    than the test.
    """
    height, width = out.inverse_z.shape
    first, end = street.chunk_vertices[chunk], street.chunk_vertices[chunk + 1]
    _to_camera(street.vertices, first, end, view.T_CW, p)
    _to_screen(p, end - first, view, width, height, screen)
    for face in range(street.chunk_faces[chunk], street.chunk_faces[chunk + 1]):
        a, b, c = street.faces[face, 0], street.faces[face, 1], street.faces[face, 2]
        az, bz, cz = p[a, 2], p[b, 2], p[c, 2]
        if min(az, bz, cz) > view.range_m or max(az, bz, cz) < view.near_m:
            continue
        word = int(COLOURED | street.rgb[face]) if plain else face
        if min(az, bz, cz) < view.near_m:
            _clip_and_fill(p, a, b, c, street.face_class[face], word, view, out)
            continue
        x0, y0 = screen[0, a], screen[1, a]
        x1, y1 = screen[0, b], screen[1, b]
        x2, y2 = screen[0, c], screen[1, c]
        if _on_screen(x0, y0, x1, y1, x2, y2, width, height):
            w0, w1, w2 = screen[2, a], screen[2, b], screen[2, c]
            _fill(x0, y0, w0, x1, y1, w1, x2, y2, w2, street.face_class[face], word, out)


@compile_fast_kernel
def cull(balls: F32, view: View, width: int, height: int, depth: F32) -> None:
    """Depth of each ball's middle (n, 4: x, y, z of W, radius); OUT for a ball all out of view."""
    t0, t1, t2, t3 = view.T_CW[2, 0], view.T_CW[2, 1], view.T_CW[2, 2], view.T_CW[2, 3]
    r0, r1, r2, r3 = view.T_CW[0, 0], view.T_CW[0, 1], view.T_CW[0, 2], view.T_CW[0, 3]
    d0, d1, d2, d3 = view.T_CW[1, 0], view.T_CW[1, 1], view.T_CW[1, 2], view.T_CW[1, 3]
    kx, ky = 0.5 * width / view.focal_px, 0.5 * height / view.focal_px
    # Lengths of the normals of the view's side planes: a product for a radius, no division.
    grow_x, grow_y = np.sqrt(1.0 + kx * kx), np.sqrt(1.0 + ky * ky)
    near, far = view.near_m, view.range_m
    for i in range(len(balls)):
        x, y, z, radius = balls[i, 0], balls[i, 1], balls[i, 2], balls[i, 3]
        ahead = t0 * x + t1 * y + t2 * z + t3
        depth[i] = OUT
        if ahead + radius < near or ahead - radius > far:
            continue
        right = abs(r0 * x + r1 * y + r2 * z + r3)
        down = abs(d0 * x + d1 * y + d2 * z + d3)
        if right - kx * ahead <= radius * grow_x and down - ky * ahead <= radius * grow_y:
            depth[i] = ahead


@compile_fast_kernel
def _half_diagonal(T: F64) -> float:
    """Half the diagonal of a box placed by T (3, 4), with room for a stride and for rounding."""
    total = 0.0
    for row in range(3):
        for k in range(3):
            total += T[row, k] * T[row, k]
    return float(0.54 * np.sqrt(total) + 1e-3)


@compile_fast_kernel
def _fill(
    x0: float, y0: float, w0: float,
    x1: float, y1: float, w1: float,
    x2: float, y2: float, w2: float,
    class_id: int, word: Word, out: Target,
) -> None:  # fmt: skip
    """Fill the pixels whose centres lie in a screen triangle; w = 1/z at its corners."""
    height, width = out.inverse_z.shape
    if not _on_screen(x0, y0, x1, y1, x2, y2, width, height):
        return
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    # A triangle seen edge-on covers no pixel, and its slopes would be infinite.
    if abs(area) < 1e-12:
        return
    # On the screen 1/z is linear, which z is not: it is stepped along a span by additions.
    slope_x = ((w1 - w0) * (y2 - y0) - (w2 - w0) * (y1 - y0)) / area
    slope_y = ((w2 - w0) * (x1 - x0) - (w1 - w0) * (x2 - x0)) / area
    origin = w0 - slope_x * x0 - slope_y * y0
    if y1 < y0:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y2 < y0:
        x0, y0, x2, y2 = x2, y2, x0, y0
    if y2 < y1:
        x1, y1, x2, y2 = x2, y2, x1, y1
    # Half-open rows and spans: a pixel on an edge of two triangles belongs to one of them alone.
    first_row = max(0, int(np.ceil(y0 - 0.5)))
    last_row = min(height - 1, int(np.ceil(y2 - 0.5)) - 1)
    long_edge = (x2 - x0) / (y2 - y0)
    upper_edge = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
    lower_edge = (x2 - x1) / (y2 - y1) if y2 > y1 else 0.0
    step = np.float32(slope_x)
    class_byte, face_word = np.uint8(class_id), np.uint32(word)
    painted = out.words.shape[0] > 0
    # A pixel changes only for what is strictly nearer: of equal depths the first drawn stays.
    for row in range(first_row, last_row + 1):
        y = row + 0.5
        xa = x0 + (y - y0) * long_edge
        xb = x0 + (y - y0) * upper_edge if y < y1 else x1 + (y - y1) * lower_edge
        start = int(np.ceil(max(min(xa, xb), 0.0) - 0.5))
        end = int(np.ceil(min(max(xa, xb), float(width)) - 0.5))
        if end <= start:
            continue
        w_start = np.float32(slope_x * (start + 0.5) + slope_y * y + origin)
        # Spans that begin at 0, and stores without a branch: only so does the compiler use vectors.
        w_row, class_row = out.inverse_z[row, start:end], out.class_id[row, start:end]
        if painted:
            word_row = out.words[row, start:end]
            for i in range(len(w_row)):
                w, old = w_start + step * np.float32(i), w_row[i]
                nearer = w > old
                w_row[i] = w if nearer else old
                class_row[i] = class_byte if nearer else class_row[i]
                word_row[i] = face_word if nearer else word_row[i]
        else:
            for i in range(len(w_row)):
                w, old = w_start + step * np.float32(i), w_row[i]
                nearer = w > old
                w_row[i] = w if nearer else old
                class_row[i] = class_byte if nearer else class_row[i]


@compile_fast_kernel
def _clip_and_fill(
    p: F32, a: int, b: int, c: int, class_id: int, word: Word, view: View, out: Target
) -> None:
    """Cut the triangle of a, b, c of p at the near plane, and fill what is in front of it."""
    height, width = out.inverse_z.shape
    f, near, cx, cy = view.focal_px, view.near_m, 0.5 * width, 0.5 * height
    behind = int(p[a, 2] < near) + int(p[b, 2] < near) + int(p[c, 2] < near)
    # Turn the corners so that the odd one (alone on its side of the plane) comes first.
    odd_behind = behind == 1
    if (p[b, 2] < near) == odd_behind:
        a, b, c = b, c, a
    elif (p[c, 2] < near) == odd_behind:
        a, b, c = c, a, b
    # Cut before the projection, which mirrors what is behind the eye. No divisor is 0, as a is
    # alone on its side.
    ax, ay, az = np.float64(p[a, 0]), np.float64(p[a, 1]), np.float64(p[a, 2])
    t, s = (near - az) / (p[b, 2] - az), (near - az) / (p[c, 2] - az)
    wn = 1.0 / near
    px, py = (ax + t * (p[b, 0] - ax)) * f * wn + cx, (ay + t * (p[b, 1] - ay)) * f * wn + cy
    qx, qy = (ax + s * (p[c, 0] - ax)) * f * wn + cx, (ay + s * (p[c, 1] - ay)) * f * wn + cy
    if odd_behind:
        wb, wc = 1.0 / p[b, 2], 1.0 / p[c, 2]
        bx, by = p[b, 0] * f * wb + cx, p[b, 1] * f * wb + cy
        dx, dy = p[c, 0] * f * wc + cx, p[c, 1] * f * wc + cy
        _fill(px, py, wn, bx, by, wb, dx, dy, wc, class_id, word, out)
        _fill(px, py, wn, dx, dy, wc, qx, qy, wn, class_id, word, out)
    else:
        wa = 1.0 / az
        _fill(ax * f * wa + cx, ay * f * wa + cy, wa, px, py, wn, qx, qy, wn, class_id, word, out)


@compile_fast_kernel
def _to_camera(vertices: F32, first: int, end: int, T: F64, out: F32) -> None:
    """Transform vertices first:end into the first rows of `out`."""
    for i in range(first, end):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            out[i - first, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]


@compile_fast_kernel
def _to_screen(p: F32, count: int, view: View, width: int, height: int, screen: F64) -> None:
    """Project the first points of p (n, 3) into `screen` (3, n): column, row and 1/z.

    The numbers of a point behind the camera mean nothing.
    """
    cx, cy = 0.5 * width, 0.5 * height
    for i in range(count):
        w = 1.0 / p[i, 2]
        screen[0, i] = p[i, 0] * view.focal_px * w + cx
        screen[1, i] = p[i, 1] * view.focal_px * w + cy
        screen[2, i] = w


@compile_fast_kernel
def _on_screen(
    x0: float, y0: float, x1: float, y1: float, x2: float, y2: float, width: int, height: int
) -> bool:
    """Whether a screen triangle may cover the middle of a pixel."""
    top, bottom, left, right = min(y0, y1, y2), max(y0, y1, y2), min(x0, x1, x2), max(x0, x1, x2)
    if top > height - 0.5 or bottom < 0.5 or left > width - 0.5 or right < 0.5:
        return False
    # With the rounding of `_fill`: a triangle between two rows of pixel middles covers none.
    return bool(
        np.ceil(top - 0.5) < np.ceil(bottom - 0.5) and np.ceil(left - 0.5) < np.ceil(right - 0.5)
    )


@compile_fast_kernel
def _lit_paint(paint: int, lamps: int) -> int:
    """The paint of a face of an actor whose signals are `lamps`."""
    if paint == TAILLIGHT and lamps & BRAKE_BIT:
        return BRAKING
    turns = (paint == LEFT_LAMP and lamps & LEFT_BITS) or (
        paint == RIGHT_LAMP and lamps & RIGHT_BITS
    )
    return TURNING if turns else paint


@compile_fast_kernel
def _draw_model(
    models: ModelArrays,
    t: int,
    seed: int,
    lamps: int,
    T_CM: F64,
    solid: bool,
    number: int,
    view: View,
    p: F32,
    screen: F64,
    out: Target,
) -> None:
    """Draw one actor; its words are colours, or its `number` where that is not below 0.

    Of a `solid` one, in which the camera is not, the faces that look away are skipped.
    """
    painted = out.words.shape[0] > 0 and number < 0
    height, width = out.inverse_z.shape
    first, end = models.vertices_of[t], models.vertices_of[t + 1]
    _to_camera(models.vertices, first, end, T_CM, p)
    _to_screen(p, end - first, view, width, height, screen)
    for face in range(models.faces_of[t], models.faces_of[t + 1]):
        a, b, c = models.faces[face, 0], models.faces[face, 1], models.faces[face, 2]
        ax, ay, az = p[a, 0], p[a, 1], p[a, 2]
        ux, uy, uz = p[b, 0] - ax, p[b, 1] - ay, p[b, 2] - az
        vx, vy, vz = p[c, 0] - ax, p[c, 1] - ay, p[c, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        # The eye is the origin: the sign is that of a face that looks away from it.
        if solid and nx * ax + ny * ay + nz * az >= 0.0:
            continue
        if max(az, p[b, 2], p[c, 2]) < view.near_m:
            continue
        x0, y0 = screen[0, a], screen[1, a]
        x1, y1 = screen[0, b], screen[1, b]
        x2, y2 = screen[0, c], screen[1, c]
        in_front = min(az, p[b, 2], p[c, 2]) >= view.near_m
        if in_front and not _on_screen(x0, y0, x1, y1, x2, y2, width, height):
            continue
        word = COLOURED | np.uint32(max(number, 0))
        if painted:
            length = np.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
            lit = (nx * view.sun_C[0] + ny * view.sun_C[1] + nz * view.sun_C[2]) / length
            shade = view.light[0] + view.light[1] * max(lit, 0.0)
            paint = _lit_paint(int(models.face_paint[face]), lamps)
            if paint >= SHINING:
                shade = 1.0
            # Other bits of the seed for each paint: shirts vary apart from trousers.
            variant = ((seed ^ (seed >> 9)) >> (paint * 2)) & (models.paints.shape[1] - 1)
            word = COLOURED
            for k in range(3):
                colour = min(models.paints[paint, variant, k] * shade, 255.0)
                word |= np.uint32(colour) << np.uint32(8 * k)
        if in_front:
            w0, w1, w2 = screen[2, a], screen[2, b], screen[2, c]
            _fill(x0, y0, w0, x1, y1, w1, x2, y2, w2, models.face_class[face], word, out)
        else:
            _clip_and_fill(p, a, b, c, models.face_class[face], word, view, out)


@compile_fast_kernel
def _near_first(depth: F32, range_m: float, order: I32) -> int:
    """Write the numbers of what is not OUT into `order`, near ones first; returns how many.

    The order is good to 1/BUCKETS of the range.
    """
    # A counting sort leaves the numbers in order within a bucket: at equal depth the lower one is
    # drawn first.
    starts = np.zeros(BUCKETS + 1, np.int32)
    scale = BUCKETS / range_m
    for i in range(len(depth)):
        if depth[i] > OUT:
            starts[1 + min(max(int(depth[i] * scale), 0), BUCKETS - 1)] += 1
    for k in range(BUCKETS):
        starts[k + 1] += starts[k]
    count = int(starts[BUCKETS])
    for i in range(len(depth)):
        if depth[i] > OUT:
            bucket = min(max(int(depth[i] * scale), 0), BUCKETS - 1)
            order[starts[bucket]] = i
            starts[bucket] += 1
    return count


@compile_fast_kernel
def _visible(
    street: StreetArrays,
    actors: InstanceArrays,
    shown: Bool,
    view: View,
    width: int,
    height: int,
    culling: bool,
    order: I32,
) -> int:
    """Write what may be seen into `order`, near ones first; returns how many.

    Chunks are c, actors chunks + i.
    """
    chunks, n = len(street.spheres), len(shown)
    depth = np.zeros(chunks + n, np.float32)
    if culling:
        cull(street.spheres, view, width, height, depth[:chunks])
        cull(actors.balls, view, width, height, depth[chunks:])
    for i in range(n):
        if not shown[i]:
            depth[chunks + i] = OUT
    return _near_first(depth, view.range_m, order)


@compile_fast_kernel
def _finish(view: View, out: Target) -> None:
    """Turn 1/z into depth; what lies beyond the range is sky."""
    height, width = out.inverse_z.shape
    # Selections instead of branches, as in `_fill`, for the sake of vectors.
    limit, far = np.float32(1.0 / view.range_m), np.float32(view.range_m)
    for row in range(height):
        w_row, class_row = out.inverse_z[row], out.class_id[row]
        for i in range(width):
            w = w_row[i]
            inside = w > limit
            w_row[i] = np.float32(1.0) / w if inside else far
            class_row[i] = class_row[i] if inside else SKY_ID

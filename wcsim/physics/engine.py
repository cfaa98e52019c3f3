"""The physics engine: one PyBullet client, its clock, the street's bodies, and what each body is.

Everything else in this package works on an `Engine`. Bodies are hardly ever removed, as PyBullet
leaks 4.5 kB for each multibody and 0.9 kB for each rigid one: those out of use are parked far below
the street. Collision shapes are never given back: about 230 B a face, until the engine is closed.

The street's triangles are made fit for collision: welded, without slivers, cut to what PyBullet
takes in one shape. Tiles that no chair is near leave the engine, and come back from shapes that
stay.
"""

from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from wcsim.core.closing import ClosingContextBase
from wcsim.core.constants import GRAVITY_MPS2 as GRAVITY_MPS2
from wcsim.errors import PhysicsError
from wcsim.physics.bullet import Bullet, pybullet
from wcsim.types import F64, I64, ClassId, StreetMesh, TileKey

PARK_Z_M: Final = -500.0
# A wheel carries less than 1000 N; below this a contact that cannot be does no harm.
SUSPECT_N: Final = 2000.0
_MAX_VERTICES: Final = 131_072  # B3_MAX_NUM_VERTICES of PyBullet
MAX_FACES: Final = 524_288 // 3  # B3_MAX_NUM_INDICES
WELD_M: Final = 1e-4
_MIN_HEIGHT_M: Final = 1e-4  # a triangle thinner than this is a gap that no wheel can feel
# Short, so that a ray meets neither a roof above nor the street under a bridge.
_GROUND_REACH_M: Final = 0.5
# Wheels ride by this much above the ground that is drawn. Bullet's usual 0.04 m would be seen, and
# felt at kerbs.
_STREET_MARGIN_M: Final = 0.001
# With PyBullet's 20 mm a wheel meets the edge of every triangle just ahead of it at a slant, and is
# pushed back: 0.6 m/s2 rms on a flat floor of small triangles. A fan of slivers throws it off. With
# 0.1 mm it is 0.2 m/s2, and a step costs half. PyBullet has one such number for the whole process.
_CONTACT_BREAKING_M: Final = 1e-4
_GROUND = (
    ClassId.ROAD,
    ClassId.SIDEWALK,
    ClassId.PARKING,
    ClassId.RAIL_TRACK,
    ClassId.TERRAIN,
    ClassId.CROSSWALK,
    ClassId.GROUND,
)


class Role(Enum):
    """What a body is to a wheelchair; the value is what `Contact.kind` says of the first four."""

    GROUND = "ground"
    KERB = "kerb"
    BUILDING = "building"
    STATIC = "static"
    ACTOR = "actor"
    CHAIR = "wheelchair"


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyTag:
    """What the contact code must know of a body."""

    role: Role
    kind: str  # as in Contact.kind
    actor_id: str = ""
    p_W_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of an actor, at the start of the tick
    v_W_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rate_radps: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Soup:
    """Triangles that share vertices."""

    vertices_m: F64  # (V, 3)
    faces: I64  # (F, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class _StreetPiece:
    """A body of the street, with the shape that it is made of and can be made of again."""

    body: int
    shape: int
    role: Role


_ROLE_OF_CLASS: Final = {
    **{int(item): Role.GROUND for item in _GROUND},
    **{int(item): Role.KERB for item in (ClassId.KERB, ClassId.LOWERED_KERB)},
    **{int(item): Role.BUILDING for item in (ClassId.BUILDING, ClassId.WALL, ClassId.FENCE)},
}


class Engine(ClosingContextBase):
    """One PyBullet world without a window.

    Args:
        step_s: Time step, 0.001 to 0.01 s; see `set_step`.
        solver_iterations: Upper bound of the constraint solver's iterations per step.

    Raises:
        PhysicsError: The step is out of bounds, or PyBullet gave no client.
    """

    def __init__(self, step_s: float, solver_iterations: int = 50) -> None:
        _check_step(step_s)
        if solver_iterations < 1:
            raise PhysicsError(f"solver_iterations is {solver_iterations}; expected 1 or more")
        self.bullet: Final = Bullet()
        self._step_s = step_s
        self._tags: dict[int, BodyTag] = {}
        self._rolling: set[int] = set()
        self._touched: set[int] | None = None  # see `touched`; None until its call after a step
        # By body its links that are meant to touch what it rolls on.
        self.feet: dict[int, Container[int]] = {}
        self._corners: list[list[float]] = []
        self.bullet.setGravity(0.0, 0.0, -GRAVITY_MPS2)
        self.bullet.setTimeStep(step_s)
        self.bullet.setPhysicsEngineParameter(
            numSolverIterations=solver_iterations,
            # Bullet sorts its pairs of bodies: one history always gives the contacts in one order.
            deterministicOverlappingPairs=1,
            contactBreakingThreshold=_CONTACT_BREAKING_M,
            enableFileCaching=0,
        )

    def close(self) -> None:
        """Give the client back; a second call does nothing."""
        self.bullet.close()

    @property
    def step_s(self) -> float:
        """The time step."""
        return self._step_s

    def set_step(self, step_s: float) -> None:
        """Step so far from now on; wheelchairs have to follow (`follow_step`).

        Raises:
            PhysicsError: The step is out of bounds.
        """
        if step_s != self._step_s:
            _check_step(step_s)
            self._step_s = step_s
            self.bullet.setTimeStep(step_s)

    def step(self) -> None:
        """Advance by `step_s`."""
        self.bullet.stepSimulation()
        self._touched = None

    def touched(self) -> set[int]:
        """The bodies with a contact after the last step that is more than a foot on the ground."""
        if self._touched is None:
            ground, feet = self._rolling, self.feet
            # One call for all bodies, as nearly every contact is a wheel on the ground. PyBullet's
            # fields: 1 and 2 the bodies (a mesh is never the first), 3 the first's link, 9 force.
            self._touched = {
                body
                for point in self.bullet.getContactPoints()
                if point[9] > SUSPECT_N
                or point[2] not in ground
                or point[3] not in feet.get(point[1], ())
                for body in point[1:3]
            }
        return self._touched

    def add_street(self, mesh: StreetMesh) -> tuple[_StreetPiece, ...]:
        """Add everything that stands still: as few concave bodies as possible per role, friction 1.

        Raises:
            PhysicsError: The mesh has numbers that are not finite, or faces without a vertex.
        """
        # 1. Check the mesh.
        vertices = np.asarray(mesh.vertices_W_m, np.float64)
        faces = np.asarray(mesh.faces, np.int64)
        if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
            raise PhysicsError(
                f"street mesh has shapes {vertices.shape} and {faces.shape}; expected (V, 3) and "
                "(F, 3)"
            )
        if not np.isfinite(vertices).all():
            raise PhysicsError(
                "street mesh holds coordinates that are not finite; import the town again"
            )
        if len(mesh.face_class) != len(faces):
            raise PhysicsError(
                f"street mesh has {len(mesh.face_class)} classes for {len(faces)} faces; expected "
                "one each"
            )
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise PhysicsError(
                f"street mesh has faces outside its {len(vertices)} vertices; import the town again"
            )

        # 2. Role by role, so that the bodies of a mesh get their ids in one order in every run.
        roles = list(Role)
        role_by_class = np.array(
            [roles.index(_ROLE_OF_CLASS.get(class_id, Role.STATIC)) for class_id in range(256)]
        )
        face_role = role_by_class[mesh.face_class]
        pieces = []
        for number, role in enumerate(roles):
            own = faces[face_role == number]
            if len(own):
                parts = _split(_tidy(vertices, own))
                pieces += [self._laid(self._street_shape(soup), role) for soup in parts]
        return tuple(pieces)

    def lift_street(self, pieces: Iterable[_StreetPiece]) -> None:
        """Take pieces of the street out of the world; their shapes are kept."""
        for piece in pieces:
            self.remove_body(piece.body)

    def lay_street(self, pieces: Iterable[_StreetPiece]) -> tuple[_StreetPiece, ...]:
        """Put pieces that were taken out back where they were."""
        return tuple(self._laid(piece.shape, piece.role) for piece in pieces)

    def _street_shape(self, soup: _Soup) -> int:
        """PyBullet's shape of these triangles.

        PyBullet never frees the lists that it is given, nor those of the vertices in them: 200 B a
        vertex. So all meshes are given in the same lists of three, and the long ones are emptied.
        """
        points = soup.vertices_m.tolist()
        self._corners += [[] for _ in range(len(points) - len(self._corners))]
        corners, indices = self._corners[: len(points)], soup.faces.ravel().tolist()
        for corner, point in zip(corners, points, strict=True):
            corner[:] = point
        shape: int = self.bullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=corners,
            indices=indices,
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
        )
        for corner in corners:
            corner.clear()
        corners.clear()
        indices.clear()
        return shape

    def _laid(self, shape: int, role: Role) -> _StreetPiece:
        body = self.add_body(
            shape, (0.0, 0.0, 0.0), BodyTag(role=role, kind=role.value), moves=False
        )
        self.bullet.changeDynamics(
            body,
            -1,
            lateralFriction=1.0,
            rollingFriction=0.0,
            spinningFriction=0.0,
            collisionMargin=_STREET_MARGIN_M,
        )
        return _StreetPiece(body=body, shape=shape, role=role)

    def add_body(
        self, shape: int, position_m: tuple[float, float, float], tag: BodyTag, moves: bool = True
    ) -> int:
        """Make a body of mass 0 of a collision shape, and tag it; returns its id.

        One that never moves is a plain rigid body to Bullet, which costs a step less than a
        multibody.

        Raises:
            PhysicsError: PyBullet refused the shape or the body.
        """
        if shape < 0:
            raise PhysicsError(
                f"PyBullet refused a collision shape for {tag.kind!r}; expected finite, positive "
                "sizes"
            )
        body: int = self.bullet.createMultiBody(
            0.0, shape, basePosition=position_m, useMaximalCoordinates=int(not moves)
        )
        if body < 0:
            raise PhysicsError(
                f"PyBullet refused a body for {tag.kind!r}; too many bodies, or no memory left"
            )
        self.tag(body, tag)
        return body

    def tag(self, body_id: int, tag: BodyTag) -> None:
        """Set what a body is; it may have been something else before."""
        self._tags[body_id] = tag
        if tag.role in (Role.GROUND, Role.KERB):
            self._rolling.add(body_id)

    def remove_body(self, body_id: int) -> None:
        """Take out a wheelchair or a piece of the street; its id may be that of the next body."""
        self.bullet.removeBody(body_id)
        self._tags.pop(body_id, None)
        self.feet.pop(body_id, None)
        self._rolling.discard(body_id)

    def tag_of(self, body_id: int) -> BodyTag:
        """What a body is. Raises PhysicsError for an id without a tag."""
        try:
            return self._tags[body_id]
        except KeyError:
            raise PhysicsError(
                f"body {body_id} is unknown; expected one made through this engine"
            ) from None

    @property
    def rolling_ids(self) -> set[int]:
        """Ids of the bodies that wheels are meant to touch: ground and kerbs."""
        return self._rolling

    def ground_at(self, points_W_m: F64) -> F64:
        """Height (N,) of ground or kerb up to 0.5 m above or below points (N, 3); nan for none."""
        half = np.array([0.0, 0.0, _GROUND_REACH_M])
        above, below = (points_W_m + half).tolist(), (points_W_m - half).tolist()
        hits = self.bullet.rayTestBatch(above, below)
        # No wheel stands on what else a ray meets, such as a vehicle or a parked bicycle.
        return np.array([hit[3][2] if hit[0] in self._rolling else np.nan for hit in hits])


class StreetBodies:
    """The tiles of one engine; `keys` are those that lie in it now."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        # Of every tile that ever was there.
        self._pieces: dict[TileKey, tuple[_StreetPiece, ...]] = {}
        self.keys: set[TileKey] = set()

    def lay(self, key: TileKey, mesh: Callable[[], StreetMesh]) -> None:
        """Put a tile into the engine that is not there; `mesh` is called the first time only.

        Raises:
            PhysicsError: The mesh has numbers that are not finite, or faces without a vertex.
        """
        engine, pieces = self._engine, self._pieces.get(key)
        self._pieces[key] = (
            engine.add_street(mesh()) if pieces is None else engine.lay_street(pieces)
        )
        self.keys.add(key)

    def lift(self, key: TileKey) -> None:
        """Take a tile out of the engine. Raises KeyError when it is not there."""
        self.keys.remove(key)
        self._engine.lift_street(self._pieces[key])


def _check_step(step_s: float) -> None:
    if not 1 / 1000 <= step_s <= 1 / 100:
        raise PhysicsError(
            f"physics step is {step_s} s; expected 0.001 to 0.01 s: change tick_s or substeps"
        )


def _tidy(vertices_m: F64, faces: I64) -> _Soup:
    """Weld vertices closer than 0.1 mm; leave out flat triangles, and vertices without a triangle.

    Args:
        vertices_m: Vertices (V, 3).
        faces: Vertex indices (F, 3).
    """
    # 1. A cell of a grid is one vertex. That needs no search for neighbours, and a chain of close
    # points does not become one.
    used, local = np.unique(faces, return_inverse=True)
    keys = np.rint(vertices_m[used] / WELD_M).astype(np.int64)
    _, first, weld = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    welded = weld.reshape(-1)[local.reshape(faces.shape)]
    points = vertices_m[used][first]
    # 2. The smallest height of each triangle, after the welding, which itself makes some flat. By
    # the cross product: Heron's formula, from the sides alone, cancels for slivers.
    a, b, c = (points[welded[:, k]] for k in range(3))
    double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    height = np.divide(double_area, longest, out=np.zeros_like(double_area), where=longest > 0)
    return _compact(points, welded[height >= _MIN_HEIGHT_M])


def _split(soup: _Soup) -> Iterator[_Soup]:
    """The triangles in as few pieces as PyBullet's limits allow; one when they fit."""
    if len(soup.vertices_m) <= _MAX_VERTICES and len(soup.faces) <= MAX_FACES:
        if len(soup.faces):
            yield soup
        return
    centre = soup.vertices_m[soup.faces].mean(axis=1)
    # Along the longest side: the pieces stay compact, and few of them lie under one chair.
    axis = int(np.argmax(np.ptp(centre, axis=0)))
    # Stable: faces with the same centre fall into the same half on every machine.
    order = np.argsort(centre[:, axis], kind="stable")
    half = len(order) // 2
    for part in (order[:half], order[half:]):
        yield from _split(_compact(soup.vertices_m, soup.faces[np.sort(part)]))


def _compact(points_m: F64, faces: I64) -> _Soup:
    used, local = np.unique(faces, return_inverse=True)
    return _Soup(vertices_m=points_m[used], faces=local.reshape(faces.shape))

"""The physics engine: one PyBullet client, its clock, the street as collision bodies, and what every body is.

Everything else in this package works on an `Engine`. Bodies are hardly ever removed (PyBullet leaks 4.5 kB for each
multibody, 0.9 kB for each rigid one): those out of use are parked far below the street. Collision shapes are never
given back, whatever is removed: about 230 B a face, until the engine is closed.

Triangle soups made fit for collision: welded, without slivers, cut to what PyBullet takes in one shape. Tiles of the
street that no chair is near leave the engine, and come back from shapes that are kept.
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

_MAX_VERTICES: Final = 131_072  # B3_MAX_NUM_VERTICES of PyBullet
MAX_FACES: Final = 524_288 // 3  # B3_MAX_NUM_INDICES
WELD_M: Final = 1e-4
_MIN_HEIGHT_M: Final = 1e-4  # a triangle thinner than this is a gap that no wheel can feel


@dataclass(frozen=True, slots=True, kw_only=True)
class _Soup:
    """Triangles that share vertices."""

    vertices_m: F64  # (V, 3)
    faces: I64  # (F, 3)


def _tidy(vertices_m: F64, faces: I64) -> _Soup:
    """Vertices closer than 0.1 mm become one, triangles without height go, vertices without triangle go.

    Args:
        vertices_m: Vertices (V, 3).
        faces: Vertex indices (F, 3).
    """
    used, local = np.unique(faces, return_inverse=True)
    # A cell of a grid is one vertex: no search for neighbours, and no chain of close points that become one.
    keys = np.rint(vertices_m[used] / WELD_M).astype(np.int64)
    _, first, weld = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    welded = weld.reshape(-1)[local.reshape(faces.shape)]
    points = vertices_m[used][first]
    # Measured after the welding, which itself makes triangles flat.
    keep = _height_m(points, welded) >= _MIN_HEIGHT_M
    return _compact(points, welded[keep])


def _split(soup: _Soup) -> Iterator[_Soup]:
    """The soup in as few pieces as PyBullet's limits allow; one when it fits."""
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


def _height_m(points_m: F64, faces: I64) -> F64:
    """Smallest height (F,) of each triangle; 0 for a degenerate one."""
    a, b, c = (points_m[faces[:, k]] for k in range(3))
    # By the cross product: Heron's formula, from the sides alone, cancels for slivers.
    double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    return np.asarray(np.divide(double_area, longest, out=np.zeros_like(double_area), where=longest > 0))


def _compact(points_m: F64, faces: I64) -> _Soup:
    used, local = np.unique(faces, return_inverse=True)
    return _Soup(vertices_m=points_m[used], faces=local.reshape(faces.shape))


PARK_Z_M: Final = -500.0
# Short, so that a ray meets neither a roof above nor the street under a bridge.
_GROUND_REACH_M: Final = 0.5
# Wheels ride by this much above the ground that is drawn. Bullet's usual 0.04 m would be seen, and felt at kerbs.
_STREET_MARGIN_M: Final = 0.001
# With PyBullet's 20 mm a wheel meets the edge of every triangle just ahead of it at a slant and is pushed back: 0.6
# m/s2 rms on a flat floor of small triangles, and it is thrown off a fan of slivers. 0.1 mm gives 0.2, and a step costs
# half. PyBullet keeps one such number for the whole process.
_CONTACT_BREAKING_M: Final = 1e-4
SUSPECT_N: Final = 2000.0  # a wheel carries less than 1000 N; below this a contact that cannot be does no harm


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
class _StreetPiece:
    """A body of the street and the shape that it is made of, and can be made of again."""

    body: int
    shape: int
    role: Role


_GROUND = (
    ClassId.ROAD,
    ClassId.SIDEWALK,
    ClassId.PARKING,
    ClassId.RAIL_TRACK,
    ClassId.TERRAIN,
    ClassId.CROSSWALK,
    ClassId.GROUND,
)
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
        self._touched: set[int] | None = None  # see `touched`; None until somebody asks after a step
        self.feet: dict[int, Container[int]] = {}  # by body, its links that are meant to touch what is rolled on
        self._corners: list[list[float]] = []
        self.bullet.setGravity(0.0, 0.0, -GRAVITY_MPS2)
        self.bullet.setTimeStep(step_s)
        self.bullet.setPhysicsEngineParameter(
            numSolverIterations=solver_iterations,
            # Bullet sorts its pairs of bodies, so that one history always gives the contacts in one order.
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
        """Step so far from now on; wheelchairs must be told as well. Raises PhysicsError for a step out of bounds."""
        if step_s != self._step_s:
            _check_step(step_s)
            self._step_s = step_s
            self.bullet.setTimeStep(step_s)

    def step(self) -> None:
        """Advance by `step_s`."""
        self.bullet.stepSimulation()
        self._touched = None

    def touched(self) -> set[int]:
        """The bodies with a contact after the last step that is more than a foot that stands or rolls."""
        # One question for all bodies: nearly every contact is a wheel on the ground. A mesh is never a contact's first.
        if self._touched is None:
            ground, feet = self._rolling, self.feet
            # PyBullet's fields: 1 and 2 the bodies, 3 the link of the first, 9 force
            self._touched = {
                body
                for point in self.bullet.getContactPoints()
                if point[9] > SUSPECT_N or point[2] not in ground or point[3] not in feet.get(point[1], ())
                for body in point[1:3]
            }
        return self._touched

    def add_street(self, mesh: StreetMesh) -> tuple[_StreetPiece, ...]:
        """Add everything that stands still: as few concave bodies per role as PyBullet's limits allow, friction 1.

        Raises:
            PhysicsError: The mesh holds numbers that are not finite or faces that point at no vertex.
        """
        vertices, faces = _checked(mesh)
        numbers = {role: number for number, role in enumerate(Role)}
        role_by_class = np.array([numbers[_ROLE_OF_CLASS.get(class_id, Role.STATIC)] for class_id in range(256)])
        face_role = role_by_class[mesh.face_class]
        return tuple(
            self._laid(self._street_shape(soup), role)
            # Role by role, so that the bodies of a mesh get their ids in the same order in every run.
            for role, number in numbers.items()
            for soup in _street_parts(vertices, faces[face_role == number])
        )

    def lift_street(self, pieces: Iterable[_StreetPiece]) -> None:
        """Take pieces of the street out of the world; their shapes are kept."""
        for piece in pieces:
            self.remove_body(piece.body)

    def lay_street(self, pieces: Iterable[_StreetPiece]) -> tuple[_StreetPiece, ...]:
        """Put pieces that were taken out back where they were."""
        return tuple(self._laid(piece.shape, piece.role) for piece in pieces)

    def _street_shape(self, soup: _Soup) -> int:
        """PyBullet's shape of a soup.

        PyBullet keeps the lists that it is given for ever, each vertex's with them: 200 B a vertex. So all meshes are
        told in the same lists of three, and the long ones are emptied.
        """
        points = soup.vertices_m.tolist()
        self._corners += [[] for _ in range(len(points) - len(self._corners))]
        corners, indices = self._corners[: len(points)], soup.faces.ravel().tolist()
        for corner, point in zip(corners, points, strict=True):
            corner[:] = point
        shape: int = self.bullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=corners, indices=indices, flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH
        )
        for corner in corners:
            corner.clear()
        corners.clear()
        indices.clear()
        return shape

    def _laid(self, shape: int, role: Role) -> _StreetPiece:
        body = self.add_body(shape, (0.0, 0.0, 0.0), BodyTag(role=role, kind=role.value), moves=False)
        self.bullet.changeDynamics(
            body, -1, lateralFriction=1.0, rollingFriction=0.0, spinningFriction=0.0, collisionMargin=_STREET_MARGIN_M
        )
        return _StreetPiece(body=body, shape=shape, role=role)

    def add_body(self, shape: int, position_m: tuple[float, float, float], tag: BodyTag, moves: bool = True) -> int:
        """Make a mass-0 body of a collision shape and tag it; returns its id. Raises PhysicsError if it is refused.

        One that never moves is a plain rigid body to Bullet instead of a multibody, which costs a step less.
        """
        if shape < 0:
            raise PhysicsError(f"PyBullet refused a collision shape for {tag.kind!r}; expected finite, positive sizes")
        body: int = self.bullet.createMultiBody(
            0.0, shape, basePosition=position_m, useMaximalCoordinates=int(not moves)
        )
        if body < 0:
            raise PhysicsError(f"PyBullet refused a body for {tag.kind!r}; too many bodies, or no memory left")
        self.tag(body, tag)
        return body

    def tag(self, body_id: int, tag: BodyTag) -> None:
        """Say what a body is (again)."""
        self._tags[body_id] = tag
        if tag.role in (Role.GROUND, Role.KERB):
            self._rolling.add(body_id)

    def remove_body(self, body_id: int) -> None:
        """Take a body out and forget it; its id may be that of the next one. For wheelchairs and the street only."""
        self.bullet.removeBody(body_id)
        self._tags.pop(body_id, None)
        self.feet.pop(body_id, None)
        self._rolling.discard(body_id)

    def tag_of(self, body_id: int) -> BodyTag:
        """What a body is. Raises PhysicsError for an id that was never told."""
        try:
            return self._tags[body_id]
        except KeyError:
            raise PhysicsError(f"body {body_id} is unknown; expected one made through this engine") from None

    @property
    def rolling_ids(self) -> set[int]:
        """Ids of the bodies that wheels are meant to touch: ground and kerbs."""
        return self._rolling

    def ground_at(self, points_W_m: F64) -> F64:
        """Height (N,) of ground or kerb within half a metre above or below points (N, 3); nan where there is none."""
        half = np.array([0.0, 0.0, _GROUND_REACH_M])
        above, below = (points_W_m + half).tolist(), (points_W_m - half).tolist()
        hits = self.bullet.rayTestBatch(above, below)
        # Nobody stands on what else a ray meets, such as a vehicle or a parked bicycle.
        return np.array([hit[3][2] if hit[0] in self._rolling else np.nan for hit in hits])


def _check_step(step_s: float) -> None:
    if not 1 / 1000 <= step_s <= 1 / 100:
        raise PhysicsError(f"physics step is {step_s} s; expected 0.001 to 0.01 s: change tick_s or substeps")


def _checked(mesh: StreetMesh) -> tuple[F64, I64]:
    """Vertices (V, 3) float64 and faces (F, 3) int64 of a mesh whose numbers are sound."""
    vertices = np.asarray(mesh.vertices_W_m, np.float64)
    faces = np.asarray(mesh.faces, np.int64)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise PhysicsError(f"street mesh has shapes {vertices.shape} and {faces.shape}; expected (V, 3) and (F, 3)")
    if not np.isfinite(vertices).all():
        raise PhysicsError("street mesh holds coordinates that are not finite; import the town again")
    if len(mesh.face_class) != len(faces):
        raise PhysicsError(f"street mesh has {len(mesh.face_class)} classes for {len(faces)} faces; expected one each")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise PhysicsError(f"street mesh has faces outside its {len(vertices)} vertices; import the town again")
    return vertices, faces


def _street_parts(vertices_m: F64, faces: I64) -> Iterator[_Soup]:
    if len(faces):
        yield from _split(_tidy(vertices_m, faces))


class StreetBodies:
    """The tiles of one engine; `keys` are those that lie in it now."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._pieces: dict[TileKey, tuple[_StreetPiece, ...]] = {}  # of every tile that ever was there
        self.keys: set[TileKey] = set()

    def lay(self, key: TileKey, mesh: Callable[[], StreetMesh]) -> None:
        """Put a tile into the engine that is not there; `mesh` is asked for it the first time only.

        Raises:
            PhysicsError: The mesh holds numbers that are not finite or faces that point at no vertex.
        """
        pieces = self._pieces.get(key)
        self._pieces[key] = self._engine.add_street(mesh()) if pieces is None else self._engine.lay_street(pieces)
        self.keys.add(key)

    def lift(self, key: TileKey) -> None:
        """Take a tile out of the engine. Raises KeyError when it is not there."""
        self.keys.remove(key)
        self._engine.lift_street(self._pieces[key])

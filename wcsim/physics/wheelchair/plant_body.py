"""A plant as URDF text, and as a body in PyBullet with its links, joints, frictions and springs.

Joints are named like the link that they carry: `wheel_l`; for each pair of casters by its number
`beam_0` (when they share one), `arm_0_l` (when sprung), `swivel_0_l` and `caster_0_l`;
`antitip_0_l`; and the same with `_r`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from wcsim.config.plant import CasterArmPart, CasterPart
from wcsim.core.frames import Vec3, deg2rad
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import ConfigError, PhysicsError
from wcsim.physics.bullet import Bullet, pybullet
from wcsim.physics.engine import Engine
from wcsim.physics.wheelchair.contacts import Tyre
from wcsim.physics.wheelchair.plant import (
    ARM_INERTIA_KGM2,
    FORK_COM_M,
    FORK_M,
    PlantSpec,
    beam_inertia_kgm2,
    disc_inertia_kgm2,
)

FRAME: Final = -1  # PyBullet's index of the base link
_ORIGIN: Final[Vec3] = (0.0, 0.0, 0.0)
_SIDES: Final = (("l", 1.0), ("r", -1.0))
# URDF demands limits of force and speed; springs and stops act long before these.
_ARM_EFFORT_N: Final = 1e4
_ARM_MPS: Final = 20.0
_BEAM_EFFORT_NM: Final = 1e4
_BEAM_RADPS: Final = 50.0
# Of any joint: a car that hits a caster would whirl its light fork round, into itself.
_MOST_RADPS: Final = 30.0
# Faster chairs need their casters to turn so much faster than they roll at top speed.
_SPARE: Final = 1.5
_STABLE: Final = 0.8  # of the damping at which a sprung arm would swing up without end
_JOINT_ORDER: Final = ("wheel", "arm", "beam", "swivel", "caster")


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairBody:
    """What PyBullet calls the parts of one loaded chair."""

    id: int
    links: dict[str, int]  # by name; a joint is named like the link that it carries
    joints: tuple[int, ...]  # all that move: the drive wheels first, then the arms
    drives: tuple[int, int]
    arms: tuple[int, ...]
    springs: tuple[CasterArmPart, ...]  # one for each arm
    part: dict[int, str]  # of every link that may touch the ground
    tyres: dict[int, Tyre]


def urdf(spec: PlantSpec) -> str:
    """The text; the frame is the base link."""
    # 1. The frame.
    boxes = "".join(
        f'<collision><origin xyz="{_text(box.centre_m)}"/>'
        f'<geometry><box size="{_text(box.size_m)}"/></geometry></collision>'
        for box in spec.frame.boxes
    )
    inertial = _inertial(spec.frame_mass_kg, spec.frame_inertia_kgm2, spec.frame_com_m)
    links = [f'<link name="frame">{inertial}{boxes}</link>']

    # 2. The drive wheels.
    wheel = spec.wheel
    for side, sign in _SIDES:
        hub_m = (0.0, sign * 0.5 * wheel.track_m, wheel.radius_m)
        links += [
            _rolling(f"wheel_{side}", wheel.mass_kg, wheel.radius_m, wheel.width_m),
            _joint(f"wheel_{side}", "frame", hub_m, axis="0 1 0"),
        ]

    # 3. Casters and anti-tips.
    for number, pair in enumerate(spec.casters):
        links += _casters(number, pair)
    for number, item in enumerate(spec.antitips):
        shape = f'<collision><geometry><sphere radius="{item.radius_m}"/></geometry></collision>'
        inertial = _inertial(item.mass_kg, (item.inertia_kgm2,) * 3, _ORIGIN)
        x, y, z = item.p_m
        for side, sign in _SIDES:
            name = f"antitip_{number}_{side}"
            links += [
                f'<link name="{name}">{inertial}{shape}</link>',
                _joint(name, "frame", (x, sign * y, z), axis=None),
            ]
    return "\n".join(('<robot name="wheelchair">', *links, "</robot>"))


def check_springs(spec: PlantSpec, step_s: float) -> None:
    """Raise ConfigError when steps of `step_s` would make a sprung arm swing up without end."""
    for number, pair in enumerate(spec.casters):
        if pair.arm is None:
            continue
        unsprung_kg = pair.arm.mass_kg + pair.fork_mass_kg + pair.mass_kg
        # The bound of a spring that is pushed once a step: k dt^2 + 2 c dt < 4 m.
        most_Nspm = 0.5 * (_STABLE * 4.0 * unsprung_kg / step_s - pair.arm.stiffness_Npm * step_s)
        if pair.arm.damping_Nspm > most_Nspm:
            raise ConfigError(
                f"casters.{number}.arm.damping_Nspm is {pair.arm.damping_Nspm:g} Ns/m: too stiff "
                f"for physics steps of {step_s:.5f} s with {unsprung_kg:g} kg below the spring; "
                f"expected at most {max(most_Nspm, 0.0):.0f} Ns/m, or more world.substeps"
            )


def load_body(engine: Engine, spec: PlantSpec, v_max_mps: float) -> ChairBody:
    """Load a plant that drives so fast at most.

    Raises:
        ConfigError: Its springs are too stiff for the engine's step.
        PhysicsError: PyBullet refused it.
    """
    check_springs(spec, engine.step_s)
    # Else Bullet guesses inertias from the shapes, and takes a wheel for a prism that rattles.
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER
    with create_temporary_folder() as folder:
        path = folder / "chair.urdf"
        path.write_text(urdf(spec), encoding="utf-8")
        try:
            number = int(engine.bullet.loadURDF(str(path), flags=flags))
        except pybullet.error as error:
            raise PhysicsError(
                f"PyBullet refused the wheelchair ({error}); expected a body: check the plant"
            ) from None
    return dressed(engine, number, spec, v_max_mps)


def dressed(engine: Engine, number: int, spec: PlantSpec, v_max_mps: float) -> ChairBody:
    """A loaded body with frictions and springs of a plant that has the URDF it was loaded from."""
    # 1. Its parts. Drive wheels are first, then arms: `Wheelchair` takes their states by place.
    bullet = engine.bullet
    count = bullet.getNumJoints(number)
    links = {bullet.getJointInfo(number, i)[1].decode(): i for i in range(count)}
    order = {name: _JOINT_ORDER.index(_part(name)) for name in links if _part(name) in _JOINT_ORDER}
    joints = sorted(order, key=lambda name: (order[name], links[name]))
    arms = [name for name in joints if _part(name) == "arm"]
    touching, tyres = {}, {}
    for name, index in links.items():
        part = _part(name)
        if part not in ("arm", "beam", "swivel"):
            touching[index] = part
        if part in ("wheel", "caster"):
            wheel = spec.wheel if part == "wheel" else spec.casters[_pair(name)]
            tyres[index] = Tyre(radius_m=wheel.radius_m, half_width_m=0.5 * wheel.width_m)

    # 2. The body, and how it moves.
    body = ChairBody(
        id=number,
        links=links,
        joints=tuple(links[name] for name in joints),
        drives=(links["wheel_l"], links["wheel_r"]),
        arms=tuple(links[name] for name in arms),
        springs=tuple(arm for name in arms if (arm := spec.casters[_pair(name)].arm) is not None),
        part=touching,
        tyres=tyres,
    )
    least_radius_m = min(pair.radius_m for pair in spec.casters)
    _set_dynamics(body, spec, max(_MOST_RADPS, _SPARE * v_max_mps / least_radius_m), bullet)
    return body


def _set_dynamics(body: ChairBody, spec: PlantSpec, most_radps: float, bullet: Bullet) -> None:
    """Friction per part, no damping, and the default motors of joints for bearings alone."""
    # A call of their own: with one of these three PyBullet puts a link's friction on the base.
    bullet.changeDynamics(
        body.id, FRAME, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=most_radps
    )
    for name, index in (("frame", FRAME), *body.links.items()):
        bullet.changeDynamics(
            body.id,
            index,
            lateralFriction=_friction(spec, name),
            rollingFriction=0.0,
            spinningFriction=0.0,
            jointDamping=0.0,
        )
    # The drive wheels turn the motors' rotors, whose inertia URDF refuses. Without it a wheel is so
    # light beside the chair that the solver does not end, and the chair creeps down slopes.
    for index in body.drives:
        bullet.changeDynamics(body.id, index, localInertiaDiagonal=spec.drive_inertia_kgm2)
    for name, index in body.links.items():
        part, friction_Nm = _part(name), 0.0
        if part == "antitip":
            continue
        if part == "swivel":
            friction_Nm = spec.casters[_pair(name)].swivel_friction_Nm
        elif part == "beam" and (beam := spec.casters[_pair(name)].beam) is not None:
            friction_Nm = beam.friction_Nm
        bullet.setJointMotorControl2(
            body.id, index, pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=friction_Nm
        )


def _part(link: str) -> str:
    return link.split("_")[0]


def _pair(link: str) -> int:
    """Number of the pair that a link of casters or anti-tips belongs to."""
    return int(link.split("_")[1])


def _friction(spec: PlantSpec, link: str) -> float:
    part = _part(link)
    if part == "wheel":
        return spec.wheel.friction
    if part == "caster":
        return spec.casters[_pair(link)].friction
    return spec.antitips[_pair(link)].friction if part == "antitip" else spec.frame.friction


def _casters(number: int, pair: CasterPart) -> Iterator[str]:
    """A pair of casters and what it hangs on: the frame, arms or a beam."""
    base, x_m, z_m = "frame", pair.swivel_x_m, pair.radius_m + FORK_M
    # A beam is a rod as long as the pair's track, level with the swivels; its pivot's axis is x.
    if pair.beam is not None:
        beam, base = pair.beam, f"beam_{number}"
        x_m, z_m = 0.0, z_m - beam.pivot_z_m
        stop_rad = deg2rad(beam.stop_deg)
        inertia_kgm2 = beam_inertia_kgm2(beam.mass_kg, pair.track_m)
        inertial = _inertial(beam.mass_kg, inertia_kgm2, (0.0, 0.0, z_m))
        yield f'<link name="{base}">{inertial}</link>'
        yield _joint(
            base,
            "frame",
            (pair.swivel_x_m, 0.0, beam.pivot_z_m),
            axis="1 0 0",
            kind="revolute",
            limit=(-stop_rad, stop_rad, _BEAM_EFFORT_NM, _BEAM_RADPS),
        )
    for side, sign in _SIDES:
        name, parent, at_m = f"{number}_{side}", base, (x_m, sign * 0.5 * pair.track_m, z_m)
        if pair.arm is not None:
            arm, parent = pair.arm, f"arm_{name}"
            inertial = _inertial(arm.mass_kg, (ARM_INERTIA_KGM2,) * 3, _ORIGIN)
            yield f'<link name="{parent}">{inertial}</link>'
            yield _joint(
                parent,
                "frame",
                at_m,
                axis="0 0 1",
                kind="prismatic",
                limit=(-arm.down_m, arm.up_m, _ARM_EFFORT_N, _ARM_MPS),
            )
            at_m = _ORIGIN
        com_m = (-0.5 * pair.trail_m, 0.0, -FORK_COM_M)
        inertial = _inertial(pair.fork_mass_kg, (pair.fork_inertia_kgm2,) * 3, com_m)
        yield f'<link name="swivel_{name}">{inertial}</link>'
        yield _joint(f"swivel_{name}", parent, at_m, axis="0 0 1")
        yield _rolling(f"caster_{name}", pair.mass_kg, pair.radius_m, pair.width_m)
        hub_m = (-pair.trail_m, 0.0, -FORK_M)
        yield _joint(f"caster_{name}", f"swivel_{name}", hub_m, axis="0 1 0")


def _rolling(name: str, mass_kg: float, radius_m: float, width_m: float) -> str:
    inertia = disc_inertia_kgm2(mass_kg, radius_m, width_m)
    return (
        f'<link name="{name}">{_inertial(mass_kg, inertia, _ORIGIN)}'
        # A cylinder of URDF stands along z; a wheel's axle is y.
        '<collision><origin rpy="1.5707963267948966 0 0"/><geometry>'
        f'<cylinder radius="{radius_m}" length="{width_m}"/></geometry></collision></link>'
    )


def _joint(
    child: str,
    parent: str,
    at_m: Vec3,
    axis: str | None,
    kind: str = "continuous",
    limit: tuple[float, float, float, float] | None = None,
) -> str:
    """A joint of one of URDF's kinds; fixed without an axis.

    The limits are those of its place (lower, upper), effort and speed.
    """
    moves = f'<axis xyz="{axis}"/>' if axis else ""
    if axis is None:
        kind = "fixed"
    if limit is not None:
        low, high, effort, speed = limit
        moves += f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{speed}"/>'
    return (
        f'<joint name="{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(at_m)}"/>{moves}</joint>'
    )


def _inertial(mass_kg: float, inertia_kgm2: Vec3, com_m: Vec3) -> str:
    xx, yy, zz = inertia_kgm2
    return (
        f'<inertial><origin xyz="{_text(com_m)}"/><mass value="{mass_kg}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _text(vector: Vec3) -> str:
    # All digits, so that PyBullet reads the very number.
    return " ".join(repr(float(value)) for value in vector)

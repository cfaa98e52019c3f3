"""A plant as a body in PyBullet: loaded, its links and joints by name, frictions set, and given back."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.errors import ConfigError, PhysicsError
from wcsim.physics.bullet import pybullet
from wcsim.physics.engine import Engine
from wcsim.physics.wheelchair.false_contacts import Tyre
from wcsim.physics.wheelchair.plant import PlantSpec
from wcsim.physics.wheelchair.plant_urdf import disc_inertia_kgm2, urdf

FRAME: Final = -1  # PyBullet's index of the base link
_MOST_RADPS: Final = 30.0  # of any joint: a car that hits a caster would whirl its light fork round, into itself
_SPARE: Final = 1.5  # faster chairs need their casters to turn so much faster than they roll at top speed
_STABLE: Final = 0.8  # of the damping at which a sprung arm would swing up without end
_JOINT_ORDER: Final = ("wheel", "arm", "beam", "swivel", "caster")


@dataclass(frozen=True, slots=True, kw_only=True)
class Spring:
    """The spring and damper of a sprung caster's arm."""

    stiffness_Npm: float
    damping_Nspm: float
    preload_N: float

    def force_N(self, up_m: float, up_mps: float) -> float:
        """Force along the arm, upwards positive, when the caster is so far up and moves so fast."""
        return -self.preload_N - self.stiffness_Npm * up_m - self.damping_Nspm * up_mps


@dataclass(frozen=True, slots=True, kw_only=True)
class ChairBody:
    """What PyBullet calls the parts of one loaded chair."""

    id: int
    links: dict[str, int]  # by name; a joint is named like the link that it carries
    joints: tuple[int, ...]  # all that move: the drive wheels first, then the arms
    drives: tuple[int, int]
    arms: tuple[int, ...]
    springs: tuple[Spring, ...]  # one for each arm
    part: dict[int, str]  # of every link that may touch the ground
    tyres: dict[int, Tyre]


def check_springs(spec: PlantSpec, step_s: float) -> None:
    """Raise ConfigError when steps of `step_s` would make a sprung arm swing up without end."""
    for number, pair in enumerate(spec.casters):
        if pair.arm is None:
            continue
        unsprung_kg = pair.arm.mass_kg + pair.fork_mass_kg + pair.mass_kg
        # bound of a spring that is pushed once a step: k dt^2 + 2 c dt < 4 m
        most_Nspm = 0.5 * (_STABLE * 4.0 * unsprung_kg / step_s - pair.arm.stiffness_Npm * step_s)
        if pair.arm.damping_Nspm > most_Nspm:
            raise ConfigError(
                f"casters.{number}.arm.damping_Nspm is {pair.arm.damping_Nspm:g} Ns/m: too stiff for physics steps of "
                f"{step_s:.5f} s with {unsprung_kg:g} kg below the spring; expected at most "
                f"{max(most_Nspm, 0.0):.0f} Ns/m, or more world.substeps"
            )


def load_body(engine: Engine, spec: PlantSpec, v_max_mps: float) -> ChairBody:
    """Load a plant that drives so fast at most.

    Raises:
        ConfigError: Its springs are too stiff for the engine's step.
        PhysicsError: PyBullet refused it.
    """
    check_springs(spec, engine.step_s)
    return dressed(engine, _load(urdf(spec), engine.client), spec, v_max_mps)


def dressed(engine: Engine, number: int, spec: PlantSpec, v_max_mps: float) -> ChairBody:
    """A loaded body with frictions and springs of a plant whose URDF is the one it was loaded from."""
    client = engine.client
    count = pybullet.getNumJoints(number, physicsClientId=client)
    links = {pybullet.getJointInfo(number, i, physicsClientId=client)[1].decode(): i for i in range(count)}
    order = {name: _JOINT_ORDER.index(_part(name)) for name in links if _part(name) in _JOINT_ORDER}
    joints = sorted(order, key=lambda name: (order[name], links[name]))
    arms = [name for name in joints if _part(name) == "arm"]
    body = ChairBody(
        id=number,
        links=links,
        joints=tuple(links[name] for name in joints),
        drives=(links["wheel_l"], links["wheel_r"]),
        arms=tuple(links[name] for name in arms),
        springs=tuple(_spring(spec, _pair(name)) for name in arms),
        part={index: _part(name) for name, index in links.items() if _part(name) not in ("arm", "beam", "swivel")},
        tyres={index: tyre for name, index in links.items() if (tyre := _tyre(spec, name)) is not None},
    )
    least_radius_m = min(pair.radius_m for pair in spec.casters)
    _set_dynamics(body, spec, max(_MOST_RADPS, _SPARE * v_max_mps / least_radius_m), client)
    return body


def _load(text: str, client: int) -> int:
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER
    with tempfile.TemporaryDirectory(prefix="wcsim-") as folder:
        path = Path(folder) / "chair.urdf"
        path.write_text(text, encoding="utf-8")
        try:
            return int(pybullet.loadURDF(str(path), flags=flags, physicsClientId=client))
        except pybullet.error as error:
            raise PhysicsError(f"PyBullet refused the wheelchair ({error}); expected a body: check the plant") from None


def _set_dynamics(body: ChairBody, spec: PlantSpec, most_radps: float, client: int) -> None:
    """Friction per part, no damping, and PyBullet's default joint motors off but for the friction of bearings."""
    # in a call of their own: beside one of these three PyBullet puts a link's friction on the base instead
    pybullet.changeDynamics(
        body.id, FRAME, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=most_radps, physicsClientId=client
    )
    for name, index in (("frame", FRAME), *body.links.items()):
        pybullet.changeDynamics(
            body.id,
            index,
            lateralFriction=_friction(spec, name),
            rollingFriction=0.0,
            spinningFriction=0.0,
            jointDamping=0.0,
            physicsClientId=client,
        )
    _turn_rotors(body, spec, client)
    for name, index in body.links.items():
        if not name.startswith("antitip"):
            torque = _bearing_Nm(spec, name)
            pybullet.setJointMotorControl2(
                body.id, index, pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=torque, physicsClientId=client
            )


def _bearing_Nm(spec: PlantSpec, link: str) -> float:
    """Friction in the bearing of a link's joint."""
    if _part(link) == "swivel":
        return spec.casters[_pair(link)].swivel_friction_Nm
    beam = spec.casters[_pair(link)].beam if _part(link) == "beam" else None
    return beam.friction_Nm if beam is not None else 0.0


def _turn_rotors(body: ChairBody, spec: PlantSpec, client: int) -> None:
    """Give the drive wheels the inertia of the motors' rotors, which turn with them; URDF refuses such a wheel.

    Without it a wheel is so light beside the chair that the solver does not end, and the chair creeps down slopes.
    """
    wheel = spec.wheel
    across, along, _ = disc_inertia_kgm2(wheel.mass_kg, wheel.radius_m, wheel.width_m)
    inertia = (across, along + spec.motor.rotor_inertia_kgm2, across)
    for index in body.drives:
        pybullet.changeDynamics(body.id, index, localInertiaDiagonal=inertia, physicsClientId=client)


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


def _tyre(spec: PlantSpec, link: str) -> Tyre | None:
    part = _part(link)
    if part not in ("wheel", "caster"):
        return None
    wheel = spec.wheel if part == "wheel" else spec.casters[_pair(link)]
    return Tyre(radius_m=wheel.radius_m, half_width_m=0.5 * wheel.width_m)


def _spring(spec: PlantSpec, number: int) -> Spring:
    arm = spec.casters[number].arm
    if arm is None:
        raise PhysicsError(f"casters.{number} has no arm; expected one: its body is that of another plant")
    return Spring(stiffness_Npm=arm.stiffness_Npm, damping_Nspm=arm.damping_Nspm, preload_N=arm.preload_N)

"""A plant as URDF text.

Joints are named like the link that they carry: `wheel_l`; for each pair of casters by its number `beam_0` (when
they share one), `arm_0_l` (when sprung), `swivel_0_l` and `caster_0_l`; `antitip_0_l`; and the same with `_r`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from wcsim.config.plant import ArmPart, BeamPart, CasterPart
from wcsim.core.frames import rad
from wcsim.physics.wheelchair.plant import FORK_COM_M, FORK_M, PlantSpec

Vec3 = tuple[float, float, float]
_ORIGIN: Final[Vec3] = (0.0, 0.0, 0.0)
_SIDES: Final = (("l", 1.0), ("r", -1.0))
BEAM_INERTIA_KGM2: Final = 0.01  # about its length, small beside everything else
_ARM_INERTIA_KGM2: Final = 0.01
_ARM_EFFORT_N: Final = 1e4
_ARM_MPS: Final = 20.0
_BEAM_EFFORT_NM: Final = 1e4
_BEAM_RADPS: Final = 50.0


def urdf(spec: PlantSpec) -> str:
    """The text; the frame is the base link."""
    links = (_frame(spec), *_wheels(spec), *_casters(spec), *_antitips(spec))
    return "\n".join(('<robot name="wheelchair">', *links, "</robot>"))


def disc_inertia_kgm2(mass_kg: float, radius_m: float, width_m: float) -> Vec3:
    """Principal moments of inertia of a disc whose axle is y."""
    across = mass_kg * (3.0 * radius_m**2 + width_m**2) / 12.0
    return across, 0.5 * mass_kg * radius_m**2, across


def _frame(spec: PlantSpec) -> str:
    boxes = "".join(
        f'<collision><origin xyz="{_text(box.centre_m)}"/>'
        f'<geometry><box size="{_text(box.size_m)}"/></geometry></collision>'
        for box in spec.frame.boxes
    )
    inertial = _inertial(spec.frame_mass_kg, spec.frame_inertia_kgm2, spec.frame_com_m)
    return f'<link name="frame">{inertial}{boxes}</link>'


def _wheels(spec: PlantSpec) -> Iterator[str]:
    wheel = spec.wheel
    for side, sign in _SIDES:
        yield _rolling(f"wheel_{side}", wheel.mass_kg, wheel.radius_m, wheel.width_m)
        yield _joint(f"wheel_{side}", "frame", (0.0, sign * 0.5 * wheel.track_m, wheel.radius_m), axis="0 1 0")


def _casters(spec: PlantSpec) -> Iterator[str]:
    for number, pair in enumerate(spec.casters):
        parent, x_m, z_m = "frame", pair.swivel_x_m, pair.radius_m + FORK_M
        if pair.beam is not None:
            parent, x_m, z_m = f"beam_{number}", 0.0, z_m - pair.beam.pivot_z_m
            yield from _beam(parent, pair, pair.beam)
        for side, sign in _SIDES:
            at = (x_m, sign * 0.5 * pair.track_m, z_m)
            if pair.arm is None:
                yield from _caster(f"{number}_{side}", pair, parent, at)
            else:
                yield from _arm(f"arm_{number}_{side}", pair.arm, at)
                yield from _caster(f"{number}_{side}", pair, f"arm_{number}_{side}", _ORIGIN)


def _arm(name: str, arm: ArmPart, at_m: Vec3) -> Iterator[str]:
    yield f'<link name="{name}">{_inertial(arm.mass_kg, (_ARM_INERTIA_KGM2,) * 3, _ORIGIN)}</link>'
    limit = f'<limit lower="{-arm.down_m}" upper="{arm.up_m}" effort="{_ARM_EFFORT_N}" velocity="{_ARM_MPS}"/>'
    yield _joint(name, "frame", at_m, axis="0 0 1", kind="prismatic", limit=limit)


def _beam(name: str, pair: CasterPart, beam: BeamPart) -> Iterator[str]:
    """A rod as long as the pair's track, level with the swivels; its pivot's axis is x."""
    long = beam.mass_kg * pair.track_m**2 / 12.0
    com = (0.0, 0.0, pair.radius_m + FORK_M - beam.pivot_z_m)
    inertia = (long, min(BEAM_INERTIA_KGM2, long), long)  # Bullet takes one that no body can have for none
    yield f'<link name="{name}">{_inertial(beam.mass_kg, inertia, com)}</link>'
    stop_rad = rad(beam.stop_deg)
    limit = f'<limit lower="{-stop_rad}" upper="{stop_rad}" effort="{_BEAM_EFFORT_NM}" velocity="{_BEAM_RADPS}"/>'
    yield _joint(name, "frame", (pair.swivel_x_m, 0.0, beam.pivot_z_m), axis="1 0 0", kind="revolute", limit=limit)


def _caster(name: str, pair: CasterPart, parent: str, at_m: Vec3) -> Iterator[str]:
    com, inertia = (-0.5 * pair.trail_m, 0.0, -FORK_COM_M), (pair.fork_inertia_kgm2,) * 3
    yield f'<link name="swivel_{name}">{_inertial(pair.fork_mass_kg, inertia, com)}</link>'
    yield _joint(f"swivel_{name}", parent, at_m, axis="0 0 1")
    yield _rolling(f"caster_{name}", pair.mass_kg, pair.radius_m, pair.width_m)
    yield _joint(f"caster_{name}", f"swivel_{name}", (-pair.trail_m, 0.0, -FORK_M), axis="0 1 0")


def _antitips(spec: PlantSpec) -> Iterator[str]:
    for number, item in enumerate(spec.antitips):
        shape = f'<collision><geometry><sphere radius="{item.radius_m}"/></geometry></collision>'
        inertial = _inertial(item.mass_kg, (item.inertia_kgm2,) * 3, _ORIGIN)
        x, y, z = item.p_m
        for side, sign in _SIDES:
            yield f'<link name="antitip_{number}_{side}">{inertial}{shape}</link>'
            yield _joint(f"antitip_{number}_{side}", "frame", (x, sign * y, z), axis=None)


def _rolling(name: str, mass_kg: float, radius_m: float, width_m: float) -> str:
    inertia = disc_inertia_kgm2(mass_kg, radius_m, width_m)
    return (
        f'<link name="{name}">{_inertial(mass_kg, inertia, _ORIGIN)}'
        '<collision><origin rpy="1.5707963267948966 0 0"/>'
        f'<geometry><cylinder radius="{radius_m}" length="{width_m}"/></geometry></collision></link>'
    )


def _joint(child: str, parent: str, at_m: Vec3, axis: str | None, kind: str = "continuous", limit: str = "") -> str:
    """A joint of one of URDF's kinds; fixed without an axis."""
    kind = "fixed" if axis is None else kind
    moves = f'<axis xyz="{axis}"/>{limit}' if axis else ""
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
    return " ".join(repr(float(value)) for value in vector)

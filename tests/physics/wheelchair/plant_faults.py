"""Faults of a plant that can be planted into the simulated body while its parameter file stays right."""

import re
from collections.abc import Callable
from typing import Any

import pytest

from wcsim.physics import engine
from wcsim.physics.bullet import Bullet, pybullet
from wcsim.physics.wheelchair import drive_controller, plant_body, wheelchair
from wcsim.physics.wheelchair.plant_body import urdf

Patch = pytest.MonkeyPatch
Plant = Callable[[Patch], None]


def _text(change: Callable[[str], str]) -> Plant:
    def plant(patch: Patch) -> None:
        patch.setattr(plant_body, "urdf", lambda spec: change(urdf(spec)))

    return plant


def _setting(index: int, value: float) -> Plant:
    def plant(patch: Patch) -> None:
        settings = drive_controller.settings

        def wrong(*words: Any) -> Any:
            out = settings(*words)
            out[index] = value
            return out

        patch.setattr(wheelchair.drive_controller, "settings", wrong)

    return plant


def _replaced(pattern: str, by: str) -> Plant:
    """Changes what is written twice."""

    def change(text: str) -> str:
        out, found = re.subn(pattern, by, text, flags=re.DOTALL)
        assert found == 2, f"{pattern}: found {found} times"
        return out

    return _text(change)


def _after_loading(act: Callable[[int, Bullet, dict[str, int]], None]) -> Plant:
    def plant(patch: Patch) -> None:
        set_dynamics = plant_body._set_dynamics

        def wrong(body: Any, spec: Any, most_radps: float, bullet: Bullet) -> None:
            set_dynamics(body, spec, most_radps, bullet)
            act(body.id, bullet, body.links)

        patch.setattr(plant_body, "_set_dynamics", wrong)

    return plant


def _damped(body: int, bullet: Bullet, links: dict[str, int]) -> None:
    bullet.changeDynamics(body, -1, linearDamping=0.04, angularDamping=0.04)


def _motors_left_on(body: int, bullet: Bullet, links: dict[str, int]) -> None:
    for name, index in links.items():
        if name.startswith("caster"):
            bullet.setJointMotorControl2(body, index, pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=1.0)


def _stuck(body: int, bullet: Bullet, links: dict[str, int]) -> None:
    bullet.setJointMotorControl2(body, links["beam_0"], pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=1e4)


def _half_friction(patch: Patch) -> None:
    friction = plant_body._friction
    patch.setattr(plant_body, "_friction", lambda spec, link: 0.5 * friction(spec, link))


def _tripled(match: re.Match[str]) -> str:
    return f'ixx="{3.0 * float(match[1])}" iyy="{3.0 * float(match[2])}" izz="{3.0 * float(match[3])}"'


def _back(match: re.Match[str]) -> str:
    return f'<origin xyz="{float(match[1]) - 0.05} '


FAULTS: dict[str, tuple[Plant, str]] = {
    "lost anti-tip": (_replaced(r'<(link|joint) name="antitip_0_r".*?</\1>', ""), "tip_rear_com_50cm"),
    "hull wheels": (lambda patch: patch.setattr(pybullet, "URDF_USE_IMPLICIT_CYLINDER", 0), "event_cruise"),
    "wrong inertia": (
        _text(lambda text: re.sub(r'ixx="(\S+)" iyy="(\S+)" izz="(\S+)"', _tripled, text, count=1)),
        "inertia_yaw",
    ),
    "centre of mass too far back": (
        _text(lambda text: re.sub(r'<origin xyz="(\S+) ', _back, text, count=1)),
        "drive_wheel_share",
    ),
    "damping left on": (_after_loading(_damped), "turning_loss"),
    "joint motors left on": (_after_loading(_motors_left_on), "coasting_loss"),
    "no torque curve": (_setting(drive_controller._LEAST_SHARE, 1.0), "pulling_400N"),
    "half the friction": (_half_friction, "grip"),
    "casters that lead": (
        _replaced(r'(<child link="caster_0_."/><origin xyz=")-', r"\1"),
        "tip_forward_com_50cm",
    ),
    "wrong gravity": (lambda patch: patch.setattr(engine, "GRAVITY_MPS2", 9.0), "mass"),
    "no parking brake": (_setting(drive_controller._BRAKE_TORQUE, 0.0), "parked_10deg_up"),
    "a beam that is stuck": (_after_loading(_stuck), "twisted_ramp_load"),
    "a beam that is stuck, to who stops": (_after_loading(_stuck), "twisted_ramp_stop"),
    "a beam that is stuck, to who turns": (_after_loading(_stuck), "twisted_ramp_turn"),
    "small drive wheels": (_replaced(r'radius="0.178"', 'radius="0.165"'), "turn_in_place"),
}
"""By name: how to plant it, and the row that turns red."""

"""A baseline, or a network of wcsim's own that a run folder holds, opened for the chair of a configuration."""

from __future__ import annotations

import torch

from wcsim.agents.danger.policy import load_danger
from wcsim.agents.learning.saved_policy import JOYSTICK_SIZE, NetPolicy, load_policy
from wcsim.agents.policies import baselines
from wcsim.agents.policies.dwa import Veto
from wcsim.agents.policy_api import Policy
from wcsim.agents.runs.policy_file import SIGHT_KEYS, is_danger, policy_name
from wcsim.agents.runs.run_folder import policy_path
from wcsim.config import RunConfig
from wcsim.errors import PolicyError
from wcsim.supervisor.observation import imu_size


def open_policy(name: str, config: RunConfig, seed: int = 0, network: str | None = None) -> Policy:
    """A policy by what a user calls it: a baseline's name, a run folder, `RUN:phase1`, or a policy folder.

    From a network on torch works on one thread in this process: one picture is too little for two, and where others use
    the cores they wait for one another, fifty times as long as the work takes.

    Raises PolicyError when there is none; `network` as in `load_policy`.
    """
    named = policy_name(name)
    if named.kind == "baseline":
        return baselines.baseline(name, config, seed)
    torch.set_num_threads(1)
    path = policy_path(name)
    if is_danger(path):
        return load_danger(path, name, config, named.level, network)
    policy = load_policy(path, network)
    camera, file = config.eye, policy.file
    if file.image_hw_px != (camera.height_px, camera.width_px) or file.net.actions != config.env.actions:
        raise PolicyError(
            f"policy {name!r} needs {file.image_hw_px[1]}x{file.image_hw_px[0]} images and actions {file.net.actions}; "
            f"this test has {camera.width_px}x{camera.height_px} and {config.env.actions}: test it alone"
        )
    numbers = imu_size(config.env.observe_gyro, config.env.observe_yaw) + JOYSTICK_SIZE
    wanted = file.vector_size - sum(file.sensors.values())
    if wanted != numbers:
        raise PolicyError(
            f"policy {name!r} needs {wanted} numbers from IMU and joystick, this test gives {numbers}: "
            "set env.observe_gyro and env.observe_yaw as in its training"
        )
    given = {key: len(measure.parts) for key, measure in config.sensors.measures().items()}
    if not file.sensors.items() <= given.items():
        raise PolicyError(
            f"policy {name!r} needs the sensors {file.sensors} (numbers of each), this test has {given}: "
            "set their sections of [sensors] as in its training"
        )
    other = [key for key in SIGHT_KEYS if getattr(file.camera, key) != getattr(camera, key)]
    forms = file.observation, config.env.observation
    if forms[0] != forms[1] and not (forms[0] == "compact" and forms[1] == "compact_rgb"):
        raise PolicyError(
            f"policy {name!r} sees env.observation={forms[0]}, this test has {forms[1]}: set it as in its training"
        )
    if other or file.net.classes != config.env.classes:
        raise PolicyError(
            f"policy {name!r} was trained with another camera or other classes than this test has "
            f"({', '.join(other) or 'env.classes'} differ): test it alone"
        )
    policy.name = name
    return policy


def window_of(policy: Policy) -> int:
    """Images that an observation must hold so that a policy sees enough; any other than a network needs the newest."""
    own = policy.inner if isinstance(policy, Veto) else policy
    return own.file.window if isinstance(own, NetPolicy) else 1

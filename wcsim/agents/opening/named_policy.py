"""Opens a policy by its name: a baseline, a run, a class, an ONNX folder, a process on a socket.

All policies of a list drive the same chair in the same world, and the same things are a crash. A
run brings what its network senses and does (cameras, sensors, `[imu]`, `[env]`, how it learned).
Its street, chair, crashes and ranges are left out: with them `saved`, `lost` and the score would
compare drives that were not judged alike.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from wcsim.agents.export.guard import GuardedPolicy, read_guard_rule
from wcsim.agents.opening.learner_registry import learner_from_policy
from wcsim.agents.policies.onnx_policy import (
    ExportedDangerPolicy,
    OnnxPolicy,
    read_onnx_policy_file,
)
from wcsim.agents.policies.served_policy import ServedPolicyClient
from wcsim.agents.policy_api import (
    STATE_SENSE,
    VISIBLE_BOUND,
    Policy,
    SeesTruth,
    sense_settings,
    senses_of,
)
from wcsim.agents.runs.policy_file import (
    EXPORTED,
    parse_policy_name,
    read_danger_policy_file,
    require_danger_policy_fits,
)
from wcsim.agents.runs.run_folder import policy_folder_from_name, run_from_policy_name
from wcsim.config import RunConfig, resolve
from wcsim.config.run_file import QPolicyFile
from wcsim.core.plugins import import_class, wrap_user_code_errors
from wcsim.core.reading import is_file
from wcsim.errors import PolicyError, check_installed
from wcsim.supervisor.actions import action_set
from wcsim.types import SeatSpec

# Sections that are the preset's in a list: with others its policies would not be judged alike.
RULES: Final = ("world", "chair", "reward", "vary")

# Of `world`: they change no result.
_PACE: Final = ("draw_threads", "epoch_ticks")


def open_named_policy(
    name: str, config: RunConfig, seed: int, network: str | None = None
) -> Policy:
    """The policy of that name for one chair; a network sets PyTorch to one thread.

    Args:
        name: The policy's name.
        config: The configuration of the world in which it drives.
        seed: Seed of a baseline that draws random numbers.
        network: The user's own network that may be loaded, `module:Class`.

    Raises:
        PolicyError: There is no such policy, or it does not fit the configuration.
    """
    actions = action_set(config.env.actions)
    named = parse_policy_name(name)
    if named.veto:
        # Not at the top: it loads kernels, which checks of names must not load.
        from wcsim.agents.policies.dwa import VetoPolicy

        inner = open_named_policy(named.inner, config, seed, network)
        # An exported law gives one action, and a veto needs the dangers of all.
        if isinstance(inner, ExportedDangerPolicy):
            check_installed(f"policy {name!r} needs PyTorch", "train", "torch", error=PolicyError)
        return VetoPolicy(name, inner, config)
    if named.kind == "served":
        return ServedPolicyClient(name, actions.points)
    if named.kind == "onnx":
        alone, rule = OnnxPolicy(Path(name), name, len(actions)), read_guard_rule(Path(name))
        return alone if rule is None else GuardedPolicy(alone, actions, rule)
    if named.kind == "class":
        return _own_policy(name, config)
    if named.kind == "baseline":
        # Loads kernels, too.
        from wcsim.agents.policies.baselines import make_baseline_policy

        return make_baseline_policy(name, config, seed)
    folder = policy_folder_from_name(name)
    # A law has the level of its policy, and knows no network of the user's own.
    is_exported = named.level is None and network is None
    law = _law_without_torch(folder, config) if is_exported else ""
    if law:
        require_danger_policy_fits(folder, name, config)
        return ExportedDangerPolicy(folder, name, law, config)
    # Not at the top: checks of names must not load it.
    import torch

    # One picture is too little for two threads: on busy cores they wait for one another, fifty
    # times as long as the work takes.
    torch.set_num_threads(1)
    learner = learner_from_policy(folder)
    return learner.load_policy(folder, name, config, named.level, network)


def _law_without_torch(folder: Path, config: RunConfig) -> str:
    """The exported law of this delay and chair, for a network without PyTorch; "" for none."""
    # A law is exported for one fixed delay.
    if find_spec("torch") is not None or config.vary.action_delay_ticks:
        return ""
    law = EXPORTED.get(config.world.action_delay_ticks, "")
    fits = law and is_file(folder / law) and read_danger_policy_file(folder).chair == config.chair
    return law if fits else ""


def _own_policy(name: str, config: RunConfig) -> Policy:
    policy_class = import_class(name, "policy")
    what = f"policy {name!r} could not be created with the configuration as its only argument"
    with wrap_user_code_errors(what, "correct it, or test the others without it"):
        policy: Policy = policy_class(config)
    missing = [part for part in ("name", "begin", "reset", "act") if not hasattr(policy, part)]
    if missing:
        raise PolicyError(
            f"policy {name!r} has no {', '.join(missing)}; expected a class with name, begin(), "
            "reset() and act(observation), see docs/suites.md"
        )
    return policy


def list_policy_overrides(config: RunConfig, policy: Policy) -> tuple[str, ...]:
    """The settings of a policy's senses, and of as many images in an observation as it needs."""
    # A network of Q-learning needs as many images as it was trained on; `env.window` may give more.
    from wcsim.agents.policies.dwa import VetoPolicy

    inner = policy.inner if isinstance(policy, VetoPolicy) else policy
    file = getattr(inner, "file", None)
    trained = file.window if isinstance(file, QPolicyFile) else 1
    window = f"env.window={max(trained, config.env.frames)}"
    return (window, *sense_settings(config, senses_of(policy)))


def make_policy_seat_spec(policy: Policy, profile: str) -> SeatSpec:
    """A seat for this policy and user, with the parts of the truth that the policy gets."""
    return SeatSpec(
        profile=profile,
        truth=isinstance(policy, SeesTruth),
        truth_visible=policy.name == VISIBLE_BOUND,
        near=STATE_SENSE in senses_of(policy),
    )


def resolve_policy_config(
    policy: str, preset: str, settings: Sequence[str] = (), *, in_list: bool = False
) -> RunConfig:
    """The configuration that a policy drives with: its own or else the preset's, under `settings`.

    Args:
        policy: The policy's name.
        preset: The preset of the command that drives it.
        settings: section.key=value.
        in_list: Whether the preset's rules hold, see `RULES`.

    Raises:
        PolicyError: There is no such policy.
        ConfigError: The settings cannot be used.
    """
    named = parse_policy_name(policy)
    base = resolve(preset)
    own = base
    # Baselines, classes and served policies bring no settings.
    if named.kind == "onnx":
        about = read_onnx_policy_file(named.folder)
        own = resolve(about.preset, about.settings)
    elif named.is_network:
        run = run_from_policy_name(policy)
        if run is None:
            folder = policy_folder_from_name(policy)
            own = resolve(base, learner_from_policy(folder).policy_settings(folder))
        else:
            own = run.config
    if in_list:
        own = own.model_copy(update={name: getattr(base, name) for name in RULES})
    config = resolve(own, settings)
    action_set(config.env.actions)
    return config


def describe_rule_differences(
    policies: Iterable[str], preset: str, settings: tuple[str, ...]
) -> Iterator[str]:
    """A line for each policy that was trained under other rules than the list's, or never warns.

    Raises:
        PolicyError, ConfigError: See `resolve_policy_config`.
    """
    for policy in policies:
        named = parse_policy_name(policy)
        if named.kind in ("baseline", "served", "class"):
            continue
        if named.kind == "onnx" and not named.veto:
            # What cannot be loaded is refused when it is opened to drive.
            with suppress(PolicyError):
                if not hasattr(OnnxPolicy(named.folder, policy, 0), "warning"):
                    yield f"{policy} never warns: its model has no output warning; export again"
        learned = resolve_policy_config(policy, preset, settings, in_list=False)
        tested = resolve_policy_config(policy, preset, settings, in_list=True)
        other = list(_others(learned, tested))
        if other:
            was = ", ".join(f"{name}={_text(value)}" for name, value, _ in other)
            now = ", ".join(f"{name}={_text(value)}" for name, _, value in other)
            yield f"{policy} was trained with {was}; all policies of a list are tested with {now}"


def _others(learned: RunConfig, tested: RunConfig) -> Iterator[tuple[str, Any, Any]]:
    """The keys of `RULES` that differ, each with both values."""
    for name in RULES:
        one, two = getattr(learned, name), getattr(tested, name)
        for key in type(one).model_fields:
            was, now = getattr(one, key), getattr(two, key)
            if was != now and key not in _PACE:
                yield f"{name}.{key}", was, now


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)

"""How commands make a run's configuration, and check the policies and users that they name."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wcsim.agents.networks.names import check_network, is_own, require_named
from wcsim.agents.opening.learner_registry import Learner, learner_of, learner_of_policy
from wcsim.agents.policy_api import VETO
from wcsim.agents.runs.policy_file import EXPORTED, policy_name
from wcsim.agents.runs.run_folder import ResolvedRun, policy_path, whole_data
from wcsim.bridge.sumo.step_hook import find_hook
from wcsim.cli.shared.common import check_folder
from wcsim.config import RunConfig, resolve
from wcsim.config.load import sets_key
from wcsim.core import reading, seeding
from wcsim.core.constants import RECORDED
from wcsim.core.plugins import find_class
from wcsim.core.reading import SETTINGS, escaped, is_file
from wcsim.errors import ConfigError, PolicyError, check_installed
from wcsim.server.specs import RunInfo
from wcsim.supervisor.rewards import find_reward_term
from wcsim.towns.scenario.overrides import Override, Settings, scenario_overrides
from wcsim.towns.scenario.town import Town, streets_hash
from wcsim.users.profiles import HELD_OUT, find_profile


def require_policy(name: str, network: str, *, alone: bool = False, bare_for: str = "") -> None:
    """Refuse a name of no policy, and a policy whose own network was not named.

    Args:
        name: The policy; one that is module:Class is imported.
        network: The own network that was named, "" for none.
        alone: It is the command's only policy, and has to use the network that was named.
        bare_for: What uses the network alone, without a veto; "" where the policy drives.

    Raises:
        PolicyError: There is no such policy, class or network, its network was not named, or
            another one was.
    """
    named = policy_name(name)
    used = ""
    if bare_for and named.veto:
        raise PolicyError(
            f"{escaped(name)}: {bare_for} uses the network alone; expected {escaped(named.inner)}, "
            f"without {VETO}"
        )
    if named.kind == "class":
        find_class(named.inner, "policy")
    elif named.is_network:
        path = policy_path(name)
        used = learner_of_policy(path).read_policy(path).net.network
        if is_own(used):
            require_named(escaped(name), used, network)
        by_law = (
            named.level is None
            and not named.veto
            and any(is_file(path / law) for law in EXPORTED.values())
        )
        if not by_law:
            check_installed(f"{escaped(name)} needs PyTorch", "train", "torch", error=PolicyError)
    if alone and network:
        check_network(network)
        if used != network:
            raise PolicyError(
                f"--network {escaped(network, 80)}: {escaped(name)} does not use it; leave it out"
            )


def require_learner(config: RunConfig, expected: Learner) -> None:
    """Raise ConfigError for settings of another learner than a command's own."""
    found = learner_of(config)
    if found is not expected:
        raise ConfigError(
            f"learn.head={config.learn.head}: this command {expected.method}; expected preset "
            f"{expected.presets}, or wcsim {found.command}"
        )


def require_users(
    config: RunConfig, drawn: tuple[Sequence[str], Path | None] | None = None
) -> None:
    """Refuse simulated users that are kept for tests.

    Args:
        config: The configuration of the drives.
        drawn: Where users are drawn from `collect.profiles`: the section.key=value and the TOML
            file that made `config`. A setting of `env.profile`, which would have no effect, and
            users that do not exist are refused then.

    Raises:
        ConfigError: A user cannot be used.
    """
    for key, names in (
        ("env.profile", (config.env.profile,)),
        ("collect.profiles", config.collect.profiles),
    ):
        for name in names:
            if name in HELD_OUT:
                raise ConfigError(
                    f"profile {name} is held out of training: tests use it as a user that a "
                    f"network has never met; expected another {key}"
                )
    if drawn is None:
        return
    settings, file = drawn
    require_user(config.env.profile)
    own = {} if file is None else reading.read_toml(file, SETTINGS).get("env", {})
    if "profile" in own or any(sets_key(text, "env.profile") for text in settings):
        name = config.env.profile
        raise ConfigError(
            f"env.profile={escaped(name)}: a network that learns in rounds draws its users from "
            f"collect.profiles; expected --set 'collect.profiles=[\"{escaped(name)}\"]', or wcsim "
            "train-q, which learns with that user"
        )
    require_user(*config.collect.profiles)


def resolve_run(
    config: RunConfig, info: RunInfo, town: Town, out: Path, resume: bool = False
) -> ResolvedRun:
    """The run of a configuration in a town, with all that learner, network and town fix.

    Args:
        config: The resolved configuration.
        info: Seed, command, and the user's own classes.
        town: To train in.
        out: The run folder.
        resume: Go on with the run in it.

    Raises:
        PolicyError, ConfigError, HookError: A name stands for nothing, or the folder cannot be one.
    """
    check_folder("--out", out)
    check_network(config.learn.network)
    for name in info.rewards:
        find_reward_term(name)
    if info.hook:
        find_hook(info.hook)
    require_user(config.env.profile)

    # PyTorch is loaded here: not for --help, nor for a refusal.
    from wcsim.agents.learning.build import network_settings
    from wcsim.agents.networks.registry import find_network

    find_network(config.learn.network)
    fit = resolve(config, learning(config), network_settings(config))
    return ResolvedRun(config=fit, out=out, info=in_town(info, town, config), resume=resume)


def in_town(info: RunInfo, town: Town, config: RunConfig) -> RunInfo:
    """The run's facts, with those of its town."""
    overrides = overrides_of(town, config, info.seed)
    return replace(info, town=town.name, town_sha256=streets_hash(town), overrides=overrides)


def learning(config: RunConfig) -> dict[str, Any]:
    """The settings that a learner fixes: the length of episodes, and the truth for its oracle.

    Learning in rounds sets the truth of its worlds itself.
    """
    env = {
        "max_steps": config.learn.episode_steps,
        "truth": config.learn.aid == "oracle",
        "truth_visible": False,
    }
    return {"env": env, **whole_data(config)}


def require_user(*names: str) -> None:
    """Refuse users that do not exist.

    Raises:
        ConfigError: There is no such profile, or no such file.
    """
    for name in names:
        if not name.startswith(RECORDED):
            find_profile(name)
            continue
        # Not at the top: what replays a recorded joystick takes long to load.
        from wcsim.users.recordings.recorded_user import find_user

        find_user(name)


def how_to_test(run: Path, network: str, trained_in: Collection[str] = ()) -> str:
    """The command that tests a run, as it can be typed.

    >>> how_to_test(Path("runs/a b"), "own_network:OwnNet", ("helsinki", "monaco"))
    "wcsim test 'runs/a b' --network own_network:OwnNet --town manhattan"
    """
    named = ["--network", network] if is_own(network) else []
    unseen = "manhattan" if "monaco" in trained_in else "monaco"
    return shlex.join(["wcsim", "test", str(run), *named, "--town", unseen])


def overrides_of(town: Town, config: RunConfig, seed: int) -> tuple[Override, ...]:
    """What a run overrides of a town's own SUMO options."""
    return scenario_overrides(
        town.sumocfg, Settings(world=config.world, seed=seeding.derive(seed, "sumo"))
    )

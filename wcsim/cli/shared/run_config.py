"""How commands make a run's configuration, and check the policies and users that they name."""

import shlex
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wcsim.agents.networks.names import (
    is_custom_network,
    require_known_network,
    require_trusted_network,
)
from wcsim.agents.opening.learner_registry import Learner, learner_from_config, learner_from_policy
from wcsim.agents.policy_api import VETO
from wcsim.agents.runs.data_folder import read_data_manifest
from wcsim.agents.runs.policy_file import EXPORTED, parse_policy_name
from wcsim.agents.runs.run_folder import ResolvedRun, policy_folder_from_name, resolve_data_folders
from wcsim.bridge.sumo.step_hook import find_hook
from wcsim.cli.shared.common import require_writable_folder
from wcsim.config import RunConfig, resolve
from wcsim.config.held_out import refuse_held_out
from wcsim.config.load import is_override_of_key
from wcsim.config.run_file import QPolicyFile
from wcsim.core import reading, seeding
from wcsim.core.constants import RECORDED
from wcsim.core.plugins import import_class
from wcsim.core.reading import PROFILE, SETTINGS, escape, is_file
from wcsim.errors import ConfigError, PolicyError, check_installed
from wcsim.server.specs import RunInfo
from wcsim.supervisor.rewards import make_reward_term
from wcsim.towns.scenario.overrides import Override, Settings
from wcsim.towns.scenario.stage import scenario_overrides
from wcsim.towns.scenario.town import Town, streets_hash
from wcsim.users.profiles import find_profile


def require_usable_policy(
    name: str, network: str, *, alone: bool = False, bare_for: str = ""
) -> None:
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
    named = parse_policy_name(name)
    used = ""
    if bare_for and named.veto:
        raise PolicyError(
            f"{escape(name)}: {bare_for} uses the network alone; expected {escape(named.inner)}, "
            f"without {VETO}"
        )
    if named.kind == "class":
        import_class(named.inner, "policy")
    elif named.is_network:
        path = policy_folder_from_name(name)
        file = learner_from_policy(path).read_policy(path)
        used = file.net.network if isinstance(file, QPolicyFile) else ""
        if is_custom_network(used):
            require_trusted_network(escape(name), used, network)
        by_law = (
            named.level is None
            and not named.veto
            and any(is_file(path / law) for law in EXPORTED.values())
        )
        if not by_law:
            check_installed(f"{escape(name)} needs PyTorch", "train", "torch", error=PolicyError)
    if alone and network:
        require_known_network(network)
        if used != network:
            raise PolicyError(
                f"--network {escape(network, 80)}: {escape(name)} does not use it; leave it out"
            )


def require_matching_learner(config: RunConfig, expected: Learner) -> None:
    """Raise ConfigError for settings of another learner than a command's own."""
    found = learner_from_config(config)
    if found is not expected:
        raise ConfigError(
            f"learn.head={config.learn.head}: this command {expected.method}; expected preset "
            f"{expected.presets}, or wcsim {found.command}"
        )


def refuse_held_out_users(
    config: RunConfig, drawn: tuple[Sequence[str], Path | None] | None = None
) -> None:
    """Refuse simulated users, and recorded driving, that are kept for tests.

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
        refuse_held_out("profile", names, key)
        files = (Path(name) for name in names if name.endswith(".toml"))
        refuse_held_out(
            "profile", (reading.read_toml(file, PROFILE).get("base") for file in files), key
        )
    for folder in config.collect.data:
        data = read_data_manifest(Path(folder))
        refuse_held_out("profile", data.config.get("collect", {}).get("profiles", ()), folder)
        refuse_held_out("town", data.towns, folder)
    if drawn is None:
        return
    settings, file = drawn
    require_known_users(config.env.profile)
    own = {} if file is None else reading.read_toml(file, SETTINGS).get("env", {})
    if "profile" in own or any(is_override_of_key(text, "env.profile") for text in settings):
        name = config.env.profile
        raise ConfigError(
            f"env.profile={escape(name)}: a network that learns in rounds draws its users from "
            f"collect.profiles; expected --set 'collect.profiles=[\"{escape(name)}\"]', or wcsim "
            "train-q, which learns with that user"
        )
    require_known_users(*config.collect.profiles)


def resolve_run_settings(
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
    require_writable_folder("--out", out)
    require_known_network(config.learn.network)
    for name in info.rewards:
        make_reward_term(name)
    if info.hook:
        find_hook(info.hook)
    require_known_users(config.env.profile)

    # PyTorch is loaded here: not for --help, nor for a refusal.
    from wcsim.agents.learning.build import default_settings_for_network
    from wcsim.agents.networks.registry import find_network

    find_network(config.learn.network)
    fit = resolve(config, settings_from_learner(config), default_settings_for_network(config))
    return ResolvedRun(
        config=fit, out=out, info=add_town_to_run_info(info, town, config), resume=resume
    )


def add_town_to_run_info(info: RunInfo, town: Town, config: RunConfig) -> RunInfo:
    """The run's facts, with those of its town."""
    overrides = list_sumo_overrides(town, config, info.seed)
    return replace(info, town=town.name, town_sha256=streets_hash(town), overrides=overrides)


def settings_from_learner(config: RunConfig) -> dict[str, Any]:
    """The settings that a learner fixes: the length of episodes, and the truth for its oracle.

    Learning in rounds sets the truth of its worlds itself.
    """
    env = {
        "max_steps": config.learn.episode_steps,
        "truth": config.learn.aid == "oracle",
        "truth_visible": False,
    }
    return {"env": env, **resolve_data_folders(config)}


def require_known_users(*names: str) -> None:
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


def format_test_command(run: Path, network: str, trained_in: Collection[str] = ()) -> str:
    """The command that tests a run, as it can be typed.

    >>> format_test_command(Path("runs/a b"), "own_network:OwnNet", ("helsinki", "monaco"))
    "wcsim test 'runs/a b' --network own_network:OwnNet --town manhattan"
    """
    named = ["--network", network] if is_custom_network(network) else []
    unseen = "manhattan" if "monaco" in trained_in else "monaco"
    return shlex.join(["wcsim", "test", str(run), *named, "--town", unseen])


def list_sumo_overrides(town: Town, config: RunConfig, seed: int) -> tuple[Override, ...]:
    """What a run overrides of a town's own SUMO options."""
    return scenario_overrides(
        town, Settings(world=config.world, seed=seeding.derive_seed(seed, "sumo"))
    )

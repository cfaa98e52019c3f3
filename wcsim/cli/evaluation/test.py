"""`wcsim test`: trained networks in a town that they have never seen, compared with baselines."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from wcsim.agents.networks.names import require_known_network
from wcsim.agents.opening.named_policy import resolve_policy_config
from wcsim.agents.policy_api import UNAIDED
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.agents.runs.run_folder import run_from_policy_name
from wcsim.bridge.sumo.step_hook import find_hook
from wcsim.cli.evaluation.judged_suite import (
    SuiteTestOptions,
    make_suite_order,
    run_make_suite_command,
    run_suite_and_report,
    run_suites,
)
from wcsim.cli.shared.common import (
    AllowedSettingKeys,
    Bounds,
    ExistingName,
    Flag,
    Repeated,
    has_option,
    parse_options,
    require_writable_folder,
    split_nonempty_list,
)
from wcsim.cli.shared.consoles import print_sumo_overrides, stdout_console
from wcsim.cli.shared.run_config import (
    list_sumo_overrides,
    require_known_users,
    require_usable_policy,
)
from wcsim.core.constants import RECORDED
from wcsim.core.own_folder import create_temporary_folder
from wcsim.errors import ConfigError, TownError
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.town import (
    Town,
    by_name,
    content_hash,
    find_town,
    list_towns,
    streets_hash,
)

if TYPE_CHECKING:  # loads torch, which --help must not
    from wcsim.agents.evaluation.suite.run import SuiteOrder

_MAX_STEPS: Final = 1_000_000  # as in env.max_steps


@dataclass
class PolicyTestOptions(SuiteTestOptions):
    """Test policies: runs (RUN, RUN:phase1), shipped, your own module:Class, or baselines.

    The episodes are drawn for --town. With --suite LIST they come from a fixed list
    (`wcsim test --suite dev2 -h`); --make-suite TOWN makes such a list.
    """

    set: Annotated[
        Repeated,
        AllowedSettingKeys(
            {"env.profile": "expected --profile NAME", "env.max_steps": "expected --max-steps N"}
        ),
    ] = ()
    """section.key=value, over the settings of the preset."""
    town: str = "monaco"
    """A town's name, its folder, or a .sumocfg file; several are separated by commas."""
    profile: str = "inattentive"
    """User profiles, separated by commas; FILE.toml is your own, recorded:FILE replays a recording."""  # noqa: E501
    episodes: Annotated[int, Bounds(1)] = 5
    """Episodes for each policy, town and profile."""
    max_steps: Annotated[int, Bounds(1, _MAX_STEPS)] = 10_000
    """Steps after which an episode ends without a crash."""
    seed: int = 0
    """Seed of the episodes, the same for every policy."""
    network: Annotated[str, ExistingName(require_known_network)] = ""
    """Your own network as module:Class, for runs that were trained with it."""
    hook: Annotated[str, ExistingName(find_hook)] = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""  # noqa: E501
    allow_train_town: bool = False
    """Allow a town that is for training, or the town that a run was trained in."""
    verbose: Flag = False
    """Show which of the town's SUMO options are overridden, with the reasons."""


def run(words: list[str]) -> int:
    """Test and print the tables of each town and profile, or pass on to what a list needs."""
    if has_option(words, "--make-suite"):
        return run_make_suite_command(words)
    if has_option(words, "--suite"):
        return run_suites(words)
    options = parse_options(PolicyTestOptions, words, "test")
    with _town_order(options) as (order, name):
        return run_suite_and_report(order, options, name)


@contextlib.contextmanager
def _town_order(options: PolicyTestOptions) -> Iterator[tuple[SuiteOrder, str]]:
    """How the episodes of a town are driven, and the name of their list.

    The list is written once all of it is driven. Without `--out` its folder is temporary.
    """
    towns, profiles = _checked_places(options)
    if options.out is not None:
        require_writable_folder("--out", options.out / "x")
    elif options.resume:
        raise ConfigError("--resume needs the folder of the test: --out FOLDER")
    for name in options.policies:
        require_usable_policy(name, options.network)
    config = resolve_policy_config(UNAIDED, options.preset, options.set, in_list=True)

    # These load the simulators and torch, which a refusal must not.
    from wcsim.agents.evaluation.suite.make import town_list
    from wcsim.agents.evaluation.suite.result_files import LIST
    from wcsim.agents.opening.list_file import suite_from_file, write_list

    for town in towns.values():
        overrides = list_sumo_overrides(town, config, options.seed)
        print_sumo_overrides(stdout_console(), town.name, overrides, verbose=options.verbose)
    file = town_list(
        list(towns.values()),
        profiles,
        options.episodes,
        options.max_steps,
        options.seed,
        settings=options.set,
        chairs=len(set(options.policies)) if options.together else 1,
    )
    suite = suite_from_file(file)
    with contextlib.ExitStack() as opened:
        out = options.out or opened.enter_context(create_temporary_folder())
        # The list holds the settings already.
        order = make_suite_order(options, suite, out, options.forks)
        yield replace(order, settings=(), hook=options.hook), str(out / LIST)
        write_list(suite.file, out / LIST)


def _checked_places(options: PolicyTestOptions) -> tuple[dict[str, Town], tuple[str, ...]]:
    """The towns by name and the profiles of a test.

    Raises:
        ConfigError, TownError: One of them cannot be tested.
    """
    profiles = split_nonempty_list("--profile", options.profile)
    for name in profiles:
        require_known_users(name)
    towns = by_name(
        _checked_town(name, options) for name in split_nonempty_list("--town", options.town)
    )
    for name in profiles:
        if not name.startswith(RECORDED):
            continue
        from wcsim.users.recordings.recorded_user import read_stick_recording

        recording = read_stick_recording(Path(name.removeprefix(RECORDED)))
        for town in towns.values():
            try:
                recording.require_driven_here(town.name, partial(content_hash, town))
            except ConfigError as error:
                options_text = _town_options(recording.town, recording.town_sha256)
                raise ConfigError(f"{error}{options_text}") from None
    return towns, profiles


def _town_options(name: str, sha256: str) -> str:
    """The options that test in a town; "" where there is none of that name and content."""
    with contextlib.suppress(TownError):
        town = find_town(name)
        if content_hash(town) == sha256:
            allow = " --allow-train-town" if town.declared and town.split == "train" else ""
            return f". Use --town {name}{allow}"
    return ""


def _checked_town(name: str, options: PolicyTestOptions) -> Town:
    """The town to test in. Raises TownError for one that networks are trained in."""
    town = find_town(name)
    validate_net(town.net)
    if options.allow_train_town:
        return town
    digest = streets_hash(town)
    other = "Choose another --town, or add --allow-train-town"
    # A scenario without a split may be a copy of a training town.
    for known in (town,) if town.declared else list_towns():
        if known.declared and known.split == "train" and streets_hash(known) == digest:
            copied = (
                f": it has the streets of {known.name}, which was not imported with --split test"
            )
            raise TownError(
                f"{town.name} is a training town{'' if town.declared else copied}; expected a town "
                f"of split test (wcsim town list), or a scenario of your own. {other}"
            )
    for policy in options.policies:
        if parse_policy_name(policy).is_network and digest in _training_streets(policy):
            raise TownError(
                f"{policy} was trained in {town.name}; expected a town it has never seen. {other}"
            )
    return town


def _training_streets(policy: str) -> set[str]:
    """Hashes of the streets that a policy was trained in; empty for one without its run."""
    run = run_from_policy_name(policy)
    if run is None:
        return set()
    found = {run.manifest.town_sha256, *run.manifest.more_towns.values()}
    for name in run.config.collect.towns:
        # A town that is not here any more cannot be tested either.
        with contextlib.suppress(TownError):
            found.add(streets_hash(find_town(name)))
    return found

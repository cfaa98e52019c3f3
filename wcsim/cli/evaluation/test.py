"""`wcsim test`: how trained networks do in a town that they have never seen, compared with baselines."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from wcsim.agents.networks.names import check_network
from wcsim.agents.opening.named_policy import config_for
from wcsim.agents.policy_api import UNAIDED
from wcsim.agents.runs.policy_file import policy_name
from wcsim.agents.runs.run_folder import run_of
from wcsim.bridge.sumo.step_hook import find_hook
from wcsim.cli.evaluation.judged_suite import JudgeOptions, judge, make_list, order_of, run_suites
from wcsim.cli.shared.common import (
    Bounds,
    Finds,
    Flag,
    Keys,
    Repeated,
    check_folder,
    has_option,
    parse,
    some_words,
)
from wcsim.cli.shared.consoles import print_overrides, stdout_console
from wcsim.cli.shared.run_config import overrides_of, require_policy, require_user
from wcsim.core.constants import RECORDED
from wcsim.core.own_folder import temporary_folder
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

_MAX_STEPS = 1_000_000  # as in env.max_steps


@dataclass
class Options(JudgeOptions):
    """Test policies: runs (RUN, RUN:phase1), shipped, your own module:Class, or baselines.

    The episodes are drawn for --town. With --suite LIST they come from a fixed list
    (`wcsim test --suite dev -h`); --make-suite TOWN makes such a list.
    """

    set: Annotated[
        Repeated,
        Keys({"env.profile": "expected --profile NAME", "env.max_steps": "expected --max-steps N"}),
    ] = ()
    """section.key=value, over the settings of the preset."""
    town: str = "monaco"
    """A town's name, its folder, or a .sumocfg file; several are separated by commas."""
    profile: str = "inattentive"
    """User profiles, separated by commas; FILE.toml is your own, recorded:FILE replays a recording."""
    episodes: Annotated[int, Bounds(1)] = 5
    """Episodes for each policy, town and profile."""
    max_steps: Annotated[int, Bounds(1, _MAX_STEPS)] = 10_000
    """Steps after which an episode ends without a crash."""
    seed: int = 0
    """Seed of the episodes, the same for every policy."""
    network: Annotated[str, Finds(check_network)] = ""
    """Your own network as module:Class, for runs that were trained with it."""
    hook: Annotated[str, Finds(find_hook)] = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""
    allow_train_town: bool = False
    """Allow a town that is for training, or the town that a run was trained in."""
    verbose: Flag = False
    """Show which of the town's SUMO options are overridden, with the reasons."""


def run(words: list[str]) -> int:
    """Test and print the tables of each town and profile; with --suite or --make-suite see their files here."""
    if has_option(words, "--make-suite"):
        return make_list(words)
    if has_option(words, "--suite"):
        return run_suites(words)
    options = parse(Options, words, "test")
    with _ordered(options) as (order, name):
        return judge(order, options, name)


@contextlib.contextmanager
def _ordered(options: Options) -> Iterator[tuple[SuiteOrder, str]]:
    """How the episodes of a town are driven, and where their list lies.

    The list is written once all of it is driven. Without `--out` the folder is gone afterwards.
    """
    towns, profiles = _tested(options)
    if options.out is not None:
        check_folder("--out", options.out / "x")
    elif options.resume:
        raise ConfigError("--resume needs the folder of the test: --out FOLDER")
    for name in options.policies:  # before torch is loaded for it
        require_policy(name, options.network)
    config = config_for(UNAIDED, options.preset, options.set, in_list=True)

    from wcsim.agents.evaluation.suite.make import (
        town_list,
    )  # the simulators are loaded here: not for a refusal
    from wcsim.agents.evaluation.suite.result_files import LIST
    from wcsim.agents.opening.list_file import suite_of, write_list

    for town in towns.values():
        told = overrides_of(town, config, options.seed)
        print_overrides(stdout_console(), town.name, told, verbose=options.verbose)
    many = options.episodes, options.max_steps, options.seed
    suite = suite_of(town_list(list(towns.values()), profiles, *many, settings=options.set))
    with contextlib.ExitStack() as held:
        out = options.out or held.enter_context(temporary_folder())
        yield (
            replace(order_of(options, suite, out, options.forks), settings=(), hook=options.hook),
            str(out / LIST),
        )
        write_list(suite.file, out / LIST)


def _tested(options: Options) -> tuple[dict[str, Town], tuple[str, ...]]:
    """The towns by name and the profiles of a test. Raises ConfigError or TownError for what cannot be tested."""
    profiles = some_words("--profile", options.profile)
    for name in profiles:
        require_user(name)
    towns = by_name(_checked_town(name, options) for name in some_words("--town", options.town))
    for name in profiles:
        if not name.startswith(RECORDED):
            continue
        from wcsim.users.recordings.recorded_user import read_recording

        recording = read_recording(Path(name.removeprefix(RECORDED)))
        for town in towns.values():  # before the world of another town begins
            try:
                recording.require_driven_here(town.name, partial(content_hash, town))
            except ConfigError as error:
                raise ConfigError(
                    f"{error}{_words_for(recording.town, recording.town_sha256)}"
                ) from None
    return towns, profiles


def _words_for(name: str, sha256: str) -> str:
    """The options that test in the town of that name, if it is there and is the one of that content; "" else."""
    with contextlib.suppress(TownError):
        town = find_town(name)
        if content_hash(town) == sha256:
            school = " --allow-train-town" if town.declared and town.split == "train" else ""
            return f". Use --town {name}{school}"
    return ""


def _checked_town(name: str, options: Options) -> Town:
    """The town to test in. Raises TownError for one that networks are trained in."""
    town = find_town(name)
    validate_net(town.net)
    if options.allow_train_town:
        return town
    digest, other = streets_hash(town), "Choose another --town, or add --allow-train-town"
    # Nobody has said so of a scenario that was made elsewhere; but it may be a copy of such a town.
    known = (town,) if town.declared else list_towns()
    schools = (school for school in known if school.declared and school.split == "train")
    school = next((school for school in schools if streets_hash(school) == digest), None)
    if school is not None:
        copied = f": it has the streets of {school.name}, which was not imported with --split test"
        raise TownError(
            f"{town.name} is a training town{'' if town.declared else copied}; expected a town of split test (wcsim "
            f"town list), or a scenario of your own. {other}"
        )
    for policy in options.policies:
        if policy_name(policy).is_network and digest in _schools(policy):
            raise TownError(
                f"{policy} was trained in {town.name}; expected a town it has never seen. {other}"
            )
    return town


def _schools(policy: str) -> set[str]:
    """Hashes of the streets that a run's policy was trained in; of one without its run nothing is known."""
    run = run_of(policy)
    if run is None:
        return set()
    found = {run.manifest.town_sha256, *run.manifest.more_towns.values()}
    for name in run.config.collect.towns:
        with contextlib.suppress(TownError):  # it is not here any more
            found.add(streets_hash(find_town(name)))
    return found

"""`wcsim test`: how trained networks do in a town that they have never seen, compared with baselines."""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from wcsim.agents.evaluation.suite.named_policy import is_onnx, is_plain, open_named, settings_of
from wcsim.agents.policy_api import BASELINES, UPPER_BOUNDS
from wcsim.agents.runs.run_folder import config_of, run_of
from wcsim.cli.evaluation.judged_suite import run_suites
from wcsim.cli.evaluation.list_maker import make_list
from wcsim.cli.shared.common import OutFile, Repeated, first_few, in_bounds, parse, says, some_words, write_json
from wcsim.cli.shared.consoles import stdout_console
from wcsim.cli.shared.named_policies import require_policy
from wcsim.cli.shared.overrides import Verbose, print_overrides
from wcsim.cli.shared.run_config import overrides_of, require_known, require_unset, require_user
from wcsim.cli.shared.stage_bar import StageBar
from wcsim.config import RunConfig, resolve
from wcsim.core.constants import RECORDED
from wcsim.core.reading import counted
from wcsim.errors import ConfigError, TownError
from wcsim.towns.checks.validate import validate_net
from wcsim.towns.scenario.town import Town, by_name, content_hash, find_town, list_towns, streets_hash

if TYPE_CHECKING:  # loads torch, which --help must not
    from wcsim.agents.evaluation.matrix import TestPlan, TestResult

TRAFFIC_LOG = "wcsim.bridge.sumo.session"
MAX_STEPS = 1_000_000  # as in env.max_steps
SAID_ELSEWHERE = {"env.profile": "expected --profile NAME", "env.max_steps": "expected --max-steps N"}
UNEVENTFUL = "no danger occurred: all policies that follow the user did the same; use more --max-steps or --episodes"


@dataclass
class Options:
    """Test policies: runs (RUN, RUN:phase1), shipped, your own module:Class, or baselines.

    With --suite LIST they drive a fixed list (`wcsim test --suite dev -h`);
    --make-suite TOWN makes such a list.
    """

    policies: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[POLICY ...]")] = ()
    """What to test. follow, random, zero, stop, dwa, oracle-visible and oracle are added unless --only."""
    town: str = "monaco"
    """A town's name, its folder, or a .sumocfg file; several are separated by commas."""
    profile: str = "inattentive"
    """User profiles, separated by commas; FILE.toml is your own, recorded:FILE replays a recording."""
    episodes: int = 5
    """Episodes for each policy, town and profile."""
    max_steps: int = 10_000
    """Steps after which an episode ends without a crash."""
    seed: int = 0
    """Seed of the world, the same for every policy."""
    preset: str = "quick"
    """Settings, if no run folder has its own."""
    set: Repeated = ()
    """section.key=value, over these settings; may be given several times."""
    network: str = ""
    """Your own network as module:Class, for runs that were trained with it."""
    hook: str = ""
    """Your own step hook as module:Class, called around every step of SUMO with the libsumo module."""
    only: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Drive only these policies and the user alone, no other baselines."""
    allow_train_town: bool = False
    """Allow a town that is for training, or the town that a run was trained in."""
    verbose: Verbose = False
    """Show which of the town's SUMO options are overridden, with the reasons."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Test and print one table for each town and profile; with --suite or --make-suite see their files here."""
    if says(words, "--make-suite"):
        return make_list(words)
    if says(words, "--suite"):
        return run_suites(words)
    options = parse(Options, words, "test")
    results = test_policies(options)
    console = stdout_console()
    for result in results:
        console.print(*result.tables(console.width))
        for line in first_few(result.crashed, "crashes; --json FILE writes all"):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
        if result.uneventful:
            console.print(UNEVENTFUL)
    console.print("SIMULATION ONLY: these figures say nothing about a real street.", style="dim")
    if options.json is not None:
        write_json(options.json, as_json(results))
    return 0


def as_json(results: Sequence[TestResult]) -> dict[str, Any]:
    """All results as one object; several towns or profiles are joined by commas, and every row names its own."""
    return {
        "town": ",".join(dict.fromkeys(result.town for result in results)),
        "seed": results[0].seed,
        "profile": ",".join(dict.fromkeys(result.profile for result in results)),
        "rows": [
            {**row.to_json(), "town": result.town, "profile": result.profile}
            for result in results
            for row in result.rows
        ],
    }


def test_policies(options: Options, *, overrides: bool = True) -> Sequence[TestResult]:
    """The results, one for each town and profile; it may be left out what is overridden of a town's SUMO options."""
    towns, profiles = check(options)
    _require_policies(options)
    config = _config(options)

    from wcsim.agents.envs.senses import with_senses
    from wcsim.agents.envs.wheelchair_env import (
        WheelchairEnv,  # torch is loaded here: not for --help, nor for a refusal
    )
    from wcsim.agents.evaluation.matrix import TestPlan, run_test, with_window

    names = _driven(options)
    policies = [open_named(name, config, options.seed, options.network or None) for name in names]
    config = with_window(config, policies)

    def make_env(town: str, profile: str, senses: tuple[str, ...]) -> WheelchairEnv:
        asked = {"profile": profile, "max_steps": options.max_steps, "truth": True, "truth_visible": True}
        sensing = with_senses(config, senses)
        env = sensing.env.model_copy(update=asked)
        return WheelchairEnv(towns[town].address, config=sensing.model_copy(update={"env": env}), hook=options.hook)

    for town in towns.values() if overrides else ():
        told = overrides_of(town, config, options.seed)
        print_overrides(stdout_console(), town.name, told, verbose=options.verbose)

    plan = TestPlan(
        towns=tuple(towns),
        profiles=profiles,
        episodes=options.episodes,
        max_steps=options.max_steps,
        seed=options.seed,
        tick_s=config.world.tick_s,
        config=config,
    )
    with StageBar("testing") as bar, _jams_once():
        bar.say(_told_of(plan, names))
        return run_test(
            policies, make_env, plan, lambda text: bar.say(f"tested {text}"), lambda share, who: bar.show(share, who)
        )


@contextlib.contextmanager
def _jams_once() -> Iterator[None]:
    """Tell a jam of the traffic that all policies meet once, and not for each of them."""
    told: set[str] = set()

    def is_new(record: logging.LogRecord) -> bool:
        before = len(told)
        told.add(record.getMessage())
        return len(told) > before

    logger = logging.getLogger(TRAFFIC_LOG)
    logger.addFilter(is_new)
    try:
        yield
    finally:
        logger.removeFilter(is_new)


def _driven(options: Options) -> list[str]:
    """Who drives, in the order of the tables; the user alone is what the others are compared with."""
    from wcsim.agents.evaluation.suite.run import UNAIDED  # loads the simulators, which --help must not

    added = (UNAIDED,) if options.only else (*BASELINES, *UPPER_BOUNDS)
    return list(dict.fromkeys([*options.policies, *added]))


def _told_of(plan: TestPlan, names: Sequence[str]) -> str:
    """How much there is to drive, in a line."""
    many = counted(len(names), "policy", "policies")
    places = [f"{len(found)} {what}s" for found, what in ((plan.towns, "town"), (plan.profiles, "user")) if found[1:]]
    of_each = f"{plan.episodes} episode{'s' * (plan.episodes > 1)} of each"
    return f"{many}, {' in each of '.join([of_each, *places])}: {', '.join(names)}"


def check(options: Options) -> tuple[dict[str, Town], tuple[str, ...]]:
    """The towns by name and the profiles of a test. Raises ConfigError or TownError for what cannot be tested."""
    require_unset(options.set, SAID_ELSEWHERE)
    in_bounds("--episodes", options.episodes, 1, math.inf)
    in_bounds("--max-steps", options.max_steps, 1, MAX_STEPS)
    profiles = some_words("--profile", options.profile)
    for name in profiles:
        require_user(name)
    towns = _towns(options)
    for name in profiles:
        _require_driven_there(name, towns.values())
    return towns, profiles


def _require_driven_there(profile: str, towns: Iterable[Town]) -> None:
    """Refuse a recorded drive of another town before its world begins. Raises ConfigError with the words that work."""
    if not profile.startswith(RECORDED):
        return
    from wcsim.users.recorded import read_recording, require_driven_here

    recording = read_recording(Path(profile.removeprefix(RECORDED)))
    for town in towns:
        try:
            require_driven_here(recording, town.name, partial(content_hash, town))
        except ConfigError as error:
            raise ConfigError(f"{error}{_words_for(recording.town, recording.town_sha256)}") from None


def _words_for(name: str, sha256: str) -> str:
    """The options that test in the town of that name, if it is there and is the one of that content; "" else."""
    with contextlib.suppress(TownError):
        town = find_town(name)
        if content_hash(town) == sha256:
            school = " --allow-train-town" if town.declared and town.split == "train" else ""
            return f". Use --town {name}{school}"
    return ""


def _require_policies(options: Options) -> None:
    """Look at what is to be tested before torch is loaded for it.

    Raises:
        PolicyError: There is no such policy or class, or it has a network of somebody's own that is not named.
        HookError: The step hook is none.
    """
    require_known(options.network, hook=options.hook)
    for name in options.policies:
        require_policy(name, options.network)


def _towns(options: Options) -> dict[str, Town]:
    """The towns to test in, by name."""
    return by_name(checked_town(name, options) for name in some_words("--town", options.town))


def checked_town(name: str, options: Options) -> Town:
    """The town to test in. Raises TownError for one that networks are trained in."""
    town = find_town(name)
    validate_net(town.net)
    if options.allow_train_town:
        return town
    digest = streets_hash(town)
    _refuse_school(town, digest)
    for policy in options.policies:
        if not is_plain(policy) and digest in _schools(policy):
            raise TownError(
                f"{policy} was trained in {town.name}; expected a town it has never seen. "
                "Choose another --town, or add --allow-train-town"
            )
    return town


def _refuse_school(town: Town, digest: str) -> None:
    """Raise TownError for a town that is for training.

    Nobody has said so of a scenario that was made elsewhere; but it may be a copy of such a town.
    """
    known = (town,) if town.declared else list_towns()
    schools = (other for other in known if other.declared and other.split == "train")
    found = next((other for other in schools if streets_hash(other) == digest), None)
    if found is not None:
        of_it = f": it has the streets of {found.name}, which was not imported with --split test"
        same = "" if town.declared else of_it
        raise TownError(
            f"{town.name} is a training town{same}; expected a town of split test (wcsim town list), or a scenario of "
            "your own. Choose another --town, or add --allow-train-town"
        )


def _schools(policy: str) -> set[str]:
    """Hashes of the streets that a run's policy was trained in; of one without its run nothing is known."""
    manifest = run_of(policy)
    if manifest is None:
        return set()
    found = {manifest.town_sha256, *manifest.more_towns.values()}
    for name in config_of(policy, "quick").collect.towns:
        with contextlib.suppress(TownError):  # it is not here any more
            found.add(streets_hash(find_town(name)))
    return found


def _config(options: Options) -> RunConfig:
    """The settings of the first run or model that is tested, or of the preset; overrides apply to both."""
    for policy in options.policies:
        if not is_plain(policy):
            return config_of(policy, options.preset, options.set)
        if is_onnx(policy):
            return settings_of(policy, options.preset, options.set)
    return resolve(options.preset, options.set)

"""Where a drive begins: a town and a seed, or an episode of a suite, with a policy and a user."""

from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass, replace

from wcsim.agents.opening.list_file import (
    HashedSuite,
    list_shipped_suites,
    make_block_setup,
    make_episode_seat_spec,
    open_suite,
    require_block_towns,
)
from wcsim.agents.opening.named_policy import (
    list_policy_overrides,
    make_policy_seat_spec,
    open_named_policy,
    resolve_policy_config,
)
from wcsim.agents.policy_api import Policy
from wcsim.config import RunConfig, resolve
from wcsim.config.suite import SuiteBlock
from wcsim.core import seeding
from wcsim.core.constants import RECORDED
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.reading import escape
from wcsim.errors import ConfigError, TownError
from wcsim.towns.cache.folder import cache_folder
from wcsim.towns.making.asked_town import made_town
from wcsim.towns.scenario.town import Town, content_hash, find_town, list_towns
from wcsim.types import SeatSpec
from wcsim.users.profiles import list_profile_names
from wcsim.users.recordings.recorded_user import find_user

PRESET = "quick"
LONGEST_STEPS = 1_000_000  # a drive has no step limit of its own


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveStart:
    """What to drive: a place in a town, or an episode of the list that `suite` names."""

    town: str = "helsinki"
    policy: str = "dwa"
    network: str = ""  # module:Class of the user's own network, which the policy may load
    profile: str = "competent"  # of the simulated user; "" for the one of the suite's episode
    seed: int = 0
    suite: str = ""
    block: int = 0
    seat: int = 0
    speed: float = 1.0  # of the person's stick, like `sensitivity`
    sensitivity: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenPlace:
    """A place that can be driven in; `config` is the policy's, with its senses."""

    start: DriveStart
    town: Town
    config: RunConfig
    policy: Policy
    spec: SeatSpec
    seed: int  # of the world
    handover_step: int = 0  # until then the simulated user drives alone, as in the suite
    told: str = ""  # the place in words
    episode: str = ""  # of a suite: its set, block and seat
    scene: str = ""  # what makes a generated street again, which is gone after the drive


def open_place(start: DriveStart, held: ExitStack) -> OpenPlace:
    """Find the town, the user and the policy; `held` keeps what is closed after the drive.

    Raises:
        ConfigError: There is no such user, list, block or seat.
        TownError: There is no such town, or it differs from the list's.
        PolicyError: There is no such policy.
    """
    return _of_suite(start, held) if start.suite else _of_town(start)


def checked(start: DriveStart) -> DriveStart:
    """Return the same start if it can be opened; to be called before the open drive is closed.

    Raises:
        ConfigError: There is no such user, list, block or seat.
        TownError: There is no such town.
    """
    if start.profile:
        find_user(start.profile)
    if start.suite:
        _block(open_suite(start.suite), start)
    else:
        find_town(start.town)
    return start


def check_offered(start: DriveStart, begun: DriveStart) -> DriveStart:
    """Return the same start if the page offers it.

    Whoever has the page's address can ask. Only the person who starts the drive may name files of
    their own, in `begun`.

    Raises:
        ConfigError: The page asks for something else, such as a file.
    """
    offered: tuple[tuple[str, str, str, Callable[[], Collection[str]]], ...] = (
        ("town", start.town, begun.town, lambda: [town.name for town in list_towns()]),
        ("user", start.profile, begun.profile, list_profile_names),
        ("list", start.suite, begun.suite, list_shipped_suites),
    )
    for what, wanted, own, names in offered:
        if wanted and wanted != own and wanted not in names():
            raise ConfigError(
                f"{what} {escape(wanted, 80)!r} is not one that the page offers; "
                "choose one of its list"
            )
    return start


def check_recordable(start: DriveStart) -> DriveStart:
    """Return the same start. Raises ConfigError if no file could replay its drive."""
    if start.profile.startswith(RECORDED):
        raise ConfigError(
            f"the recorded user {escape(start.profile, 80)} cannot be part of a recorded drive; "
            "expected a profile: choose another user"
        )
    return start


def _of_town(start: DriveStart) -> OpenPlace:
    config = resolve_policy_config(start.policy, PRESET, ())
    policy = open_named_policy(start.policy, config, start.seed, start.network or None)
    town = find_town(start.town)
    find_user(start.profile)
    return OpenPlace(
        start=start,
        town=town,
        config=resolve(config, list_policy_overrides(config, policy)),
        policy=policy,
        spec=replace(make_policy_seat_spec(policy, start.profile), max_steps=LONGEST_STEPS),
        seed=start.seed,
        told=f"{town.name}, seed {start.seed}",
    )


def _of_suite(start: DriveStart, held: ExitStack) -> OpenPlace:
    """An episode of a list, alone in its street: the other chairs of its block are not there."""
    suite = open_suite(start.suite)
    require_block_towns(suite.file)
    block = _block(suite, start)
    work = held.enter_context(create_temporary_folder())
    config = resolve_policy_config(
        start.policy, PRESET, (*suite.file.settings, *block.settings), in_list=True
    )
    driver_seed = seeding.derive_seed(block.seed, "driver", start.seat)
    policy = open_named_policy(start.policy, config, driver_seed, start.network or None)
    episode = block.episodes[start.seat]
    if start.profile:
        episode = episode.model_copy(update={"profile": start.profile})
    config = resolve(config, list_policy_overrides(config, policy))
    place = make_block_setup(block, config, lambda: _town_of(suite, block), work)
    sha256 = block.scene_sha256
    return OpenPlace(
        start=start,
        town=place.town,
        config=place.config,
        policy=policy,
        spec=make_episode_seat_spec(place, episode, policy),
        seed=place.seed,
        handover_step=episode.handover_step,
        told=f"{suite.file.set} {start.block}.{start.seat}, {block.part}, {block.town}",
        episode=f"{suite.file.set} {start.block}.{start.seat}",
        scene="" if sha256 is None else f"{block.town} {block.seed} {sha256}",
    )


def _block(suite: HashedSuite, start: DriveStart) -> SuiteBlock:
    blocks = suite.file.blocks
    if not 0 <= start.block < len(blocks):
        raise ConfigError(
            f"{start.suite} has no block {start.block}; expected 0 to {len(blocks) - 1}"
        )
    seats = len(blocks[start.block].episodes)
    if not 0 <= start.seat < seats:
        raise ConfigError(
            f"block {start.block} of {start.suite} has no chair {start.seat}; "
            f"expected 0 to {seats - 1}"
        )
    return blocks[start.block]


def _town_of(suite: HashedSuite, block: SuiteBlock) -> Town:
    """The block's town, as the list was made with it; one made from a seed stays in the cache."""
    (wanted,) = [town for town in suite.file.towns if town.name == block.town]
    made = wanted.made_seed
    town = (
        find_town(wanted.name) if made is None else made_town(cache_folder() / "drive-towns", made)
    )
    got = content_hash(town)
    if got != wanted.sha256:
        raise TownError(
            f"town {wanted.name} has checksum {got[:12]}; expected {wanted.sha256[:12]}, "
            "that of the list: choose another episode, or reinstall wcsim"
        )
    return town

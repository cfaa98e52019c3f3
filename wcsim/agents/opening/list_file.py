"""Lists of episodes: read, checked and hashed; the street of a block, and its seats."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Final

from wcsim.agents.opening.named_policy import make_policy_seat_spec
from wcsim.agents.policy_api import Policy
from wcsim.config import RunConfig, parse
from wcsim.config.held_out import refuse_held_out
from wcsim.config.load import read_toml
from wcsim.config.suite import SuiteBlock, SuiteEpisode, SuiteFile, SuiteRecipe
from wcsim.core.constants import RECORDED
from wcsim.core.reading import EPISODES, escape, is_file, read_json
from wcsim.errors import ConfigError, TownError
from wcsim.towns.making.asked_town import MADE, made_seed, made_town
from wcsim.towns.scenario.town import Town, content_hash, expanded, find_town
from wcsim.towns.scene_folders.build import build_scene, scene_config, scene_digest
from wcsim.towns.scene_folders.families import write_scene
from wcsim.types import SeatSpec, StartSpec

# Folders of a block in a generated scene.
SCENE: Final = "scene"
SCENE_TOWN: Final = "town"

_SHIPPED: Final = Path(__file__).parent / "lists"


@dataclass(frozen=True, slots=True, kw_only=True)
class HashedSuite:
    """A list and what it hashes to."""

    file: SuiteFile
    # In hex, over the list's content.
    sha256: str

    @property
    def episodes(self) -> int:
        """How many there are."""
        return sum(len(block.episodes) for block in self.file.blocks)


def list_shipped_suites() -> tuple[str, ...]:
    """The sets that come with wcsim."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.json")))


def open_suite(name_or_path: str) -> HashedSuite:
    """A set that comes with wcsim, or a list at a path.

    Raises:
        ConfigError: There is no such list, or it is damaged.
    """
    is_shipped = name_or_path in list_shipped_suites()
    path = _SHIPPED / f"{name_or_path}.json" if is_shipped else expanded(name_or_path)
    if not is_file(path):
        known = ", ".join(list_shipped_suites()) or "(none)"
        raise ConfigError(
            f"--suite {escape(name_or_path)!r}: there is no such list; expected {known}, or a file"
        )
    return suite_from_file(parse(SuiteFile, read_json(path, EPISODES), escape(path)))


def open_recipe(name_or_path: str) -> SuiteRecipe:
    """The recipe of a list that comes with wcsim, or one at a path. Raises ConfigError."""
    shipped = _SHIPPED / f"{name_or_path}.toml"
    return read_toml(shipped if shipped.is_file() else expanded(name_or_path), SuiteRecipe)


def open_suite_to_choose_by(name_or_path: str) -> HashedSuite:
    """A list by which something is chosen.

    Raises:
        ConfigError: As `open_suite`, or it has what is held out.
    """
    suite = open_suite(name_or_path)
    refuse_held_out("town", (f"{MADE}:{town.made_seed}" for town in suite.file.towns), name_or_path)
    for block in suite.file.blocks:
        if block.scene_sha256 is not None:
            refuse_held_out("family", (block.town,), name_or_path)
        refuse_held_out("profile", (episode.profile for episode in block.episodes), name_or_path)
    return suite


def suite_from_file(file: SuiteFile) -> HashedSuite:
    """A list with its hash."""
    data = file.model_dump(mode="json", exclude={"version"})
    # The one spelling of plain data that is hashed.
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return HashedSuite(file=file, sha256=hashlib.sha256(text.encode()).hexdigest())


def write_list(file: SuiteFile, path: Path) -> None:
    """Write a list, an episode a line, so that a change shows in a diff. Raises OSError."""
    head = file.model_dump(mode="json", exclude={"blocks"}, exclude_none=True)
    lines = [json.dumps(head)[:-1] + ', "blocks": [']
    for number, block in enumerate(file.blocks, 1):
        facts = json.dumps(block.model_dump(mode="json", exclude={"episodes"}))[:-1]
        rows = [json.dumps(episode.model_dump(mode="json")) for episode in block.episodes]
        episodes = ",\n  ".join(rows)
        end = "," if number < len(file.blocks) else "]}"
        lines.append(f'{facts}, "episodes": [\n  {episodes}]}}{end}')
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_suite_towns(file: SuiteFile, folder: Path) -> dict[str, Town]:
    """The list's towns, by name; those made of a seed are made in `folder`, if they are not there.

    Raises:
        TownError: The list is of another version, or a town is missing, or not that of the list.
        SumoError: One of SUMO's tools failed at a made one.
    """
    here = version("wcsim")
    if file.version not in (None, here):
        raise TownError(
            f"the list {file.suite} {file.set} is of wcsim {file.version}, and this is {here}, "
            "whose towns are others: install that version, or use another list"
        )
    towns = {}
    for entry in file.towns:
        seed = entry.made_seed
        town = find_town(entry.name) if seed is None else made_town(folder, seed)
        sha256 = content_hash(town)
        if sha256 != entry.sha256:
            raise TownError(
                f"town {entry.name} has the hash {sha256[:12]}; expected {entry.sha256[:12]}, for "
                f"which the list {file.suite} {file.set} was made: make your own list with "
                f"--make-suite {entry.name}"
            )
        towns[entry.name] = town
    return towns


def parse_suite_towns(words: str, folder: Path) -> list[tuple[Town, int | None]]:
    """The towns of `--make-suite`, each with the seed that it was made of; `made:7` is made now.

    Raises:
        ConfigError: A seed is none.
        TownError: There is no such town, or it cannot be made.
    """
    # All seeds are read before the first town is made.
    seeds = [(word.strip(), made_seed(word.strip())) for word in words.split(",")]
    return [
        (find_town(word) if seed is None else made_town(folder, seed), seed) for word, seed in seeds
    ]


def require_block_towns(file: SuiteFile) -> None:
    """Raises ConfigError for a block in a town that the list does not name."""
    named = {town.name for town in file.towns}
    for block in file.blocks:
        if block.scene_sha256 is None and block.town not in named:
            raise ConfigError(
                f"a block is in town {block.town!r}; expected one of {sorted(named)}: add it to "
                "`towns`"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockSetup:
    """Where a block is driven: its street is there, and all its settings."""

    town: Town
    # By `resolve_policy_config`.
    config: RunConfig
    # Of the world.
    seed: int
    # Folder of recorded joysticks that users are named by.
    recordings: Path | None = None


def make_block_setup(
    block: SuiteBlock, config: RunConfig, town: Callable[[], Town], work: Path
) -> BlockSetup:
    """The block's place: its `town`, or its scene, built in `work`.

    Raises:
        TownError: The scene differs from the list's, or as `town` does.
    """
    if block.scene_sha256 is None:
        return BlockSetup(town=town(), config=config, seed=block.seed)
    folder = write_scene(block.town, block.seed, work / SCENE)
    sha256 = scene_digest(folder)
    if sha256 != block.scene_sha256:
        raise TownError(
            f"scene {block.town} {block.seed} has the hash {sha256[:12]}; expected "
            f"{str(block.scene_sha256)[:12]}, as the list says: the list was made by another "
            "version of wcsim"
        )
    built, scene = build_scene(folder, work / SCENE_TOWN)
    return BlockSetup(
        town=replace(built, drafted=True),
        config=scene_config(scene, config),
        seed=scene.seed,
        recordings=folder,
    )


def make_episode_seat_spec(place: BlockSetup, episode: SuiteEpisode, policy: Policy) -> SeatSpec:
    """The seat of a policy for an episode of a block."""
    user = episode.profile
    if place.recordings is not None and user.startswith(RECORDED):
        user = f"{RECORDED}{place.recordings / user.removeprefix(RECORDED)}"
    # Without a start the world draws it.
    start = None
    if episode.start_m is not None and episode.goal_m is not None:
        start = StartSpec(
            p_W_m=episode.start_m, yaw_rad=episode.heading_rad, goal_W_m=episode.goal_m
        )
    return replace(make_policy_seat_spec(policy, user), max_steps=episode.max_steps, start=start)

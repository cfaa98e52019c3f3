"""What is kept for tests is refused wherever something learns, or is chosen."""

import shutil
from pathlib import Path

import pytest

from tests.agents.evaluation.suite.lists import episode
from wcsim.agents.opening.list_file import open_recipe, open_suite_to_choose_by, write_list
from wcsim.agents.rounds.train_rounds import _find_towns
from wcsim.agents.runs.data_folder import write_data_manifest
from wcsim.cli.shared.run_config import refuse_held_out_users
from wcsim.config import RunConfig, resolve
from wcsim.config.held_out import HELD_OUT
from wcsim.config.suite import SuiteBlock, SuiteFile, SuiteTown
from wcsim.errors import ConfigError
from wcsim.towns.scenario.town import Town
from wcsim.towns.scene_folders.families import FAMILIES
from wcsim.users.profiles import list_profile_names


def test_what_is_held_out_is_there():
    assert set(HELD_OUT) == {"family", "profile", "town"}
    assert set(HELD_OUT["family"]) <= set(FAMILIES)
    assert set(HELD_OUT["profile"]) <= set(list_profile_names())


def test_neither_a_file_nor_data_brings_a_user_or_town_that_is_held_out(tmp_path: Path) -> None:
    (tmp_path / "me.toml").write_text('base = "ataxic"')
    users = resolve(RunConfig(), f'collect.profiles=["{tmp_path}/me.toml"]')
    with pytest.raises(ConfigError, match=r"collect\.profiles: profile ataxic is held out"):
        refuse_held_out_users(users)
    refuse_held_out_users(resolve(RunConfig(), "env.profile=recorded:stick.csv"))
    read = resolve(RunConfig(), f'collect.data=["{tmp_path}"]')
    met = resolve(RunConfig(), 'collect.profiles=["recorded"]')
    write_data_manifest(tmp_path, met, {"corner": "a" * 64}, {})
    with pytest.raises(ConfigError, match="profile recorded is held out"):
        refuse_held_out_users(read)
    write_data_manifest(tmp_path, RunConfig(), {"made-5953": "a" * 64}, {})
    with pytest.raises(ConfigError, match="town made-5953 is held out"):
        refuse_held_out_users(read)


def test_a_made_town_that_is_held_out_is_known_by_its_seed(corner: Path, corner_town: Town, tmp_path: Path) -> None:
    shutil.copytree(corner, tmp_path / "town")
    toml = tmp_path / "town" / "town.toml"
    toml.write_text(f'{toml.read_text()}rebuild = "wcsim town make x --seed 5953 --out . --kind random"\n')
    config = resolve(RunConfig(), f'collect.towns=["{tmp_path}/town"]')
    with pytest.raises(ConfigError, match="town made:5953 is held out"):
        _find_towns(corner_town, (), config, tmp_path, 3)


@pytest.mark.parametrize(
    "seed, change, told",
    [
        (5953, {}, "town made:5953"),
        (7, {"part": "tight", "town": "bus-at-corner", "scene_sha256": "0" * 64}, "family bus-at-corner"),
        (7, {"episodes": (episode(profile="recorded"),)}, "profile recorded"),
    ],
)
def test_nothing_is_chosen_by_a_list_that_has_what_is_held_out(seed, change, told, tmp_path):
    block = SuiteBlock(part="free", town="a", seed=1, episodes=(episode(profile="tremor"),))
    for name, made, blocks in (("good", 7, (block,)), ("bad", seed, (block.model_copy(update=change),))):
        towns = (SuiteTown(name="a", sha256="0" * 64, made_seed=made),)
        file = SuiteFile(suite="x-v1", set="x", settings=(), towns=towns, blocks=blocks)
        write_list(file, tmp_path / f"{name}.json")
    assert open_suite_to_choose_by(str(tmp_path / "good.json")).episodes == 1
    with pytest.raises(ConfigError, match=f"{told} is held out"):
        open_suite_to_choose_by(str(tmp_path / "bad.json"))


def test_the_recipe_of_a_list_to_choose_by_names_nothing_that_is_held_out():
    recipe = open_recipe("validation2")
    assert recipe.scenes and not set(recipe.scenes) & set(HELD_OUT["family"])
    assert not set(recipe.profiles) & set(HELD_OUT["profile"])

"""A whole list: the same bytes with one process and with two, kept pieces are used, and changes are told."""

import json
from collections import Counter
from dataclasses import asdict, replace
from importlib.metadata import version

import pytest

from tests.agents.evaluation.suite.lists import block_of, suite_in
from tests.support.one_process import in_this_process
from wcsim.agents.evaluation.suite.make import SETTINGS
from wcsim.agents.evaluation.suite.rows import pooled_rows
from wcsim.agents.evaluation.suite.run import (
    SuiteOrder,
    _identity_of,
    _judged_blocks,
    _policy_digest,
    _read_saved,
    run_suite,
)
from wcsim.agents.opening.list_file import (
    list_shipped_suites,
    load_suite_towns,
    open_recipe,
    open_suite,
    open_suite_to_choose_by,
    require_block_towns,
    suite_from_file,
    write_list,
)
from wcsim.core.sources import hash_package_code
from wcsim.errors import ConfigError, TownError


def told(records):
    rows, whole = pooled_rows("follow", records["follow"], records["follow"])
    return json.dumps([[asdict(row) for row in (*rows, whole)], [record.to_json() for record in records["follow"]]])


def test_one_process_and_two_give_the_same_bytes_and_what_is_kept_is_not_driven_again(corner, tmp_path):
    block = block_of(corner, max_steps=15)
    suite = suite_in(corner, block, block.model_copy(update={"part": "crossing", "seed": 77}))
    heard = []
    with in_this_process():
        one = run_suite(SuiteOrder(suite=suite, out=tmp_path / "a"), ["follow"], lambda *said: heard.append(said))
    two = run_suite(SuiteOrder(suite=suite, out=tmp_path / "b", jobs=2), ["follow"], lambda *said: None)
    assert told(one) == told(two) and [record.block for record in one["follow"]] == [0, 0, 1, 1]
    assert heard == [("follow", 1, 2), ("follow", 2, 2)]
    again = run_suite(SuiteOrder(suite=suite, out=tmp_path / "a"), ["follow"], lambda *said: heard.append(said))
    assert told(again) == told(one) and len(heard) == 2
    for path in (tmp_path / "a" / "kept").iterdir():
        path.write_text("{")
    with pytest.raises(ConfigError, match="remove it"):
        run_suite(SuiteOrder(suite=suite, out=tmp_path / "a"), ["follow"], lambda *said: None)


def test_the_user_alone_drives_a_list_once_for_all_tests_of_it(corner, tmp_path, own_cache, monkeypatch):
    order = SuiteOrder(suite=suite_in(corner, block_of(corner, max_steps=5)), out=tmp_path / "a", shared=True)
    heard = []
    with in_this_process():
        first = run_suite(order, ["follow", "dwa"], print)
        [rows] = (own_cache / "wcsim").glob("rows-*.json")
        with monkeypatch.context() as patch:
            patch.setattr("wcsim.agents.evaluation.suite.run.drive_block", None)
            again = run_suite(replace(order, out=tmp_path / "b"), ["follow"], lambda *said: heard.append(said))
        assert told(again) == told(first) and heard[-1] == ("follow", 1, 1)
        rows.write_text("{")  # damaged: driven again
        assert told(run_suite(replace(order, out=tmp_path / "c"), ["follow"], lambda *_: None)) == told(first)


@pytest.mark.parametrize("kept", ['{"records": 3}', '{"records": [{"block": 0}]}'])
def test_a_kept_result_that_is_none_is_refused_in_a_line(tmp_path, kept):
    (tmp_path / "a.json").write_text(kept)
    with pytest.raises(ConfigError, match="remove it"):
        _read_saved(tmp_path / "a.json")


def test_as_many_episodes_are_judged_as_are_asked_for_and_none_for_none():
    blocks = open_suite("guard").file.blocks
    counts = [sum(len(blocks[at].episodes) for at in _judged_blocks(blocks, wanted)) for wanted in (0, 40, 1 << 30)]
    assert counts[0] == 0 and 20 <= counts[1] <= 60 and counts[2] == open_suite("guard").episodes


def test_what_is_kept_is_of_the_files_that_a_list_settings_users_a_class_and_a_network_name(
    corner, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    names = ("my chair.toml", "chair.toml", "user.toml", "weights.zip", "own_net_of_suites.py")
    for name in names:
        (tmp_path / name).write_text("class Net:\n    pass\n" if name.endswith("py") else "1")
    (tmp_path / "own_reader.py").write_text('class Reads:\n    files = ("weights.zip", "missing.zip")\n')
    block = block_of(corner)
    mine = block.episodes[0].model_copy(update={"profile": "user.toml"})
    block = block.model_copy(update={"settings": ("chair.plant=chair.toml",), "episodes": (mine,)})
    plain = SuiteOrder(suite=suite_in(corner, block), out=tmp_path)
    order = replace(plain, settings=("chair={plant='my chair.toml'}",), network="own_net_of_suites:Net")
    asked = (plain, replace(order, network=""), order)
    seen = {_policy_digest("own_reader:Reads", each) for each in asked}
    for name in names:
        (tmp_path / name).write_text((tmp_path / name).read_text() + "\n")
        seen.add(_policy_digest("own_reader:Reads", order))
    assert len(seen) == 8 and _policy_digest("own_reader:Reads", order) in seen


def test_what_is_kept_is_of_the_code_that_drives(tmp_path):
    for name in ("agents/drive.py", "config/presets/quick.toml", "view/page.py", "cli/main.py", "README.md"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1")
    before = hash_package_code(tmp_path)
    for name in ("view/page.py", "cli/main.py", "README.md"):
        (tmp_path / name).write_text("2")
        assert hash_package_code(tmp_path) == before
    seen = {before}
    for name in ("agents/drive.py", "config/presets/quick.toml"):
        (tmp_path / name).write_text("2")
        seen.add(hash_package_code(tmp_path))
    assert len(seen) == 3


def test_a_list_that_was_changed_is_another_list(corner, tmp_path):
    block = block_of(corner)
    suite = suite_in(corner, block)
    write_list(suite.file, tmp_path / "list.json")
    assert open_suite(str(tmp_path / "list.json")) == suite
    shorter = suite_in(corner, block.model_copy(update={"episodes": block.episodes[:1]}))
    moved = block.episodes[0].model_copy(update={"max_steps": 61})
    changed = suite_in(corner, block.model_copy(update={"episodes": (moved, *block.episodes[1:])}))
    assert len({suite.sha256, shorter.sha256, changed.sha256}) == 3


def test_a_town_with_other_streets_is_refused(corner, tmp_path):
    file = suite_in(corner, block_of(corner)).file
    other = file.model_copy(update={"towns": (file.towns[0].model_copy(update={"sha256": "0" * 64}),)})
    with pytest.raises(TownError, match="--make-suite"):
        load_suite_towns(suite_from_file(other).file, tmp_path)


def test_a_list_of_another_version_names_it_and_is_the_same_list_with_any(corner, tmp_path):
    file = suite_in(corner, block_of(corner)).file
    of_then, of_now = (file.model_copy(update={"version": name}) for name in ("0.2.0", version("wcsim")))
    assert {suite_from_file(each).sha256 for each in (file, of_then, of_now)} == {suite_from_file(file).sha256}
    assert load_suite_towns(of_now, tmp_path)
    with pytest.raises(TownError, match=r"of wcsim 0\.2\.0.*install"):
        load_suite_towns(of_then, tmp_path)
    assert open_suite("v1").file.version == "0.2.0" and open_suite("v1").sha256.startswith("d2767993d1e8")


def test_a_list_that_is_none_is_refused(tmp_path):
    for name in (str(tmp_path / "nothing.json"), "a" * 5000, "~nobody-is-called-so/list.json"):
        with pytest.raises(ConfigError, match="no such list"):
            open_suite(name)
    (tmp_path / "bad.json").write_text('{"suite": "x", "set": "y"}')
    with pytest.raises(ConfigError, match="blocks"):
        open_suite(str(tmp_path / "bad.json"))


def test_the_lists_that_come_with_wcsim_are_those_of_their_recipes():
    names = ("guard", "hard", "dev2", "validation2")
    assert sorted(list_shipped_suites()) == sorted((*names, "demo", "v1"))
    files = {name: open_suite(name).file for name in names}
    for name, file in files.items():
        recipe = open_recipe(name)
        assert (file.suite, file.set, file.settings) == (recipe.suite, name, SETTINGS)
        require_block_towns(file)
        scenes = Counter(block.town for block in file.blocks if block.scene_sha256)
        assert scenes == recipe.scenes
        assert name == "guard" or {len(block.episodes) for block in file.blocks} == {1}
    drawn = [(block.town, block.seed) for file in files.values() for block in file.blocks if block.scene_sha256]
    assert len(drawn) == len({*drawn}), "no scene is in two of them"
    parts = Counter(block.part for block in files["hard"].blocks)
    assert parts.total() == 100 and parts["held-out"] >= 34
    for name in ("dev2", "validation2"):
        open_suite_to_choose_by(name)
    with pytest.raises(ConfigError, match="held out"):
        open_suite_to_choose_by("hard")


def test_what_is_kept_of_a_folder_without_settings_is_of_one_preset() -> None:
    assert _identity_of("shipped", "quick") != _identity_of("shipped", "paper")

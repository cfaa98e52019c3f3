"""Lists hold only what is an episode: nobody who is hit at once, and what is left is driven again without them."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.agents.evaluation.suite.lists import episode
from wcsim.agents.evaluation.suite import make
from wcsim.agents.evaluation.suite.draw import WaySpec, free_blocks
from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.opening.list_file import load_suite_towns, parse_suite_towns, require_block_towns
from wcsim.config.suite import SuiteBlock, SuiteRecipe

PLACE = SimpleNamespace(name="a", listed="a")


def record(block: int, seat: int, time_s: float, **more: object) -> EpisodeRecord:
    crash = {"status": "chair_crashed", "fault": "own", "part": "free", "town": "a", "profile": "b"}
    drove = {"time_s": time_s, "steps": round(10.0 * time_s), "done_m": time_s}
    return EpisodeRecord(block=block, seat=seat, **{**crash, **drove, **more})


def block_with(*lengths_m: float, **more: object) -> SuiteBlock:
    episodes = tuple(episode(route_m=length_m) for length_m in lengths_m)
    return SuiteBlock(**{"part": "free", "town": "a", "seed": 1, "episodes": episodes, **more})


def maker_in(work: Path, told: list[str] | None = None, **more: object) -> make._Maker:
    recipe = SuiteRecipe(**{"suite": "x-v1", "free": 1, "hazards": 1, "profiles": ("b",), **more})
    said = told if told is not None else []
    here = {"set": "x", "seed": 0, "work": work, "jobs": 1, "towns": ()}
    return make._Maker(recipe=recipe, report=lambda text, _: said.append(text), **here)


def test_who_is_left_out_is_missing_for_the_others_who_are_driven_again(tmp_path, monkeypatch):
    """Ways of 1 m end at once; without them a way of 2 m does, and then one of 3 m."""
    driven = []

    def alone(_, blocks, *_args, **_more):
        lengths = [[item.route_m for item in block.episodes] for block in blocks]
        driven.append(lengths)
        return tuple(
            record(number, seat, 1.0 if length_m == min(row) and length_m < 4.0 else 50.0)
            for number, row in enumerate(lengths)
            for seat, length_m in enumerate(row)
        )

    blocks = [block_with(9.0, 8.0), block_with(1.0, 7.0, 2.0, 3.0), block_with(1.0)]
    monkeypatch.setattr(make, "free_blocks", lambda *_: blocks)
    monkeypatch.setattr(make._Maker, "_alone", alone)
    left = maker_in(tmp_path).ways(PLACE, "free", 1, 0.5)
    assert [[item.route_m for item in block.episodes] for block in left] == [[9.0, 8.0], [7.0]]
    assert driven == [[[9.0, 8.0], [1.0, 7.0, 2.0, 3.0], [1.0]], [[7.0, 2.0, 3.0]], [[7.0, 3.0]], [[7.0]]]


def test_hazards_are_own_crashes_late_enough_that_could_be_survived_one_chair_each(tmp_path, monkeypatch):
    """Drawn again until there are enough, and taken over 10 s before."""
    monkeypatch.setattr(make, "free_blocks", lambda *_: [block_with(90.0, 80.0), block_with(70.0, 60.0)])
    ends = [
        *(record(0, 0, 50.0, fault="other"), record(1, 0, 11.0, last_moment_s=0.5), record(2, 0, 50.0)),
        *(record(3, 0, 50.0, last_moment_s=0.5), record(4, 0, 40.0, last_moment_s=0.9), *[record(5, 0, 9.0)] * 3),
    ]
    monkeypatch.setattr(make._Maker, "_alone", lambda _, ways, _what: [ends.pop(0) for _ in ways])
    found = maker_in(tmp_path, hazards=2).hazards(PLACE)
    assert [len(block.episodes) for block in found] == [1, 1] and not ends
    assert [block.episodes[0].handover_step for block in found] == [400, 300]
    assert [block.episodes[0].max_steps for block in found] == [700, 600]


def test_a_scene_whose_crash_nobody_survives_is_drawn_again_and_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(make, "scene_block", lambda family, seed: block_with(9.0, town=family, seed=seed))
    ends = [record(0, 0, 5.0), record(0, 0, 5.0, last_moment_s=0.6), record(0, 0, 9.0, status="timed_out")]
    monkeypatch.setattr(make._Maker, "_alone", lambda _, scenes, _what: [ends.pop(0) for _ in scenes])
    said: list[str] = []
    found = maker_in(tmp_path, said, scenes={"car-door": 1, "bus-at-corner": 1, "twisted-ramp": 0}).scenes()
    assert [block.town for block in found] == ["car-door", "bus-at-corner"]
    assert len({block.seed for block in found}) == 2
    assert said == ["car-door: 2 drawn, 1 left out", "bus-at-corner: 1 drawn, 0 left out"]


def test_a_town_that_is_named_by_where_it_lies_is_found_again_by_its_list(corner, tmp_path, monkeypatch):
    wanted = WaySpec(part="free", profiles=("inattentive",), way_m=(15.0, 40.0))
    monkeypatch.setattr(make._Maker, "ways", lambda _, place, *_of: free_blocks(place, wanted, 1, 3))
    recipe = maker_in(tmp_path, hazards=0).recipe
    towns = parse_suite_towns(str(corner), tmp_path)
    file = make.make_suite(recipe, towns, lambda *_: None, named="x", seed=0, work=tmp_path)
    require_block_towns(file)
    ((name, town),) = load_suite_towns(file, tmp_path).items()
    assert town.folder == corner and {block.town for block in file.blocks} == {name}
    ((helsinki, _),) = parse_suite_towns("helsinki", tmp_path)
    assert [make._listed_as(helsinki, None), make._listed_as(helsinki, 7)] == ["helsinki", "helsinki"]


@pytest.mark.proof
def test_a_made_town_is_the_same_wherever_it_is_made(tmp_path):
    from wcsim.towns.scenario.town import content_hash

    ((first, seed),) = parse_suite_towns("made:9002", tmp_path / "a")
    ((second, _),) = parse_suite_towns("made:9002", tmp_path / "b")
    assert (first.name, seed) == ("made-9002", 9002)
    assert content_hash(first) == content_hash(second)

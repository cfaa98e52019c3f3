"""Lists hold only what is an episode: nobody who is hit at once, and what is left is driven again without them."""

from pathlib import Path

import pytest

from tests.agents.evaluation.suite.lists import episode
from wcsim.agents.evaluation.suite import make
from wcsim.agents.evaluation.suite.draw import Wanted, free_blocks
from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.opening.list_file import load_suite_towns, parse_suite_towns, require_block_towns
from wcsim.config import resolve
from wcsim.config.suite import SuiteBlock


def record(block: int, seat: int, time_s: float, status: str = "chair_crashed", fault: str = "own") -> EpisodeRecord:
    return EpisodeRecord(
        block=block, seat=seat, part="free", town="a", profile="b", status=status, fault=fault, time_s=time_s
    )


def block_with(*lengths_m: float) -> SuiteBlock:
    episodes = tuple(episode(route_m=length_m) for length_m in lengths_m)
    return SuiteBlock(part="free", town="a", seed=1, episodes=episodes)


def order_in(work: Path, hazards: int = 1) -> make.MakeOrder:
    return make.MakeOrder(
        suite="x-v1", set="x", seed=0, free_blocks=1, attempts=1, hazards=hazards, tight=range(0), work=work
    )


def test_who_is_left_out_is_missing_for_the_others_who_are_driven_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ways of 1 m end at once; without them a way of 2 m does, and then one of 3 m."""
    driven: list[list[list[float]]] = []

    def alone(_order: object, _towns: object, blocks: list[SuiteBlock], *_: object) -> tuple[EpisodeRecord, ...]:
        lengths = [[item.route_m for item in block.episodes] for block in blocks]
        driven.append(lengths)
        return tuple(
            record(number, seat, 1.0 if length_m == min(row) and length_m < 4.0 else 50.0)
            for number, row in enumerate(lengths)
            for seat, length_m in enumerate(row)
        )

    monkeypatch.setattr(make, "_alone", alone)
    order = order_in(tmp_path)
    blocks = [block_with(9.0, 8.0), block_with(1.0, 7.0, 2.0, 3.0), block_with(1.0)]
    left = make._settled(order, (), blocks, lambda _: None, "ways", lambda found: found.time_s >= make.BAD_START_S)
    assert [[item.route_m for item in block.episodes] for block in left] == [[9.0, 8.0], [7.0]]
    assert driven == [[[9.0, 8.0], [1.0, 7.0, 2.0, 3.0], [1.0]], [[7.0, 2.0, 3.0]], [[7.0, 3.0]], [[7.0]]]


def test_where_no_hazard_is_found_it_is_said_what_helps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who crashes among the others does not without them: the second drive of all."""
    ends, said = ["chair_crashed", "finished"], []
    monkeypatch.setattr(make, "_alone", lambda *_: (record(0, 0, 50.0, status=ends.pop(0)),) if ends else ())
    order = order_in(tmp_path)
    config = resolve("quick")
    assert make._hazards(order, (), [block_with(9.0)], config, lambda text, share: said.append((text, share))) == []
    ((text, share),) = said
    assert "no hazards found" in text and "--more-ways 6" in text and share == 0.0


def test_a_town_that_is_named_by_where_it_lies_is_found_again_by_its_list(
    corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = Wanted(part="free", profiles=("inattentive",), way_m=(15.0, 40.0))
    monkeypatch.setattr(make, "_free", lambda place, *_: free_blocks(place, wanted, 1, 3))
    monkeypatch.setattr(make, "_crossing", lambda *_: [])
    monkeypatch.setattr(make, "_settled", lambda _order, _towns, blocks, *_: list(blocks))
    order = order_in(tmp_path, hazards=0)
    file = make.make_suite(order, parse_suite_towns(str(corner), tmp_path), lambda *_: None)
    require_block_towns(file)
    ((name, town),) = load_suite_towns(file, tmp_path).items()
    assert town.folder == corner and {block.town for block in file.blocks} == {name}
    ((helsinki, _),) = parse_suite_towns("helsinki", tmp_path)
    assert [make._listed_as(helsinki, None), make._listed_as(helsinki, 7)] == ["helsinki", "helsinki"]


@pytest.mark.proof
def test_a_made_town_is_the_same_wherever_it_is_made_and_kept_where_it_is(tmp_path: Path) -> None:
    from wcsim.towns.scenario.town import content_hash

    ((first, seed),) = parse_suite_towns("made:9002", tmp_path / "a")
    ((second, _),) = parse_suite_towns("made:9002", tmp_path / "b")
    assert (first.name, seed) == ("made-9002", 9002)
    assert content_hash(first) == content_hash(second)
    before = first.net.stat().st_mtime_ns
    parse_suite_towns("made:9002", tmp_path / "a")
    assert first.net.stat().st_mtime_ns == before

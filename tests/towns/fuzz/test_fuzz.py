"""Mutants of sound town files: wcsim's process never dies or hangs, and says which file is wrong and what to do.

One that failed is run again by its number: `python -m tests.towns.fuzz.run FOLDER 137`.
"""

from collections import Counter
from pathlib import Path

import pytest

from tests.towns.fuzz.run import Outcome, run_batch, write_base
from tests.towns.fuzz.scenarios import DEADLY, DISK, FAMILIES, OWN, RAW, TREE, make_case

SAMPLE, ALL, BATCH = 6, 500, 25
SOUND = tuple(range(-len(FAMILIES), 0))


PLANTED = (f"{DEADLY}:", "-1:leaky", "-1:blunt", "-1:nameless", f"{DEADLY}:unchecked")


def check(outcomes: list[Outcome], numbers: tuple[int, ...]) -> None:
    """Refuse every fault, with its number."""
    assert tuple(item.number for item in outcomes) == numbers
    faults = [str(item) for item in outcomes if item.result == "fault"]
    assert not faults, "\n".join(faults)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all mutants of this file are made of one sound town, whose street and verdicts are kept."""
    return tmp_path_factory.mktemp("mutants")


@pytest.fixture(scope="module")
def outcomes(folder: Path) -> list[Outcome]:
    """Of the sound files, of a sample, and of wcsims with a fault; one child runs them, for its start is dear."""
    return run_batch((*SOUND, *range(SAMPLE), *PLANTED), folder)


@pytest.fixture(scope="module")
def planted(outcomes: list[Outcome]) -> dict[str, str]:
    """What the fuzzer says of a mutant in a wcsim with a fault."""
    ends = zip(PLANTED, outcomes[-len(PLANTED) :], strict=True)
    return {case.partition(":")[2]: f"{item.result}: {item.told}" for case, item in ends}


def test_the_sound_files_work_and_a_sample_of_their_mutants_is_no_fault(outcomes: list[Outcome]) -> None:
    outcomes = outcomes[: -len(PLANTED)]
    check(outcomes, (*SOUND, *range(SAMPLE)))
    assert {item.result for item in outcomes[: len(SOUND)]} == {"works"}
    results = Counter(item.result for item in outcomes[len(SOUND) :])
    assert results["works"] >= 2 and results["refused"] >= 2, results


@pytest.mark.proof
@pytest.mark.parametrize("first", range(0, ALL, BATCH))
def test_all_mutants(first: int, tmp_path: Path) -> None:
    numbers = tuple(range(first, first + BATCH))
    check(run_batch(numbers, tmp_path), numbers)


def test_every_change_is_made_to_every_family_it_fits() -> None:
    cases = [make_case(number) for number in range(ALL)]
    made = {family: {name for case in cases if case.family == family for name in case.changes} for family in FAMILIES}
    assert all(set(OWN[family]) <= made[family] for family in FAMILIES)
    assert set(TREE) | set(RAW) | set(DISK) <= set().union(*made.values())
    counts = Counter(case.family for case in cases)
    assert min(counts[family] for family in FAMILIES[:4]) >= 100 and counts["osm"] >= 50


def test_a_number_is_always_the_same_mutant(tmp_path: Path) -> None:
    contents = []
    for name in ("one", "two"):
        write_base(tmp_path / name)
        for number in (1, 6, 7, 20, 48):
            make_case(number).spoil(tmp_path / name / f"base.{'osm' if number == 48 else 'rou.xml'}")
        contents.append([(tmp_path / name / file).read_bytes() for file in ("base.osm", "base.rou.xml")])
    assert contents[0] == contents[1]


def test_a_wcsim_that_dies_of_a_mutant_is_found(planted: dict[str, str]) -> None:
    assert "refused: " in planted[""]
    assert "fault: the process died with -11" in planted["unchecked"]


@pytest.mark.parametrize(
    "fault, told",
    [
        ("leaky", "changed [('canary/leak.xml'"),
        ("blunt", "KeyError"),
        ("nameless", "the message names no file: something is wrong"),
    ],
)
def test_a_wcsim_with_a_fault_is_found(fault: str, told: str, planted: dict[str, str]) -> None:
    assert "fault: " in planted[fault] and told in planted[fault]


def test_a_wcsim_that_hangs_is_found(folder: Path) -> None:
    (outcome,) = run_batch(("-1:stuck",), folder, 6.0)
    assert (outcome.result, outcome.told) == ("fault", "hung for 6 s")

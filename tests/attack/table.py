"""The one table of what is attacked: a family added here is in the count and in the tests."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.attack.files import checkpoints, exports, files, journals, learners, maps, people, plants, policies, results
from tests.attack.files.family import Families, spoilt
from tests.attack.outcomes import Case
from tests.attack.peers import messages
from tests.attack.scenarios import scenarios

EACH = 3_000  # of a kind of file


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Some families that one generator makes: their writers and readers are in its module."""

    name: str
    cases: Callable[[int, int, Path], Iterator[Case]]  # count, seed, a folder that is empty again afterwards
    whole: int  # inputs of the whole attack
    sample: int  # of them in a test that everybody runs


def _of_files(name: str, families: Families, kinds: int, sample: int = 15) -> Row:
    return Row(name=name, cases=partial(spoilt, families), whole=EACH * kinds, sample=sample * kinds)


TABLE = (
    Row(name="messages", cases=messages.cases, whole=20_000, sample=900),
    Row(name="server", cases=messages.siege_cases, whole=20_000, sample=900),
    Row(name="scenarios", cases=scenarios.cases, whole=20_000, sample=240),
    Row(name="scenarios, SUMO started", cases=scenarios.started, whole=500, sample=6),
    Row(name="maps", cases=maps.cases, whole=8_000, sample=240),
    Row(name="--set", cases=files.set_cases, whole=4_000, sample=48),
    _of_files("settings, towns, runs, traces", files.families, 8),
    _of_files("studies, users, drives", people.families, 3),
    _of_files("results, lists, tables", results.families, 6),
    _of_files("FCD, MCAP", exports.families, 3),
    _of_files("danger networks", learners.families, 7, 10),
    Row(name="policies", cases=policies.cases, whole=6_000, sample=72),
    Row(name="checkpoints", cases=checkpoints.cases, whole=5_000, sample=72),
    Row(name="journals", cases=journals.cases, whole=20_000, sample=72),
    Row(name="ledgers, metrics, events", cases=journals.other_cases, whole=9_000, sample=180),
    Row(name="plants that drive", cases=plants.cases, whole=3_000, sample=24),
)

"""A kind of file that a person may get from another, and how a sound one is spoilt."""

import functools
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tests.attack.files.damage import cheap
from tests.attack.outcomes import Case, Outcome
from tests.attack.scenarios.twists import NASTY, PLACES, Data, Rng, draws, integer, pick, spoiled, toml_text, twisted

Take = Callable[[Path], bool]
Twist = Callable[[Rng], tuple[bytes, str]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """A kind of file: a sound one as its writer makes it, how it is spoilt, and its reader."""

    name: str
    file: str  # where it lies in a folder of its own
    sound: bytes
    twist: Twist
    take: Take  # whether what was made of the file makes the same again
    beside: tuple[tuple[str, bytes], ...] = ()  # files that a sound one needs


Families = Callable[[Path], Sequence[Family]]
"""Makes sound files, each once, in a folder that is empty again afterwards."""


def model_twist(data: Data, write: Callable[[Data], str], nasty: tuple[Any, ...] = NASTY) -> Twist:
    """Fields of a sound one are others, none or more than there were."""

    def twist(rng: Rng) -> tuple[bytes, str]:
        changed, told = twisted(data, rng, nasty)
        return write(changed).encode(), told

    return twist


def modelled(
    name: str,
    file: str,
    data: Data,
    take: Take,
    write: Callable[[Data], str] = toml_text,
    **more: Any,
) -> Family:
    """A kind of file whose sound one holds these fields."""
    twist = model_twist(data, write)
    return Family(name=name, file=file, sound=write(data).encode(), twist=twist, take=take, **more)


def spoilt(families: Families, count: int, seed: int, work: Path) -> Iterator[Case]:
    """So many hostile files, of each kind in turn; each is gone before the next one comes."""
    kinds = families(work)
    for number, rng in draws(count, seed):
        yield _case(kinds[number % len(kinds)], rng, number, work / "case")


def laid(kind: Family, folder: Path, lay: Callable[[Path], object]) -> bool | Outcome:
    """Have a file read in a new folder, with all that a sound one needs beside it; nothing is made outside of it."""
    path = folder / kind.file
    path.parent.mkdir(parents=True)
    around = set(folder.parent.iterdir())
    try:
        for name, data in kind.beside:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        lay(path)
        taken = kind.take(path)
        return Outcome.OUTSIDE if set(folder.parent.iterdir()) != around else taken
    finally:
        shutil.rmtree(folder)


def _case(kind: Family, rng: Rng, number: int, folder: Path) -> Case:
    how = integer(rng, 23)
    if how == 0:
        told = pick(rng, sorted(PLACES))
        feed = functools.partial(laid, kind, folder, PLACES[told])
    elif how == 1:
        path, told = folder / kind.file, "an odd path"
        odd = (path.with_name(f"x\0{path.name}"), folder / ("a" * 300) / kind.file, path / "deeper")
        wrong = pick(rng, odd)
        feed = functools.partial(laid, replace(kind, take=lambda _: kind.take(wrong)), folder, PLACES["nothing"])
    else:
        bad = cheap(rng) if how < 5 else spoiled(kind.sound, rng) if how < 11 else kind.twist(rng)
        data, told = (kind.sound, "sound") if how == 22 else bad
        feed = functools.partial(laid, kind, folder, lambda place: place.write_bytes(data))
    return Case(area=kind.name, name=f"{number}: {told}", feed=feed)

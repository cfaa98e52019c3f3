"""Breadth first through all states: safety on the way, progress at the end."""

import time
from array import array
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import TypeVar

from tests.server.model.scope import Scope, Violation
from tests.server.model.space import Space, World

Part = TypeVar("Part", bound=Hashable)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a check found; `wrong` is empty where all holds, `trace` is a shortest way to what does not."""

    states: int
    transitions: int
    seconds: float
    wrong: str = ""
    trace: tuple[str, ...] = ()

    def __str__(self) -> str:
        told = f"{self.states} states, {self.transitions} transitions, {self.seconds:.1f} s"
        return f"{told}: {self.wrong or 'holds'}" + "".join(f"\n  {label}" for label in self.trace)


class Search:
    """One run over a scope; `limit` bounds the states, for a scope that is to be cut off."""

    def __init__(self, scope: Scope, limit: int = 5_000_000) -> None:
        self._space, self._limit = Space(scope), limit
        self._worlds: list[World] = []
        self._ids: dict[tuple[int, ...], int] = {}
        self._parts: dict[Hashable, Hashable] = {}  # one object for each slot and each shadow
        self._known: set[int] = set()  # their addresses: what is there once is compared by it
        self._parents, self._labels = array("i"), list[str]()
        self._edges: list[array[int]] = []  # to which states each one leads without a fault
        self._transitions = 0

    def run(self) -> Report:
        """Explore everything, then look for states without a way on."""
        begun_s = time.perf_counter()
        goals: list[int] = []
        todo = deque([self._add(self._space.first(), (), -1, "")])
        at = 0
        wrong = ""
        while todo and not wrong:
            at = todo.popleft()
            try:
                self._expand(at, goals, todo)
            except Violation as found:
                wrong = str(found)
        if not wrong and len(self._worlds) >= self._limit:
            wrong = f"more than {self._limit} states"
        if not wrong:
            at = self._stuck(goals)
            wrong = "" if at < 0 else f"no way on from here: {self._worlds[at]}"
        return Report(
            states=len(self._worlds),
            transitions=self._transitions,
            seconds=time.perf_counter() - begun_s,
            wrong=wrong,
            trace=self._trace(at) if wrong else (),
        )

    def _add(self, world: World, key: tuple[int, ...], parent: int, label: str) -> int:
        self._ids[key] = number = len(self._worlds)
        self._worlds.append(world)
        self._edges.append(array("i"))
        self._parents.append(parent)
        self._labels.append(label)
        return number

    def _expand(self, at: int, goals: list[int], todo: deque[int]) -> None:
        world = self._worlds[at]
        if self._space.done(world):
            goals.append(at)
        for label, after in self._space.moves(world):
            self._transitions += 1
            shadow, slots = self._one(after.shadow), tuple([self._one(slot) for slot in after.slots])
            key = (after.server, id(shadow), *map(id, slots), *after.left)
            number = self._ids.get(key)
            if number is None:
                number = self._add(World(after.server, shadow, slots, after.left), key, at, label)
                if number < self._limit:
                    todo.append(number)
            if not label.startswith("!"):
                self._edges[at].append(number)

    def _one(self, part: Part) -> Part:
        if id(part) in self._known:
            return part
        one = self._parts.setdefault(part, part)
        self._known.add(id(one))
        return one  # type: ignore[return-value]

    def _stuck(self, goals: list[int]) -> int:
        """The first state from which no way without a fault leads to a goal; -1 where there is none."""
        back: list[list[int]] = [[] for _ in self._worlds]
        for source, targets in enumerate(self._edges):
            for target in targets:
                back[target].append(source)
        fine, todo = set(goals), deque(goals)
        while todo:
            for source in back[todo.popleft()]:
                if source not in fine:
                    fine.add(source)
                    todo.append(source)
        return next((i for i in range(len(self._worlds)) if i not in fine), -1)

    def _trace(self, at: int) -> tuple[str, ...]:
        labels = []
        while at > 0:
            labels.append(self._labels[at])
            at = self._parents[at]
        return tuple(reversed(labels))

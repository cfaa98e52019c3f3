"""Observers and policies for tests of a drive."""

import json

from wcsim.agents.policy_api import Observation
from wcsim.drive import messages as m
from wcsim.drive.driven import DriveRecord
from wcsim.log.records import Admitted, DriveTick, Note, Respawned


class Noted:
    """Keeps what it hears."""

    def __init__(self) -> None:
        self.ticks: list[DriveTick] = []
        self.events: list[Note] = []
        self.inputs: list[Respawned | Admitted] = []
        self.closed = 0

    def __call__(self, record: DriveRecord) -> None:
        if isinstance(record, DriveTick):
            self.ticks.append(record)
        elif isinstance(record, Note):
            self.events.append(record)
        else:
            self.inputs.append(record)

    def close(self) -> None:
        self.closed += 1

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]


class Breaks:
    """Drives for five ticks, and then raises."""

    name, warning = "breaks", True

    def __init__(self, config: object) -> None:
        self.asked = 0

    def begin(self) -> None:
        pass

    def reset(self) -> None:
        self.asked = 0

    def act(self, observation: Observation) -> int:
        self.asked += 1
        if self.asked > 5:
            raise ValueError("out of ideas")
        return 40


class SeesNumbers(Breaks):
    """Stands still, and keeps the sticks in the rows that it sees and overwrites, and those beside them."""

    name, senses = "sees-numbers", ("state",)

    def __init__(self, config: object) -> None:
        self.sticks: list[tuple[float, ...]] = []

    def reset(self) -> None:
        pass

    def act(self, observation: Observation) -> int:
        self.sticks.append(tuple(observation["state"][0, 1:3].tolist()))
        observation["state"][:] = 0.0
        self.sticks.append(tuple(observation["joystick"].tolist()))
        return 40


class BreaksAtOnce:
    """Raises whenever it is asked, or whenever an episode begins."""

    name = "breaks-at-once"

    def __init__(self, where: str) -> None:
        self._where = where

    def begin(self) -> None:
        pass

    def reset(self) -> None:
        self._at("reset")

    def act(self, observation: Observation) -> int:
        self._at("act")
        return 40

    def _at(self, where: str) -> None:
        if where == self._where:
            raise ValueError("out of ideas")


class Remembers:
    """Holds the right half for unsafe, goes straight back, and notes what was sent instead."""

    name, warning = "remembers", False
    levels = (0.0, 2.0)

    def __init__(self, count: int = 81) -> None:
        import numpy as np

        self.heard: list[int] = []
        self.level = 1.0
        self.unsafe = np.arange(count) >= 45

    def begin(self) -> None:
        pass

    def reset(self) -> None:
        pass

    def set_level(self, level: float) -> None:
        self.level = level

    def act(self, observation: Observation) -> int:
        action = self.choose(observation)
        self.sent(action)
        return action

    def choose(self, observation: Observation) -> int:
        return 36  # stick back

    def sent(self, action: int) -> None:
        self.heard.append(action)


class HearsDelays:
    """Notes each delay that it is told, and each episode."""

    name = "hears delays"

    def __init__(self, config: object) -> None:
        self.heard: list[object] = []

    def begin(self) -> None:
        pass

    def reset(self) -> None:
        self.heard.append("reset")

    def set_delay(self, ticks: int) -> None:
        self.heard.append(ticks)

    def act(self, observation: Observation) -> int:
        return 40


def as_said(say: str, **more: object) -> m.PageMessage:
    """What a page, or the server itself, says to a runner."""
    own = {"ready": m.Ready, "gone": m.Gone, "end": m.End}
    return own[say]() if say in own else m.of_page(json.dumps({"say": say, **more}, ensure_ascii=False).encode())

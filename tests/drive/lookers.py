"""Observers and policies for tests of a drive."""

import json

import numpy as np

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


class Stands:
    """Stands still; what it hears is kept."""

    name = "stands"

    def __init__(self, config: object = None) -> None:
        self.heard: list[object] = []

    def begin(self) -> None:
        pass

    def reset(self) -> None:
        pass

    def act(self, observation: Observation) -> int:
        return 40


class Breaks(Stands):
    """Drives for five ticks, and then raises."""

    warning, asked = True, 0

    def reset(self) -> None:
        self.asked = 0

    def act(self, observation: Observation) -> int:
        self.asked += 1
        if self.asked > 5:
            raise ValueError("out of ideas")
        return super().act(observation)


class SeesNumbers(Stands):
    """Keeps the sticks in the rows that it sees and overwrites, and those beside them."""

    senses = ("state",)

    def act(self, observation: Observation) -> int:
        self.heard.append(tuple(observation["state"][0, 1:3].tolist()))
        observation["state"][:] = 0.0
        self.heard.append(tuple(observation["joystick"].tolist()))
        return super().act(observation)


class BreaksAtOnce(Stands):
    """Raises whenever it is asked, or whenever an episode begins."""

    def __init__(self, where: str) -> None:
        self._where = where

    def reset(self) -> None:
        self._at("reset")

    def act(self, observation: Observation) -> int:
        self._at("act")
        return super().act(observation)

    def _at(self, where: str) -> None:
        if where == self._where:
            raise ValueError("out of ideas")


class Remembers(Stands):
    """Holds the right half for unsafe, goes straight back, and notes what was sent instead."""

    warning = False
    levels, level = (0.0, 2.0), 1.0
    unsafe = np.arange(81) >= 45

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


class HearsDelays(Stands):
    """Notes each delay that it is told, and each episode."""

    def reset(self) -> None:
        self.heard.append("reset")

    def set_delay(self, ticks: int) -> None:
        self.heard.append(ticks)


def as_said(say: str, **more: object) -> m.PageMessage:
    """What a page, or the server itself, says to a runner."""
    own = {"ready": m.Ready, "gone": m.Gone, "end": m.End}
    return own[say]() if say in own else m.of_page(json.dumps({"say": say, **more}, ensure_ascii=False).encode())

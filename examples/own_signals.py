"""Step hooks: traffic lights of one's own.

    wcsim town run monaco --hook own_signals:AllRedAtTimes
    wcsim town run monaco --hook own_signals:GreenForChairs

A hook gets the libsumo module, which speaks SUMO's TraCI without a socket, and the wheelchairs, which SUMO has not.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

from wcsim.bridge.sumo.step_hook import HookChair

PERIOD_S, RED_S = 60.0, 15.0
HOLD_S = 1.0


class AllRedAtTimes:
    """Once a minute every traffic light is red for cars and people alike, then goes on with its own programme."""

    def __init__(self, libsumo: ModuleType) -> None:
        self._lights = libsumo.trafficlight
        self._programmes = {name: self._lights.getProgram(name) for name in self._lights.getIDList()}
        self._red = False

    def before_step(self, time_s: float, chairs: Sequence[HookChair]) -> None:
        """Called with SUMO's time before each of its steps."""
        wanted = time_s % PERIOD_S < RED_S
        if wanted != self._red:
            self._red = wanted
            for name, programme in self._programmes.items():
                if wanted:
                    self._lights.setRedYellowGreenState(name, "r" * len(self._lights.getRedYellowGreenState(name)))
                else:
                    self._lights.setProgram(name, programme)


class GreenForChairs:
    """A crossing that is green stays so as long as a wheelchair is on it."""

    def __init__(self, libsumo: ModuleType) -> None:
        self._lights = lights = libsumo.trafficlight
        links = [(name, *each) for name in lights.getIDList() for each in enumerate(lights.getControlledLinks(name))]
        self._light_of = {lane.rpartition("_")[0]: (name, k) for name, k, ways in links for _, lane, _ in ways}

    def before_step(self, time_s: float, chairs: Sequence[HookChair]) -> None:
        """Called with SUMO's time and the wheelchairs before each of its steps."""
        for name, link in (self._light_of[c.edges[0]] for c in chairs if c.edges[0] in self._light_of):
            is_green = self._lights.getRedYellowGreenState(name)[link] in "gG"
            if is_green and self._lights.getNextSwitch(name) < time_s + HOLD_S:
                self._lights.setPhaseDuration(name, HOLD_S)

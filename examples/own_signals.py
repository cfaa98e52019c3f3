"""A step hook: traffic lights of one's own.

    wcsim town run monaco --hook own_signals:AllRedAtTimes

It gets the libsumo module, which speaks SUMO's TraCI without a socket.
"""

from __future__ import annotations

from types import ModuleType

PERIOD_S, RED_S = 60.0, 15.0


class AllRedAtTimes:
    """Once a minute every traffic light is red for cars and people alike, then goes on with its own programme."""

    def __init__(self, libsumo: ModuleType) -> None:
        self._lights = libsumo.trafficlight
        self._programmes = {name: self._lights.getProgram(name) for name in self._lights.getIDList()}
        self._red = False

    def before_step(self, time_s: float) -> None:
        """Called with SUMO's time before each of its steps."""
        wanted = time_s % PERIOD_S < RED_S
        if wanted != self._red:
            self._red = wanted
            for name, programme in self._programmes.items():
                if wanted:
                    self._lights.setRedYellowGreenState(name, "r" * len(self._lights.getRedYellowGreenState(name)))
                else:
                    self._lights.setProgram(name, programme)

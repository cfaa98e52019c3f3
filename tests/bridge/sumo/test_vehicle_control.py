"""Orders to vehicles and people, without SUMO."""

import pytest

from wcsim.bridge.reaction.commands import LET_GO, ActorCommand
from wcsim.bridge.sumo.vehicle_control import VehicleControl

OWN_MODE = 31


class GoneError(Exception):
    """What SUMO says of who is not there."""


class People:
    def setSpeed(self, name: str, speed_mps: float) -> None:
        raise GoneError(name)

    def remove(self, name: str) -> None:
        raise GoneError(name)


class Vehicles:
    """One vehicle, called 5 as a person is."""

    def __init__(self) -> None:
        self.speed_mode, self.lane_mode = OWN_MODE, 1621

    def getSpeedMode(self, name: str) -> int:
        return self.speed_mode

    def getLaneChangeMode(self, name: str) -> int:
        return self.lane_mode

    def setSpeedMode(self, name: str, mode: int) -> None:
        self.speed_mode = mode

    def setLaneChangeMode(self, name: str, mode: int) -> None:
        self.lane_mode = mode

    def setSpeed(self, name: str, speed_mps: float) -> None:
        pass


class Sumo:
    TraCIException = GoneError

    def __init__(self) -> None:
        self.person, self.vehicle = People(), Vehicles()


@pytest.mark.parametrize("leaves", ["is told something", "is turned away"])
def test_a_vehicle_gets_its_modes_back_though_a_person_of_its_name_has_left(leaves):
    sumo = Sumo()
    pilot = VehicleControl(sumo, (0.0, 0.0))
    pilot.apply(ActorCommand(actor_id="v:5", speed_mps=0.0, hard=True))
    assert sumo.vehicle.speed_mode != OWN_MODE
    if leaves == "is told something":
        pilot.apply(ActorCommand(actor_id="p:5", speed_mps=0.0))
    else:
        pilot.turn_away("p:5")
    pilot.apply(ActorCommand(actor_id="v:5", speed_mps=LET_GO))
    assert sumo.vehicle.speed_mode == OWN_MODE

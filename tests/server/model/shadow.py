"""What a checker knows of the world: the chairs that are there. It refuses what `bridge.World` would refuse."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tests.server.model.scope import Violation
from wcsim.server.protocol.events import (
    AdmitSeatEffect,
    DismissSeatEffect,
    Effect,
    RebuildWorldEffect,
    RespawnSeatsEffect,
)
from wcsim.types import Command


@dataclass(frozen=True, slots=True)
class Chair:
    """One chair; its number is never given again."""

    seat: int
    number: int
    owner: str
    life: int = 0


@dataclass(frozen=True, slots=True)
class Shadow:
    """The world of one moment; chairs in seat order."""

    epoch: int = 0
    tick: int = 0
    chairs: tuple[Chair, ...] = ()
    made: int = 0

    def at(self, seat: int) -> Chair | None:
        """The chair on a seat."""
        return next((chair for chair in self.chairs if chair.seat == seat), None)

    def admit(self, seat: int, owner: str) -> Shadow:
        """A new chair. Raises Violation for a seat that is taken."""
        if self.at(seat) is not None:
            raise Violation(f"admit for seat {seat}, which is taken")
        chairs = sorted((*self.chairs, Chair(seat, self.made, owner)), key=lambda chair: chair.seat)
        return replace(self, chairs=tuple(chairs), made=self.made + 1)

    def dismiss(self, seat: int) -> Shadow:
        """A chair goes. Raises Violation for a free seat."""
        if self.at(seat) is None:
            raise Violation(f"dismiss for seat {seat}, which is free")
        return replace(self, chairs=tuple(chair for chair in self.chairs if chair.seat != seat))

    def respawn(self, seats: tuple[int, ...]) -> Shadow:
        """Next episodes. Raises Violation unless all are there and in order."""
        if list(seats) != sorted(set(seats)) or any(self.at(seat) is None for seat in seats):
            raise Violation(f"respawn of seats {seats}; there are {self._seats()}")
        chairs = tuple(replace(c, life=c.life + 1) if c.seat in seats else c for c in self.chairs)
        return replace(self, chairs=chairs)

    def rebuild(self, epoch: int) -> Shadow:
        """A new epoch with the chairs of now."""
        if epoch != self.epoch + 1:
            raise Violation(f"rebuilt for epoch {epoch} in epoch {self.epoch}")
        return self._at(epoch, 0)

    def after(self, effect: Effect) -> Shadow:
        """The world after what is done to it between ticks."""
        match effect:
            case AdmitSeatEffect():
                return self.admit(effect.seat, effect.name)
            case DismissSeatEffect():
                return self.dismiss(effect.seat)
            case RespawnSeatsEffect():
                return self.respawn(effect.seats)
            case RebuildWorldEffect():
                assert effect.seed >= 0
                return self.rebuild(effect.epoch)
        raise AssertionError(f"{effect}")

    def check(self, tick: int, commands: tuple[Command, ...], sticks: dict[str, float]) -> None:
        """Raise Violation unless each chair, and nothing else, has its own client's action of exactly this tick."""
        got = [(c.seat, c.tick) for c in commands]
        if tick != self.tick or got != [(seat, tick) for seat in self._seats()]:
            raise Violation(f"step {tick} with the commands {got}, at tick {self.tick} with seats {self._seats()}")
        for chair, command in zip(self.chairs, commands, strict=True):
            if (command.joystick.x, command.joystick.y) != (sticks[chair.owner], stick_of(self.epoch, tick)):
                raise Violation(f"step {tick}: the action of seat {chair.seat} is {command.joystick}, not {chair}'s")

    def stepped(self) -> Shadow:
        """One tick on."""
        return self._at(self.epoch, self.tick + 1)

    def _at(self, epoch: int, tick: int) -> Shadow:
        return replace(self, epoch=epoch, tick=tick, chairs=tuple(replace(c, life=0) for c in self.chairs))

    def _seats(self) -> list[int]:
        return [chair.seat for chair in self.chairs]


def stick_of(epoch: int, tick: int) -> float:
    """The y of every joystick at a tick: it tells what an action was meant for."""
    return (epoch % 10 * 100 + tick % 100) / 1024

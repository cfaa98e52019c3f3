"""A world of a simulated run: it hashes its commands, keeps a journal and refuses what the real one would refuse."""

import zlib

from tests.server.model.shadow import Shadow
from wcsim.server.protocol.events import Effect, StepWorldEffect


class Wrong(Exception):
    """The run broke a promise of the protocol."""


class SimWorld:
    """The chairs of now, and what every tick was made of."""

    def __init__(self) -> None:
        self._shadow = Shadow()
        self.journal: list[tuple[int, int, tuple[tuple[int, float], ...]]] = []  # epoch, tick, (seat, x) of commands
        self.hash = 0
        self.rebuilt = False  # somebody asked for it

    @property
    def epoch(self) -> int:
        """The epoch of now."""
        return self._shadow.epoch

    @property
    def tick(self) -> int:
        """The tick of now."""
        return self._shadow.tick

    def step(self, step: StepWorldEffect) -> None:
        """One tick. Raises Violation unless every chair has its own client's action of exactly this tick."""
        sticks = {chair.owner: int(chair.owner[1:]) / 8 for chair in self._shadow.chairs}
        self._shadow.check(step.tick, step.commands, sticks)
        told = tuple((c.seat, c.joystick.x) for c in step.commands)
        self.journal.append((self.epoch, step.tick, told))
        self.hash = zlib.crc32(repr(told).encode(), self.hash)
        self._shadow = self._shadow.stepped()

    def show(self, seat: int, epoch: int, tick: int, life: int) -> int:
        """The number of the chair whose frame this is. Raises Wrong for one that is not there, or not now."""
        chair = self._shadow.at(seat)
        if chair is None or (epoch, tick, life) != (self.epoch, self.tick, chair.life):
            raise Wrong(f"a frame of {(epoch, tick, life)} for seat {seat}: {chair} at {(self.epoch, self.tick)}")
        return chair.number

    def change(self, effect: Effect) -> None:
        """A chair comes or goes, next episodes, or a new epoch with the chairs of now."""
        self._shadow = self._shadow.after(effect)

    def begin_again(self) -> None:
        """A new epoch after the world's death: nobody is in."""
        self._shadow = Shadow(epoch=self.epoch + 1, made=self._shadow.made)

    def audit(self) -> None:
        """Raise Wrong unless no tick was done twice or left out."""
        last = (0, -1)
        for epoch, tick, _ in self.journal:
            if (epoch, tick) != (last[0], last[1] + 1) and not (epoch > last[0] and tick == 0):
                raise Wrong(f"tick {(epoch, tick)} after {last}")
            last = (epoch, tick)

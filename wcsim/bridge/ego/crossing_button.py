"""The button at a crossing: a chair that stands before a red one of its route for some time asks for green.

Whoever drives the chair, the person in it can press: what counts is where the chair stands and where its route goes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from wcsim.bridge.reaction.commands import GreenRequest
from wcsim.config import WorldConfig
from wcsim.types import Route, SignalState, Street
from wcsim.users.crossing import Crossing, crossings, is_red, kerb_m
from wcsim.users.route_line import Path

STANDS_MPS = 0.1
_BEFORE_M = 1.0  # of the footplate, before where the way comes near to the road
_BEYOND_M = 1.9  # and beyond the crossing's beginning: who rolled over the line at red waits there


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reach:
    """A crossing with a light, and from where to where on the route the footplate is at its button."""

    crossing: Crossing
    from_m: float
    to_m: float


class CrossingButton:
    """The buttons on one route, and the one that its chair has pressed; needs every tick."""

    def __init__(self, route: Route, street: Street, half_length_m: float, world: WorldConfig) -> None:
        """`half_length_m` is the chair's; `world` says whether it presses, and after how long."""
        path = Path(route)
        self._items = tuple(
            _Reach(
                crossing=item,
                from_m=kerb_m(street.grid, path, item.start_m) - _BEFORE_M - half_length_m,
                to_m=min(item.start_m + _BEYOND_M, item.end_m) - half_length_m,
            )
            for item in crossings(route, street.walk)
            if world.button and item.tls_id
        )
        self._after_s = world.button_after_s
        self._at: Crossing | None = None
        self._since_s = 0.0
        self._pressed = False

    def see(
        self, arc_m: float, speed_mps: float, time_s: float, signals: Iterable[SignalState]
    ) -> GreenRequest | None:
        """What the chair asks for now: from the press on until the light is green or the chair has left.

        Args:
            arc_m: Of the chair's middle on the route.
            speed_mps: Of the chair, ahead.
            time_s: Now.
            signals: The lights near the chair.
        """
        red = (reach.crossing for reach in self._items if reach.from_m <= arc_m <= reach.to_m)
        here = next((crossing for crossing in red if is_red(crossing, signals)), None)
        if here is None or here is not self._at:
            self._at, self._since_s, self._pressed = here, time_s, False
        if here is None:
            return None
        if not self._pressed and abs(speed_mps) > STANDS_MPS:
            self._since_s = time_s
        self._pressed = self._pressed or time_s - self._since_s >= self._after_s - 1e-6
        return GreenRequest(tls_id=here.tls_id, links=here.tls_links) if self._pressed else None

"""Requests a crossing's green of a traffic light of SUMO, as a push button does.

SUMO's actuated programs detect people on foot through its own walking areas, where a chair never
is: a crossing whose green is optional stays red for it. The request takes nothing out of the
program. The running phase has its minimum, what follows is one of the phases that the program
itself allows next, and each of them runs as usual.

The session hands libsumo in: `bridge/sumo/session.py` stays the only file that loads it.
"""

import logging
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from wcsim.bridge.reaction.commands import GreenRequest
from wcsim.towns.sumo.xml_io import is_true
from wcsim.types import SignalState

log = logging.getLogger("wcsim.bridge.sumo.signal_control")

_SAME_TIME_S = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class _Phase:
    """A phase of a program, as far as a button has to know it."""

    shows: SignalState
    least_s: float  # before it may end
    following: tuple[int, ...]  # the phases that may come next
    fixed: bool = False  # it always lasts as long, and one phase follows


Program = tuple[_Phase, ...]


class SignalControl:
    """The buttons of one simulation's traffic lights."""

    def __init__(self, libsumo: Any) -> None:
        self._api = libsumo
        self._programs: dict[tuple[str, str], Program | None] = {}

    def forget(self) -> None:
        """SUMO was loaded anew."""
        self._programs.clear()

    def request(self, requests: Sequence[GreenRequest]) -> None:
        """Bring lights nearer to the green that chairs wait for; before each step in that time.

        Of several requests to one light the first one counts, until it has green.
        """
        # Reversed, so that the first of several requests to one light is the one that stays.
        for tls_id, request in {request.tls_id: request for request in reversed(requests)}.items():
            try:
                self._advance(tls_id, request.links)
            except self._api.TraCIException:
                log.debug("traffic light %s ignores the request", tls_id)

    def _advance(self, tls_id: str, links: Sequence[int]) -> None:
        lights = self._api.trafficlight
        program, now = self._program(tls_id, lights.getProgram(tls_id)), lights.getPhase(tls_id)
        if program is None or not 0 <= now < len(program) or program[now].fixed:
            return
        following = _towards_green(program, now, links)
        least_s = program[now].least_s - _SAME_TIME_S
        if following is not None and lights.getSpentDuration(tls_id) >= least_s:
            lights.setPhase(tls_id, following)
            # Without this an actuated program leaves the new phase in the next step: no yellow.
            lights.setPhaseDuration(tls_id, program[following].least_s)

    def _program(self, tls_id: str, program_id: str) -> Program | None:
        """A program; None for one that has no place for a request."""
        key = (tls_id, program_id)
        if key not in self._programs:
            logics = self._api.trafficlight.getAllProgramLogics(tls_id)
            by_id = {logic.programID: logic for logic in logics}
            found = program_id in by_id
            self._programs[key] = self._read(tls_id, by_id[program_id]) if found else None
        return self._programs[key]

    def _read(self, tls_id: str, logic: Any) -> Program | None:
        kinds = self._api.constants
        flexible = kinds.TRAFFICLIGHT_TYPE_ACTUATED, kinds.TRAFFICLIGHT_TYPE_DELAYBASED
        actuated = logic.type in flexible
        coordinated = is_true(dict(logic.subParameter).get("coordinated", ""))
        # A coordinated program is in step with its neighbours, and a request would put it out.
        if coordinated or not (actuated or logic.type == kinds.TRAFFICLIGHT_TYPE_STATIC):
            return None
        program, count = [], len(logic.phases)
        for number, phase in enumerate(logic.phases):
            least_s = phase.minDur if actuated else phase.duration
            most_s = phase.maxDur if actuated else phase.duration
            following = tuple(k for k in phase.next if 0 <= k < count) or ((number + 1) % count,)
            shows = SignalState(tls_id=tls_id, colours=phase.state)
            fixed = most_s <= least_s and len(following) == 1
            lasts_s = float(least_s)
            program.append(_Phase(shows=shows, least_s=lasts_s, following=following, fixed=fixed))
        return tuple(program)


def _towards_green(program: Program, now: int, links: Sequence[int]) -> int | None:
    """The next phase on the shortest way to one that frees all these links.

    None when the phase of now does, or when the program never reaches one from here.
    """
    if program[now].shows.frees(links):
        return None
    first_of = {now: now}
    # Breadth first: the first phase found that frees them all is the one fewest phases away.
    open_phases = deque([now])
    while open_phases:
        here = open_phases.popleft()
        for phase in program[here].following:
            if phase in first_of:
                continue
            first_of[phase] = phase if here == now else first_of[here]
            if program[phase].shows.frees(links):
                return first_of[phase]
            open_phases.append(phase)
    return None

"""What copies of the world say of an episode.

Whether interventions and warnings were needed, crashes avoidable.

A fork is a copy of the world in which somebody else drives from this tick on: the user alone, or a
stick that is held.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final

from wcsim.agents.envs.episode_view import EnvStepResult
from wcsim.agents.evaluation.suite.records import (
    NEEDED,
    NEEDLESS,
    NOT_JUDGED,
    EpisodeRecord,
    Intervention,
)
from wcsim.agents.policy_api import Policy
from wcsim.bridge.world import World
from wcsim.bridge.world_copy import in_copy
from wcsim.bridge.world_rollout import Driver, rollout
from wcsim.config import CameraConfig
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pinhole, pose_matrix
from wcsim.supervisor.actions import ActionSet
from wcsim.supervisor.rewards import find_hardest_contact
from wcsim.types import F32, F64, ClientSnapshot, Joystick

JOINED_S: Final = 0.5  # gaps below this join two runs
BEFORE_S: Final = 5.0  # an own crash with no intervention so long before was missed
AHEAD_S: Final = 1.0  # a warning counts when it comes so long before the crash
ALONE_S: Final = 5.0  # so long a fork looks ahead
AGAIN_S: Final = 2.0  # after so long an intervention is judged again
# Whether a crash could be survived.
EVERY_S: Final = 0.3
SINCE_S: Final = 3.0  # before the crash
ON_S: Final = 3.0  # after it: so long no crash may follow
# Let go, half aside to either side, back, half ahead.
STICKS: Final = (
    Joystick(0.0, 0.0),
    Joystick(0.5, 0.0),
    Joystick(-0.5, 0.0),
    Joystick(0.0, -0.5),
    Joystick(0.0, 0.5),
)
_REACH_M: Final = 0.5  # from the middle of a chair, or of somebody, to what is met first
_ANSWER: Final = struct.Struct("<i")

# the chair's pose (3, 4), where actors are, its depth pictures
_Moment = tuple[F64, dict[str, F64], list[F32]]


def _extended(spans: list[list[int]], step: int, tick_s: float) -> bool:
    """Put a step into runs of steps, each with its first and last, over short gaps.

    Whether a run begins with it.
    """
    if spans and (step - spans[-1][1] - 1) * tick_s < JOINED_S - 1e-9:
        spans[-1][1] = step
        return False
    spans.append([step, step])
    return True


@dataclass(slots=True)
class Alarms:
    """What a policy did against its user's wish in an episode, and when it warned.

    `tick_s` is the length of a step.
    """

    tick_s: float
    taken: list[list[int]] = field(default_factory=list)  # first and last step of each intervention
    warned: list[list[int]] = field(default_factory=list)
    # by step: when the user alone would have crashed
    alone_s: dict[int, float | None] = field(default_factory=dict)

    def begin(self, step: int, taken: bool, warned: bool) -> bool:
        """Note a step.

        Whether an intervention or a warning begins with it, or goes on for another 2 s.
        """
        begins = taken and _extended(self.taken, step, self.tick_s)
        again = taken and (step - self.taken[-1][0]) % round(AGAIN_S / self.tick_s) == 0
        return (warned and _extended(self.warned, step, self.tick_s)) or begins or again

    def interventions(self) -> tuple[Intervention, ...]:
        """Every run, with the verdict of its first fork where there was one."""
        found = []
        for first, last in self.taken:
            crash_s = self.alone_s.get(first)
            verdict = (
                NOT_JUDGED if first not in self.alone_s else NEEDLESS if crash_s is None else NEEDED
            )
            # What a fork says holds until the next one.
            forked = [step for step in sorted(self.alone_s) if first <= step <= last]
            needless = sum(
                until - step
                for step, until in pairwise([*forked, last + 1])
                if self.alone_s[step] is None
            )
            found.append(
                Intervention(
                    first=first,
                    last=last,
                    verdict=verdict,
                    crash_after_s=crash_s,
                    needless_steps=needless,
                )
            )
        return tuple(found)

    def missed(self, crash_step: int) -> bool:
        """Whether nothing was done against a crash in the 5 s before it."""
        since = crash_step - round(BEFORE_S / self.tick_s)
        return not any(last >= since for _, last in self.taken)

    def warnings(self, own_step: int | None, other_step: int | None = None) -> tuple[int, int, int]:
        """Dangers that were warned of at least 1 s ahead, all dangers, and false warnings.

        Crashes, an own one and those that forks found, with less than 1 s between them are one
        danger, from the first of them on: several forks see the same one come. A run of warnings
        is false where no crash follows, whosever fault it is.

        Args:
            own_step: Of the own crash that ended the episode.
            other_step: Of the other's.
        """
        found = [
            first + round(crash_s / self.tick_s)
            for first, crash_s in self.alone_s.items()
            if crash_s is not None
        ]
        crashes = sorted([*found, *([] if own_step is None else [own_step])])
        ahead, reach = round(AHEAD_S / self.tick_s), round(BEFORE_S / self.tick_s)
        dangers = [
            step
            for number, step in enumerate(crashes)
            if not number or step - crashes[number - 1] >= ahead
        ]
        spans = self.warned
        warned_of = sum(
            any(a <= step - ahead and b >= step - reach for a, b in spans) for step in dangers
        )
        all_crashes = [*crashes, *([] if other_step is None else [other_step])]
        ended = own_step is not None or other_step is not None
        judged = [span for span in spans if span[0] in self.alone_s or ended]
        false = sum(
            not any(first <= step <= last + reach for step in all_crashes) for first, last in judged
        )
        return warned_of, len(dangers), false


class Survival:
    """Looks on while crashed episodes are driven once more.

    How late could they be survived, and why were they not?

    Args:
        crashed: Their records, by seat.
        handovers: Steps of each before its policy took over.
        tick_s: Length of a step.
    """

    def __init__(
        self, crashed: Mapping[int, EpisodeRecord], handovers: Mapping[int, int], tick_s: float
    ) -> None:
        self.records = dict(crashed)
        self._tick_s = tick_s
        self._left = {seat: handovers[seat] + record.steps for seat, record in crashed.items()}
        self._past: dict[int, list[_Moment]] = {seat: [] for seat in crashed}

    @property
    def seats(self) -> frozenset[int]:
        """Those that are looked at."""
        return frozenset(self.records)

    def see(self, seat: int, step: EnvStepResult, world: World, _policy: Policy) -> None:
        """Try to survive from here, where it is time for that."""
        if seat not in self.records:
            return
        self._left[seat] -= 1
        left = self._left[seat]
        every, since, on, before = (
            round(each_s / self._tick_s) for each_s in (EVERY_S, SINCE_S, ON_S, BEFORE_S)
        )
        if left >= before:
            return
        (client,) = (each for each in world.snapshot.clients if each.seat == seat)
        pose = pose_matrix(client.plant.p_WB_m, client.plant.q_WB)
        places = {actor.id: actor.p_W_m.copy() for actor in world.snapshot.actors}
        self._past[seat].append(
            (pose, places, [frame.depth_m.copy() for frame in client.sensors.cameras])
        )
        if not 0 < left <= since or left % every:
            return
        for stick in STICKS:

            def hold(_: ClientSnapshot, held: Joystick = stick) -> Joystick:
                return held

            if _crash_tick(world, seat, hold, left + on) is None:
                self.records[seat] = replace(
                    self.records[seat], last_moment_s=round(left * self._tick_s, 6)
                )
                break

    def ended(self, seat: int, world: World) -> None:
        """Say why it was not survived."""
        record = self.records[seat]
        (client,) = (each for each in world.snapshot.clients if each.seat == seat)
        hit = find_hardest_contact(record.reason, client.contacts, world.config.reward)
        # What stands was where the chair went.
        ahead_m = _REACH_M if client.plant.v_B_mps[0] > 0.0 else -_REACH_M
        place_m = self._past[seat][-1][0] @ (ahead_m, 0.0, 0.0, 1.0)
        met = hit.actor_id if hit else ""
        shown = any(
            _shows(camera, pose, places.get(met, place_m), depth_m)
            for pose, places, depths in self._past[seat]
            if not met or met in places
            for camera, depth_m in zip(world.config.cameras, depths, strict=False)
        )
        moment = record.steps - round((record.last_moment_s or 0.0) / self._tick_s)
        spans = [
            item
            for item in record.interventions
            if item.last >= record.steps - round(BEFORE_S / self._tick_s)
        ]
        if not spans:
            cause = "missed" if shown else "unseen"
        elif spans[0].first > moment:
            cause = "late"
        else:
            cause = (
                "in_vain"
                if any(item.first <= moment <= item.last for item in spans)
                else "given_back"
            )
        self.records[seat] = replace(record, cause=cause)


def _shows(camera: CameraConfig, T_WB: F64, p_W_m: F64, depth_m: F32) -> bool:
    """Whether a place is in a picture, and nothing before it."""
    x, y, z = camera_matrix(T_WB, mount(camera)) @ (*p_W_m, 1.0)
    height, width = depth_m.shape
    lens = pinhole(camera)
    if z < lens.near_m:
        return False
    u, v = (round(0.5 * size + lens.focal_px * at / z) for size, at in ((width, x), (height, y)))
    return (
        0 <= u < width and 0 <= v < height and (not depth_m[v, u] or depth_m[v, u] > z - _REACH_M)
    )


def crash_alone_s(world: World, seat: int, actions: ActionSet, tick_s: float) -> float | None:
    """Seconds until a seat's chair crashes when its user drives alone from now on.

    None within `ALONE_S`.

    Raises PhysicsError as `_crash_tick` does.
    """
    tick = _crash_tick(world, seat, _users_alone(actions), round(ALONE_S / tick_s))
    return None if tick is None else tick * tick_s


def _crash_tick(world: World, seat: int, driver: Driver, ticks: int) -> int | None:
    """The tick, from 1, in which a seat's chair crashes with this driver from now on.

    None within so many.

    The other chairs leave the street of the copy. The world itself does not move.

    Raises:
        PhysicsError: The copy ended without an answer.
    """

    def drive(copy: World) -> bytes:
        for other in [ego.index for ego in copy.seats if ego.index != seat]:
            copy.dismiss(other)
        copy.go_blind()
        copy.drop_step_limits()  # a fork at the end of an episode looks as far ahead as any other
        for tick, step in zip(range(1, ticks + 1), rollout(copy, {seat: driver}), strict=False):
            (client,) = step.after.clients
            if client.events.crashed:
                return _ANSWER.pack(tick)
            if client.first is not None or client.events.arrived or client.events.gave_up:
                break  # an episode ends here, and whatever came on the next way
        return _ANSWER.pack(0)

    (tick,) = _ANSWER.unpack(in_copy(world, drive))
    return tick or None


def _users_alone(actions: ActionSet) -> Driver:
    """Drives as a seat's user alone does: with the action nearest to the stick."""

    def choose(now: ClientSnapshot) -> Joystick:
        return Joystick(*actions.points[actions.nearest((now.user.x, now.user.y))].tolist())

    return choose

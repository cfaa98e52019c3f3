"""Why a chair drove into something: which link from the picture to the command was the first to break.

The drive is done in a copy of the world first, which says where it ends. What stands there (a step of the ground, a
wall, somebody) is then looked for at every tick of the same drive: in the picture, in what the policy has noted of the
street, under the places of the chair that the policy looks at, and in its verdict on the command that it gives. Where
all of these hold, it gave a command that it knew to be bad.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from benchmarks.judge.held_stick import Driven, HeldStreet
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.danger.street_map import (
    AGE,
    BEHIND_M,
    CELL_M,
    EACH_SLICE,
    HALF_M,
    HIGHEST,
    LOW_M,
    LOWEST,
    SIDE,
    SLICES,
    SPAN_M,
)
from wcsim.agents.perception.arcs import LONGEST_S, STEP_S, integrate_chair_state
from wcsim.agents.perception.depth_image import viewing_rays
from wcsim.agents.perception.ego_motion import body_to_odometric, odometric_to_body
from wcsim.agents.perception.surroundings import outline_to_box
from wcsim.agents.policies.dwa import DynamicWindowPolicy, VetoPolicy
from wcsim.agents.policy_api import Policy, SeesTruth, TellsUnsafe
from wcsim.bridge.world_copy import in_copy
from wcsim.core.constants import KERB_STEP_M
from wcsim.core.joystick import drive_limits_from_chair, shape_joysticks
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.rollout import HOLD_S
from wcsim.types import F64, U8, Bool, ClientSnapshot, Ground, Joystick

LINKS: Final = ("picture", "map", "sweep", "verdict")
AROUND_M: Final = 0.25  # of the chair where it crashed: what stands there was hit
NEAR_M: Final = 0.2  # two cells of a map
SHOWS_M: Final = 0.03  # higher or lower than the ground below the axle
_RASTER_M: Final = 0.05


class Look(NamedTuple):
    """What holds at a tick; True for what does."""

    picture: bool
    map: bool
    sweep: bool
    verdict: bool
    late: bool  # letting go would not help any more


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """A drive and its links."""

    driven: Driven
    broke: str  # the first link that did not hold at the last moment; "" for none, or without an own crash
    held_until_s: dict[str, float | None]  # before the crash, each link the last time


def chain(street: HeldStreet, ticks: int) -> Chain:
    """The links of a drive from where the chair stands now; `HeldStreet.begin` was called."""
    said = json.loads(in_copy(street.world, lambda _copy: _crash_site(street, ticks)))
    site = _Site(said["pose"], said["actor"], street)
    looks: list[Look] = []
    driven = street.drive(ticks, lambda now: looks.append(site.look(now)))
    if not driven.own:
        return Chain(driven=driven, broke="", held_until_s={})
    # The last moment at which letting go would have been enough.
    last = next((look for look in reversed(looks) if not look.late), looks[0])
    broke = next((name for name in LINKS if not getattr(last, name)), "command")
    tick_s = street.config.world.tick_s
    held = {name: [number for number, look in enumerate(looks) if getattr(look, name)] for name in LINKS}
    until = {name: round((len(looks) - ticks[-1]) * tick_s, 3) if ticks else None for name, ticks in held.items()}
    return Chain(driven=driven, broke=broke, held_until_s=until)


def _crash_site(street: HeldStreet, ticks: int) -> bytes:
    """Where the drive ends, and with whom; in a copy."""
    poses: list[list[float]] = []
    street.drive(ticks, lambda now: poses.append(_pose(now).tolist()))
    contacts = street.world.snapshot.clients[0].contacts
    hit = max(contacts, key=lambda contact: contact.impulse_Ns, default=None)
    return json.dumps({"pose": poses[-1], "actor": "" if hit is None else hit.actor_id}).encode()


def _pose(now: ClientSnapshot) -> F64:
    return np.array([*now.plant.p_WB_m[:2], now.plant.yaw_rad])


class _Site:
    """What is looked for, and how each kind of policy looks for it."""

    def __init__(self, pose: list[float], actor: str, street: HeldStreet) -> None:
        config, policy = street.config, street.policy
        self._street, self._actor = street, actor
        spec = plant_spec(config.chair)
        self._box, self._limits = outline_to_box(spec.outline), drive_limits_from_chair(config.chair)
        self._outline = outline_points(self._box, 0.0)
        self._still_W_m = what_stands(street.world.street.grid, pose, self._box)
        camera = config.cameras[0]
        self._rays, self._eye = viewing_rays(camera), np.array(camera.p_BC_m)
        self._range_m = 0.99 * camera.range_m
        watched = policy.inner if isinstance(policy, VetoPolicy) else policy
        self._dwa = policy if isinstance(policy, DynamicWindowPolicy) else None
        self._net = watched if isinstance(watched, DangerPolicy) else None
        self._judged = np.array([*(p[:2] for p in spec.rims_m()), *spec.stand_m()])

    def look(self, now: ClientSnapshot) -> Look:
        """Every link at the tick of `now`, after the policy has chosen."""
        street, places_B_m = self._street, self._in_body(now)
        sent = street.driver.action
        stick, unsafe = Joystick(*street.actions.points[sent].tolist()), self._unsafe(now, street.policy)
        return Look(
            picture=self._pictured(now, places_B_m),
            map=self._mapped(places_B_m),
            sweep=self._swept(now, places_B_m, stick),
            verdict=bool(unsafe[sent]),
            late=self._meets(now, places_B_m, self._outline, stick, 0.0, LONGEST_S),
        )

    def _in_body(self, now: ClientSnapshot) -> F64:
        """What is looked for, (n, 2) in B of now."""
        places = self._still_W_m
        who = [actor for actor in self._street.world.view_of(0).actors if self._actor == actor.id]
        if who:
            length_m, width_m, _ = who[0].size_lwh_m
            box = outline_points(np.array([-0.5 * length_m, 0.5 * length_m, 0.5 * width_m]), 0.0)
            places = body_to_odometric(box, np.array([*who[0].p_W_m[:2], who[0].yaw_rad]))
        return odometric_to_body(places, _pose(now))

    def _pictured(self, now: ClientSnapshot, places_B_m: F64) -> bool:
        frame = now.sensors.cameras[0]
        depth_m = frame.depth_m.reshape(-1).astype(np.float64)
        seen = (depth_m > 0.0) & (depth_m < self._range_m)
        points = self._eye + self._rays[seen] * depth_m[seen, None]
        points = points[np.abs(points[:, 2]) > SHOWS_M]
        return int(np.count_nonzero(_gaps(points[:, :2], places_B_m) < NEAR_M)) > 2

    def _mapped(self, places_B_m: F64) -> bool:
        if self._dwa is not None:
            noted = self._dwa.around.in_the_way(0.0)[:, :2]
        elif self._net is not None:
            noted = _steps_of(self._net.features.picture)
        else:
            return True  # the oracle knows the street
        return bool((_gaps(noted, places_B_m) < NEAR_M).any())

    def _swept(self, now: ClientSnapshot, places_B_m: F64, stick: Joystick) -> bool:
        """Whether the places that the policy looks at come there when the stick is held."""
        if self._dwa is not None:
            points, hold_s, most_s = outline_points(self._box, 0.07), 0.3, LONGEST_S
        elif self._net is not None:
            points = self._net.extractor.chair[:, :2]
            hold_s, most_s = HOLD_S, SLICES * EACH_SLICE * STEP_S
        elif isinstance(self._street.policy, SeesTruth):
            points, hold_s, most_s = self._judged, HOLD_S, 60.0
        else:
            points, hold_s, most_s = self._outline, HOLD_S, LONGEST_S
        return self._meets(now, places_B_m, points, stick, hold_s, most_s)

    def _meets(
        self, now: ClientSnapshot, places_B_m: F64, points_B_m: F64, stick: Joystick, hold_s: float, most_s: float
    ) -> bool:
        """Whether points of the chair come within half a cell of what is looked for."""
        shaped = shape_joysticks(np.array([[stick.x, stick.y]]), self._street.config.chair)[0]
        state = np.array([0.0, 0.0, 0.0, now.plant.v_B_mps[0], now.plant.w_B_radps[2], 0.0])
        at_s = 0.0
        while at_s < most_s and (at_s < hold_s - 1e-9 or state[3] != 0.0 or abs(state[4]) > 1e-3):
            integrate_chair_state(state, shaped if at_s < hold_s - 1e-9 else np.zeros(2), self._limits, STEP_S)
            at_s += STEP_S
            if (_gaps(body_to_odometric(points_B_m, state[:3]), places_B_m) < 0.5 * CELL_M).any():
                return True
        return False

    def _unsafe(self, now: ClientSnapshot, policy: Policy) -> Bool:
        if isinstance(policy, TellsUnsafe):
            return np.asarray(policy.unsafe)
        if now.truth is not None and isinstance(policy, SeesTruth):
            return ~now.truth.safe_actions
        return np.zeros(len(self._street.actions), np.bool_)


def what_stands(ground: Ground, pose: list[float], box: F64) -> F64:
    """Places (n, 2) in W of steps of the ground and of solid things around a chair where it crashed."""
    ahead = np.arange(box[0] - AROUND_M, box[1] + AROUND_M, _RASTER_M)
    left = np.arange(-box[2], box[2], _RASTER_M)
    grid = np.stack(np.meshgrid(ahead, left), axis=-1).reshape(-1, 2)
    places = body_to_odometric(grid, np.array(pose))
    around = places[:, None] + np.array([(0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)])
    steps = np.abs(ground.raised_at(around) - ground.raised_at(places)[:, None]).max(axis=1) > KERB_STEP_M
    there: F64 = places[steps | (ground.clearance_at(places) < 0.1)]
    return there


def outline_points(box: F64, more_m: float) -> F64:
    """Points (n, 2) in B on the edge of a box (3,), grown all around."""
    rear, front, half = box[0] - more_m, box[1] + more_m, box[2] + more_m
    ahead, left = np.arange(rear, front + 0.01, 0.05), np.arange(-half, half + 0.01, 0.05)
    sides = [np.stack([ahead, np.full_like(ahead, y)], axis=-1) for y in (-half, half)]
    ends = [np.stack([np.full_like(left, x), left], axis=-1) for x in (rear, front)]
    return np.concatenate([*sides, *ends])


def _gaps(points: F64, places: F64) -> F64:
    """(n,) from each point to the nearest place."""
    if not len(places):
        return np.full(len(points), np.inf)
    return np.asarray(KDTree(places).query(points)[0])


def _steps_of(picture: U8) -> F64:
    """Cells (n, 2) in B of a street map that lie higher or lower than the ground below the axle."""
    known = picture[AGE] > 0
    high, low = (LOW_M + (picture[plane] - 1.0) / 254.0 * SPAN_M for plane in (HIGHEST, LOWEST))
    rows, columns = np.nonzero(known & ((high > SHOWS_M) | (low < -SHOWS_M)))
    return np.stack([(SIDE - rows - 0.5) * CELL_M - BEHIND_M, HALF_M - (columns + 0.5) * CELL_M], axis=-1)

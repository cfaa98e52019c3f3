"""One seat under the eyes of `python -m benchmarks crashes`: what came before a crash, and how the chair obeyed."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.crashes.classes import FALL_REMEMBERED_S, CrashFacts, classify, meets_kerb
from benchmarks.crashes.in_picture import BODY_M, Sight, actor_points, in_picture, street_points
from benchmarks.crashes.kerb_departures import KerbFall, nearest_way
from benchmarks.crashes.lost_control import Stretch, Track, stretches
from benchmarks.crashes.records import Crash, Episode, LostControl
from wcsim.bridge.ego.ego import AT_REST, Ego
from wcsim.bridge.reaction.commands import ROADWAY
from wcsim.config import RunConfig
from wcsim.core.frames import deg
from wcsim.physics.sensors.camera_geometry import camera_matrix, mount, pinhole, pose_matrix
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.rewards import GROUND_KINDS, fault, hardest
from wcsim.towns.importing.map_marks import CAR
from wcsim.types import F64, ActorState, ClientSnapshot, Contact, Joystick, PlantState, Street
from wcsim.users.recorded import RecordedUser

_NEWEST_S, _OLDEST_S = 0.3, 1.0  # before a crash: when what was hit should have been in the picture
_SAFE_S = 1.0  # and when some action should have been safe
_AWAY_S = 2.0  # and for how long the user should have looked
STEP_M = 0.05  # of height, more than a low kerb's
BESIDE_M = 0.15  # around the chair's box a kerb is beside it
_PARKED_ID = f"v:{CAR}."
_OF_STREET: Final = frozenset({"ground", "kerb", "building", "static"})


@dataclass(frozen=True, slots=True, kw_only=True)
class _Frame:
    """What must be remembered of a tick in case that a crash follows."""

    sight: Sight | None
    others: tuple[ActorState, ...]
    away: bool | None
    safe: bool | None
    speed_mps: float


class SeatWatch:
    """Follows one seat from tick to tick; what it found is in `crashes`, `lost` and `episodes`."""

    def __init__(
        self,
        seat: Ego,
        street: Street,
        config: RunConfig,
        first: ClientSnapshot,
        others: tuple[ActorState, ...],
    ) -> None:
        """Begin with the first frame of the seat's first episode; `others` is everybody but its chair."""
        self.crashes: list[Crash] = []
        self.lost: list[LostControl] = []
        self.episodes: list[Episode] = []
        self.steps = self.falls = self.lost_steps = 0
        self.km = 0.0
        self._seat, self._street, self._config = seat, street, config
        self._tick_s = config.world.tick_s
        self._pinhole = pinhole(config.cameras[0])
        self._wheels_B_m = np.array(plant_spec(config.chair).stand_m())
        self._fell_at: int | None = None  # tick of the last fall off a kerb in this episode
        self._begin(first, others)

    def give(self, stick: Joystick) -> None:
        """Hear what the chair is told for the coming tick."""
        self._waiting.append(stick)
        had = self._waiting.popleft()
        self._sticks.append((had.x, had.y))
        self._user = self._seat.user  # a crash brings the next one

    def take(self, client: ClientSnapshot, others: tuple[ActorState, ...]) -> None:
        """See what came of it; `others` is everybody but this chair."""
        plant = client.plant
        speed_mps = float(np.hypot(plant.v_B_mps[0], plant.v_B_mps[1]))
        self.steps += 1
        self.km += 0.001 * speed_mps * self._tick_s
        self._plants.append(plant)
        if self._fall.see(self._middle(plant)):
            self.falls += 1
            self._fell_at = client.tick
        if client.events.crashed:
            self.crashes.append(self._crash(client, others))
        if client.first is not None:
            self._end(client.events.crash_reason or "cut")
            self._begin(client.first, others)
        else:
            self._remember(client, others)

    def close(self) -> None:
        """The run is over."""
        self._end("")

    def _begin(self, first: ClientSnapshot, others: tuple[ActorState, ...]) -> None:
        drawn = first.drawn.action_delay_ticks if first.drawn is not None else None
        delay = self._config.world.action_delay_ticks if drawn is None else drawn
        self._first = first
        self._waiting = deque([AT_REST] * delay)
        self._sticks: list[tuple[float, float]] = []
        self._plants = [first.plant]
        self._frames: deque[_Frame] = deque(maxlen=self._ticks(max(_AWAY_S, _SAFE_S, _OLDEST_S)))
        self._fall = KerbFall(self._street.grid, self._street.walk)
        self._fall.see(self._middle(first.plant))
        self._fell_at = None
        self._user = self._seat.user
        self._remember(first, others)

    def _remember(self, client: ClientSnapshot, others: tuple[ActorState, ...]) -> None:
        away = None if isinstance(self._user, RecordedUser) else self._user.witness is None
        frame = client.sensors.cameras[0]
        fitting = self._seat.fitting
        camera = self._config.cameras[0] if fitting is None else fitting.cameras[0]
        T_WB = pose_matrix(client.plant.p_WB_m, client.plant.q_WB)
        sight = Sight(depth_m=frame.depth_m.copy(), T_CW=camera_matrix(T_WB, mount(camera)))
        safe = None if client.truth is None else bool(client.truth.safe_actions.any())
        new = frame.taken_tick == client.tick  # a slower camera repeats its last picture
        speed_mps = float(np.hypot(client.plant.v_B_mps[0], client.plant.v_B_mps[1]))
        self._frames.append(
            _Frame(sight=sight if new else None, others=others, away=away, safe=safe, speed_mps=speed_mps)
        )

    def _crash(self, client: ClientSnapshot, others: tuple[ActorState, ...]) -> Crash:
        plant, events, reward = client.plant, client.events, self._config.reward
        x, y, _ = self._middle(plant).tolist()
        hit = hardest(events.crash_reason, client.contacts, reward)
        fell_s = None if self._fell_at is None else (client.tick - self._fell_at) * self._tick_s
        facts = CrashFacts(
            reason=events.crash_reason,
            contacts=client.contacts,
            on_road=self._street.grid.class_here(x, y) in ROADWAY,
            fell_s=fell_s,
            straddles=bool(np.ptp(self._raised_m(plant, self._wheels_B_m)) > STEP_M),
            kerb_beside=self._kerb_beside(plant),
            roll_rad=plant.roll_rad,
            pitch_rad=plant.pitch_rad,
            parked=hit is not None and hit.actor_id.startswith(_PARKED_ID),
        )
        kind = "kerb" if hit is None or (hit.kind in GROUND_KINDS and meets_kerb(facts)) else hit.kind
        thing, seen = self._seen(hit, kind, plant)
        known = [frame.away for frame in self._last(_AWAY_S) if frame.away is not None]
        safe = self._last(_SAFE_S)
        return Crash(
            seat=client.seat,
            episode=events.episode,
            tick=client.tick,
            step=events.step,
            p_W_m=(x, y),
            way=nearest_way(self._street.walk, x, y),
            kind=classify(facts, reward).value,
            reason=events.crash_reason,
            fault=fault(events.crash_reason, client.contacts, reward),
            thing=thing,
            part="" if hit is None else hit.part,
            impulse_Ns=0.0 if hit is None else hit.impulse_Ns,
            speed_mps=self._frames[-1].speed_mps,
            in_picture=seen,
            after_fall=events.crash_reason != "drop" and fell_s is not None and fell_s <= FALL_REMEMBERED_S,
            fell_s=fell_s,
            away_share=sum(known) / len(known) if known else None,
            safe_before=safe[0].safe if len(safe) >= self._ticks(_SAFE_S) else None,
        )

    def _seen(self, hit: Contact | None, kind: str, plant: PlantState) -> tuple[str, bool | None]:
        """What was hit (without a collision: a kerb nearby), and whether it was in the picture before."""
        frames = self._last(_OLDEST_S)
        frames = frames[: max(0, len(frames) - self._ticks(_NEWEST_S) + 1)]
        if hit is not None and hit.kind not in _OF_STREET:
            found = [(frame, actor) for frame in frames for actor in frame.others if actor.id == hit.actor_id]
            shown = (self._shows(frame, actor_points(actor), BODY_M) for frame, actor in found)
            return hit.actor_id, any(shown) if frames else None
        touched = street_points(self._street, kind, plant, self._seat.chair.outline)
        name = touched.name.lower() if hit is not None else ""
        if not frames or not len(touched.points_W_m):
            return name, None
        return name, any(self._shows(frame, touched.points_W_m) for frame in frames)

    def _shows(self, frame: _Frame, points_W_m: F64, more_m: float = 0.0) -> bool:
        return frame.sight is not None and in_picture(points_W_m, frame.sight, self._pinhole, more_m)

    def _end(self, how: str) -> None:
        """File the episode, and the stretches of it in which control was lost."""
        x, y, _ = self._middle(self._plants[0]).tolist()
        number, seat = self._first.events.episode, self._first.seat
        self.episodes.append(Episode(seat=seat, episode=number, start_W_m=(x, y), steps=len(self._sticks), end=how))
        track = Track(
            tick_s=self._tick_s,
            sticks=np.array(self._sticks, np.float64).reshape(-1, 2),
            speed_mps=np.array([plant.v_B_mps[0] for plant in self._plants]),
            turn_radps=np.array([plant.w_B_radps[2] for plant in self._plants]),
        )
        for stretch in stretches(track, self._config.chair):
            self.lost_steps += stretch.ticks
            self.lost.append(self._lost(stretch))

    def _lost(self, stretch: Stretch) -> LostControl:
        plants = self._plants[stretch.first + 1 : stretch.first + stretch.ticks + 1]
        x, y, _ = self._middle(plants[0]).tolist()
        return LostControl(
            seat=self._first.seat,
            episode=self._first.events.episode,
            tick=self._first.tick + stretch.first + 1,
            seconds=stretch.ticks * self._tick_s,
            p_W_m=(x, y),
            way=nearest_way(self._street.walk, x, y),
            turned=stretch.turned,
            rolled=stretch.rolled,
            roll_deg=deg(_largest([plant.roll_rad for plant in plants])),
            pitch_deg=deg(_largest([plant.pitch_rad for plant in plants])),
            speed_mps=_largest([float(plant.v_B_mps[0]) for plant in plants]),
            turn_radps=_largest([float(plant.w_B_radps[2]) for plant in plants]),
        )

    def _last(self, seconds: float) -> list[_Frame]:
        """The frames of the last so many seconds, the oldest first; the newest is that of the tick before this one."""
        return list(self._frames)[-self._ticks(seconds) :]

    def _ticks(self, seconds: float) -> int:
        return max(1, round(seconds / self._tick_s))

    def _middle(self, plant: PlantState) -> F64:
        ahead = np.array([math.cos(plant.yaw_rad), math.sin(plant.yaw_rad), 0.0])
        return np.asarray(plant.p_WB_m + self._seat.chair.outline.middle_x_m * ahead, np.float64)

    def _kerb_beside(self, plant: PlantState) -> bool:
        """Whether the ground rises around the chair's box."""
        outline, share = self._seat.chair.outline, np.linspace(-1.0, 1.0, 25)
        x_m, y_m = 0.5 * outline.length_m + BESIDE_M, 0.5 * outline.width_m + BESIDE_M
        sides = [(s * x_m, t * y_m) for k in share for s, t in ((k, -1.0), (k, 1.0), (-1.0, k), (1.0, k))]
        middle_B_m = np.array([[outline.middle_x_m, 0.0]])
        around_m = self._raised_m(plant, np.array(sides) + middle_B_m)
        return bool(around_m.max() - self._raised_m(plant, middle_B_m)[0] > STEP_M)

    def _raised_m(self, plant: PlantState, points_B_m: F64) -> F64:
        """Height of the ground (n,) above the lie of the land at points (n, 2) of the chair."""
        cos, sin = math.cos(plant.yaw_rad), math.sin(plant.yaw_rad)
        return self._street.grid.raised_at(plant.p_WB_m[:2] + points_B_m @ np.array([[cos, sin], [-sin, cos]]))


def _largest(values: list[float]) -> float:
    """The one that is farthest from 0, with its sign."""
    return max(values, key=abs)

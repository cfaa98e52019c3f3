"""One drive: a world, a chair with a person or a simulated user, a policy. No sockets, no clock."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from wcsim.agents.envs.episode_view import SeatEnvAdapter, env_to_policy_observation
from wcsim.bridge.ego.start_place import bearing_rad
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.core.closing import ClosingContextBase
from wcsim.core.joystick import shape_joystick
from wcsim.drive.assistance import Answer, Assistance
from wcsim.drive.driven import DriveObserver, DriveRecord, DriverKind, EventKind, happened_in
from wcsim.drive.starting import DriveStart, OpenPlace, open_place
from wcsim.log.records import Admitted, DriveTick, Note, Respawned, end_fields_from_snapshot
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.kpi import KpiTotals
from wcsim.types import F64, ClientSnapshot, Joystick, Route, StartSpec
from wcsim.types.chair import AT_REST
from wcsim.users.hand import clip_stick_to_gate
from wcsim.users.recordings.recorded_user import find_user

_NO_STICKS: Final[F64] = np.zeros((0, 2))  # of a person, known only when a tick begins
_FACES_RAD: Final = math.radians(45.0)  # a start faces a way that is within this to either side
_START_TRIES: Final = 6
_BACK_M: Final = 5.0  # from a crash to where the next episode begins
_NEAR: Final = 20  # points of the way, 1 m apart, at which a start that faces it may be
_TRAIL_M: Final = 0.5  # between places of the trail
_MOST_TRAIL: Final = 200
ELSEWHERE: Final = "elsewhere, as no place before the crash is free"


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What the person wants in a tick; the stick counts where the person drives."""

    stick: Joystick = AT_REST  # each part in -1..1
    overrule: bool = False
    help: bool = False
    pace: float = 1.0  # times real time, as the person sees it


class DriveSession(ClosingContextBase):
    """A drive, tick by tick; its observers get each tick and each event.

    Args:
        start: What to drive.
        observers: They are closed with the session.
        say: Hears how far `load_street` is.

    Raises:
        ConfigError, TownError, PolicyError: As `starting.open_place`.
    """

    def __init__(
        self,
        start: DriveStart,
        observers: Sequence[DriveObserver] = (),
        say: Callable[[str], object] | None = None,
    ) -> None:
        self.metrics, self.driver = KpiTotals(), DriverKind.PERSON
        self._observers = tuple(observers)
        # Ticks so far; number of the episode that is on, or that ended with the last tick.
        self.ticks = self.episode = 0
        # The chair now, and the route to its destination; after a crash those at the crash, until
        # the next tick.
        self.client: ClientSnapshot
        self.route: Route
        self.done_m = 0.0  # along the route
        self._help = False  # asked for since the last tick
        self.last: DriveTick | None = None  # of this episode
        # Actions that the policy called unsafe in the last tick; empty if it does not say.
        self.unsafe: tuple[int, ...] = ()
        self.shape = (start.speed, start.sensitivity)  # of the person's stick
        self._said = (False, False, False)  # warning, intervening, overruled, of the tick before
        self._seen: Mapping[str, Any] = {}  # the current observation, and its info
        self._info: dict[str, Any] = {}
        self._step, self._fresh, self._ended = 0, True, False  # of this episode
        self._failure = ""  # of the policy, that was reported
        with ExitStack() as held:
            self.place: OpenPlace = open_place(start, held)
            spec, config = self.place.spec, self.place.config
            self.profile, self.tick_s = spec.profile, config.world.tick_s
            self.actions = action_set(config.env.actions)
            self.assistance = Assistance(self.place.policy, self.actions, config.world.help_ticks)
            held.callback(self.assistance.close)
            self.world = held.enter_context(
                World(
                    self.place.town,
                    config,
                    (spec,),
                    self.place.seed,
                    report=say,
                    find_user=find_user,
                )
            )
            self._chair = SeatEnvAdapter(config)
            self._begin()
            self.assistance.reset(self.client.drawn)
            self._held = held.pop_all()
        self.say(EventKind.BEGUN, self.place.told)

    @property
    def time_s(self) -> float:
        """Seconds of driving since the drive began."""
        return self.ticks * self.tick_s

    @property
    def way_m(self) -> float:
        """Metres that the chair was driven, of the time that is judged."""
        return self.metrics.speed_sum * self.tick_s

    @property
    def counted_s(self) -> float:
        """Seconds of driving that are judged; as in the suite, none before a handover."""
        return self.metrics.ticks * self.tick_s

    @property
    def left_m(self) -> float:
        """Metres to the destination along the route."""
        return max(0.0, float(self.route.arc_m[-1]) - self.done_m)

    @property
    def bearing_rad(self) -> float:
        """Where the way goes on, to the left of the chair's heading; 0 is straight ahead."""
        return bearing_rad(self.route, self.done_m, self.client.plant)

    @property
    def crash(self) -> str:
        """What the last tick crashed into, in words, without the place; "" without a crash."""
        return self.client.events.crash.partition(", at x ")[0] if self._ended else ""

    @property
    def ended(self) -> bool:
        """Whether the episode ended with the last tick, by a crash or its step limit."""
        return self._ended

    @property
    def handed_over(self) -> bool:
        """Whether the person has the chair; in some suite episodes the user first drives alone."""
        return self._step >= self.place.handover_step

    def add_observer(self, observer: DriveObserver) -> None:
        """Send ticks and events to another observer from now on; it is closed with the session."""
        self._observers = (*self._observers, observer)

    def drive_by(self, driver: DriverKind) -> None:
        """Whose stick counts from now on."""
        if driver is not self.driver:
            self.driver = driver
            self.say(EventKind.DRIVER, driver.value)

    def assist(self, on: bool) -> None:
        """Switch the assistance. A policy that broke is tried again; a new failure is said."""
        if on is not self.assistance.on:
            self._failure = ""
            self.assistance.switch(on)
            if self.assistance.on is on:
                self.say(EventKind.ASSISTANCE, "on" if on else "off")
            self._say_failure()

    @property
    def help_left_s(self) -> float:
        """Seconds for which help is still on; 0 while it is not."""
        return self.assistance.help_left * self.tick_s

    def ask_for_help(self, raises: bool = True) -> None:
        """The user asks for help, which counts once a tick.

        It counts at once, as no tick may follow; the next tick says so too. With `raises` the
        assistance helps, if the user does not drive alone before a handover.
        """
        if self._help:
            return
        self._help = True
        self.metrics = self.metrics._replace(helps=self.metrics.helps + self.handed_over)
        if raises and self.handed_over:
            self.assistance.ask_for_help()
        deed = "assists the most" if self.assistance.levels else "drives the chair half as fast"
        more = (
            f" For {self.help_left_s:g} s the policy {deed}." if self.assistance.help_left else ""
        )
        self.say(EventKind.HELP, f"The user asks for help.{more}")
        self._say_failure()

    def set_level(self, level: float) -> None:
        """Set how much the policy assists. Raises PolicyError where it has no such level."""
        self.assistance.set_level(level)
        self.say(EventKind.LEVEL, f"{level:g}")

    def shape_stick(self, speed: float, sensitivity: float) -> None:
        """Set how the person's stick is shaped, as at a chair's controller."""
        self.shape = speed, sensitivity
        self.say(EventKind.STICK_SHAPE, self.shape_told)

    @property
    def shape_told(self) -> str:
        """The shape of the stick, in words."""
        speed, sensitivity = self.shape
        return f"speed {speed:g}, sensitivity {sensitivity:g}"

    def face_way(self) -> None:
        """Turn the chair to its way before the first tick, as in every later episode."""
        self._face_way()
        self.assistance.reset(self.client.drawn)

    def new_place(self) -> None:
        """Begin another episode in the same street, at the same start if that is fixed."""
        if not self._ended:
            self._respawn()
        self._next("asked for")

    def change_user(self, profile: str) -> None:
        """Put another simulated user into the chair, which begins an episode.

        Raises:
            ConfigError: There is no such user.
        """
        spec = replace(self.place.spec, profile=profile)
        self.world.dismiss(0)
        try:
            self.world.admit(0, spec)
        except BaseException:
            before = replace(self.place.spec, profile=self.profile)
            self.world.admit(0, before)
            self._send(Admitted(epoch=0, tick=self.ticks, seat=0, spec=before))
            self._next("as before")
            raise
        self.profile = profile
        self._send(Admitted(epoch=0, tick=self.ticks, seat=0, spec=spec))
        self._next(f"user {profile}")

    def again(self) -> None:
        """Build the whole street again from its seed."""
        self.world.rebuild(self.place.seed)
        self.say(EventKind.REBUILT)
        self._next("from the beginning")

    def tick(self, wish: Wish) -> DriveTick:
        """Drive one tick.

        Raises:
            SumoError, PhysicsError: The world is broken, and the drive with it.
        """
        if self._ended:
            crashed = self.client.events.crashed
            self._next(self._go_back() if crashed else "after the end of the last one")
        by_user = self.driver is DriverKind.SIMULATED or not self.handed_over
        self._hear_help(wish.help, by_user)
        if by_user:
            stick = self.client.user
        else:
            # As a chair's controller shapes it: slower, and softer or sharper about its middle.
            gated = clip_stick_to_gate(wish.stick)  # nobody sees the raw one
            speed, sensitivity = self.shape
            x, y = shape_joystick(gated.x, gated.y, 0.0, 1.0 / sensitivity)
            stick = Joystick(speed * x, speed * y)
        self._see(stick)
        overrule = wish.overrule and self.handed_over
        answer = self.assistance.answer(
            self._seen, self._info, asked=self.handed_over and not overrule
        )
        if self.assistance.failed and not self.assistance.on and answer.sent == answer.chosen:
            self._say_failure()
        user = self.world.seats[0].user
        intent = user.intent if by_user else None
        user.patient = not by_user
        self._move(answer)
        sticks = user.sticks if by_user else _NO_STICKS
        points = self.actions.points
        driven = DriveTick(
            tick=self.ticks,
            time_s=self.time_s,
            episode=self.episode,
            stick=stick,
            intent=intent,
            sticks=sticks.astype(np.float32),  # a copy, of half the bytes
            action=answer.chosen,
            chosen=Joystick(*points[answer.chosen].tolist()),
            commanded=Joystick(*points[answer.sent].tolist()),
            warning=answer.warning,
            intervening=answer.intervening,
            overruled=overrule,
            helped=self._help,
            pace=wish.pace,
            **end_fields_from_snapshot(self.client),
        )
        self.last, self.unsafe, self._help = driven, answer.unsafe, False
        helped = self.assistance.help_left > 0
        self.assistance.end_tick()
        if helped and not self.assistance.help_left:
            self.say(EventKind.HELP_END)
        self._tell(driven, self.actions.distance(answer.sent, (stick.x, stick.y)))
        return driven

    def say(self, kind: EventKind, told: str = "") -> None:
        """Send an event to the observers."""
        self._send(Note(kind=kind, tick=self.ticks, time_s=self.time_s, detail=told))

    def close(self) -> None:
        """End the world, and close the observers; a second call does nothing."""
        self._held.close()
        for observer in self._observers:
            close = getattr(observer, "close", None)
            if close is not None:
                close()
        self._observers = ()

    # --- one tick ---

    def _hear_help(self, wished: bool, by_user: bool) -> None:
        """Hear a request in the wish, or of the simulated user while it drives."""
        if wished:
            self.ask_for_help()
        elif by_user and self.client.events.help_asked:
            self.ask_for_help(raises=self.place.config.world.help_users)

    def _see(self, stick: Joystick) -> None:
        """Look at the chair's current frame with this stick, which also judges the last step."""
        client = replace(self.client, user=stick)
        if self._fresh:
            seen, self._info = self._chair.begin(client)
            self._fresh = False
        else:
            step = self._chair.finish_step(client)
            seen, self._info = step.observation, step.info
        self._seen = env_to_policy_observation(seen)

    def _move(self, answer: Answer) -> None:
        given = self._chair.command(answer.sent).joystick
        (self.client,) = next(rollout(self.world, {0: lambda now: given})).after.clients
        self._ended = self.client.first is not None
        if not self._ended:
            self._note_way()
            # The trail is where the chair was in this episode, without carriageways.
            here = _xy(self.client.plant.p_WB_m)
            moved = math.dist(here, self._trail[-1]) >= _TRAIL_M
            if moved and not self.client.events.on_carriageway:
                self._trail.append(here)
        self.ticks += 1
        self._step += 1

    def _tell(self, driven: DriveTick, distance: float) -> None:
        """Count the tick and send its events; `distance` is between stick and command."""
        if self._step > self.place.handover_step:
            happened = happened_in(driven) - {"helps"}  # a request for help counts when it is heard
            self.metrics = self.metrics.plus(happened, distance, driven.speed_mps)
            if driven.ends:  # a drive may end before the next episode begins
                self.metrics = self.metrics.after_episode()
        now = (driven.warning, driven.intervening, driven.overruled)
        kinds = (EventKind.WARNING, EventKind.INTERVENING, EventKind.OVERRULE)
        for kind, is_on, was in zip(kinds, now, self._said, strict=True):
            if is_on and not was:
                self.say(kind)
        if self._said[2] and not driven.overruled:
            self.say(EventKind.OVERRULE_END)
        self._said = now
        if driven.arrived:
            self.say(EventKind.ARRIVED)
        if driven.gave_up:
            self.say(EventKind.GAVE_UP)
        if driven.crashed:
            self.say(EventKind.CRASHED, self.crash)
        elif self._ended:
            self.say(EventKind.STEP_LIMIT)
        self._send(driven)

    def _send(self, record: DriveRecord) -> None:
        for observer in self._observers:
            observer(record)

    def _say_failure(self) -> None:
        if self.assistance.failed != self._failure:
            self._failure = self.assistance.failed
            if self._failure:
                self.say(EventKind.POLICY_FAILED, self._failure)

    # --- episodes ---

    def _begin(self) -> None:
        """Look at the first frame of an episode."""
        client = self.world.snapshot.clients[0]
        self.client = client if client.first is None else client.first
        self._step, self._fresh, self._ended = 0, True, False
        self.last, self.unsafe = None, ()
        self._trail = deque([_xy(self.client.plant.p_WB_m)], _MOST_TRAIL)
        self._note_way()

    def _note_way(self) -> None:
        seat = self.world.seats[0]
        self.route, self.done_m = seat.route, seat.user.route_progress_m

    def _respawn(self, start: StartSpec | None = None) -> None:
        """Begin the world's next episode, and let recordings know."""
        self.world.respawn(0, start=start)
        self._send(Respawned(epoch=0, tick=self.ticks, seat=0, start=start))

    def _face_way(self) -> None:
        """Turn the chair to its way, here, nearby or elsewhere; a fixed start stays."""
        for _ in range(0 if self.place.spec.start else _START_TRIES):
            if abs(self.bearing_rad) < _FACES_RAD:
                return
            near = [_xy(self.client.plant.p_WB_m), *map(_xy, self.route.points_W_m[:_NEAR])]
            self._respawn(self.world.start_facing(0, near, _xy(self.route.points_W_m[-1])))
            self._begin()

    def _go_back(self) -> str:
        """Go back some metres after a crash, to the same destination; returns where, in words."""
        if self.place.spec.start:
            return "at its start"
        crash = _xy(self.client.plant.p_WB_m)
        before = [xy for xy in reversed(self._trail) if math.dist(xy, crash) >= _BACK_M]
        start = self.world.start_facing(
            0, [*before, self._trail[0]], _xy(self.route.points_W_m[-1])
        )
        if start is None:
            return ELSEWHERE
        self._respawn(start)
        return "before the crash"

    def _next(self, why: str) -> None:
        self.metrics = self.metrics.after_episode()
        self.episode += 1
        self._begin()
        self._face_way()
        self.assistance.reset(self.client.drawn)
        self.say(EventKind.EPISODE, why)


def _xy(place_m: F64) -> tuple[float, float]:
    return float(place_m[0]), float(place_m[1])

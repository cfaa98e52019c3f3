"""One drive: a world with one chair, a person or a simulated user in it, a policy beside it. No sockets, no clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from wcsim.agents.envs.episode_view import Chair, HeldLink
from wcsim.bridge.drives.beside import let_wait
from wcsim.bridge.world import World
from wcsim.core.closing import Closing
from wcsim.core.frames import wrap
from wcsim.drive.assistance import Answer, Assistance
from wcsim.drive.driven import DriveEvent, DrivenTick, DriveObserver, DriverKind, EventKind
from wcsim.drive.starting import DriveStart, OpenPlace, open_place
from wcsim.drive.tally import DriveTally
from wcsim.supervisor.actions import action_set
from wcsim.types import F64, ClientSnapshot, Command, Joystick, PlantState, Route
from wcsim.users.hand import on_disc

AT_REST = Joystick(0.0, 0.0)
NO_STICKS: Final[F64] = np.zeros((0, 2))  # of a person, whose stick is known at the ticks' beginnings alone
_LOOK_AHEAD_M = 3.0
_FACES_RAD: Final = math.radians(100.0)  # a way within this to either side is one that a start faces
_START_TRIES: Final = 6  # of a start that is asked for


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What the person wants in a tick; the stick counts where the person drives."""

    stick: Joystick = AT_REST  # each part in -1..1
    overrule: bool = False
    help: bool = False


class DriveSession(Closing):
    """A drive, tick by tick; its observers hear of each tick and of what happens.

    Args:
        start: What to drive.
        observers: Who looks on; they are closed with the session.
    """

    def __init__(
        self,
        start: DriveStart,
        observers: Sequence[DriveObserver] = (),
        say: Callable[[str], object] | None = None,
    ) -> None:
        """Open the town and the policy; `say` is for `load_street`. Raises what `starting.open_place` does."""
        self.tally, self.driver = DriveTally(), DriverKind.PERSON
        self._observers, self._held = tuple(observers), ExitStack()
        self._ticks, self._episode, self._help = 0, 0, False  # `_help`: asked for since the last tick
        self._said = (False, False, False)  # warning, intervening, overruled, of the tick before
        self._seen: Mapping[str, Any] = {}  # the observation of now, and its info
        self._info: dict[str, Any] = {}
        self._step, self._fresh, self._ended = 0, True, False  # of this episode
        self._failure = ""  # of the policy, as far as it has been told
        try:
            self.place: OpenPlace = open_place(start, self._held)
            self.profile = self.place.spec.profile
            self.actions = action_set(self.place.config.env.actions)
            self.tick_s = self.place.config.world.tick_s
            self.assistance = Assistance(self.place.policy, self.actions)
            self._held.callback(self.assistance.close)
            spec, config = self.place.spec, self.place.config
            self.world = self._held.enter_context(World(self.place.town, config, (spec,), self.place.seed, say=say))
            self._chair, self._link = Chair(config), HeldLink()
            self._begin()
            self.assistance.begin(self._client.drawn)
        except BaseException:
            self._held.close()
            raise
        self.say(EventKind.BEGUN, self.place.told)

    @property
    def time_s(self) -> float:
        """Seconds of driving since the drive began."""
        return self._ticks * self.tick_s

    @property
    def counted_s(self) -> float:
        """Seconds of driving that are judged: as in the suite, none before a handover, when the user drives alone."""
        return self.tally.ticks * self.tick_s

    @property
    def ticks(self) -> int:
        """How many there were."""
        return self._ticks

    @property
    def episode(self) -> int:
        """Number of the episode that is on, or that ended with the last tick; the first is 0."""
        return self._episode

    @property
    def client(self) -> ClientSnapshot:
        """The chair as it is now; after a crash as it came to lie, till the next tick."""
        return self._client

    @property
    def route(self) -> Route:
        """The way to the destination; after a crash that of the episode which it ended, till the next tick."""
        return self._route

    @property
    def left_m(self) -> float:
        """How far it is to the destination along the route."""
        return max(0.0, float(self._route.arc_m[-1]) - self._done_m)

    @property
    def done_m(self) -> float:
        """How far along its route the chair has come."""
        return self._done_m

    @property
    def bearing_rad(self) -> float:
        """Where the way goes on, from the chair's heading to the left; 0 straight ahead."""
        return way_bearing_rad(self._route, self._done_m, self._client.plant)

    @property
    def crash(self) -> str:
        """What the last tick crashed into, in words, without the place; "" where it did not."""
        return self._client.events.crash.partition(", at x ")[0] if self._ended else ""

    @property
    def ended(self) -> bool:
        """Whether the episode ended with the last tick, by a crash or its step limit; the next one begins elsewhere."""
        return self._ended

    @property
    def handed_over(self) -> bool:
        """Whether the person has the chair by now: in some episodes of suites the user drives alone at first."""
        return self._step >= self.place.handover_step

    def look_on(self, observer: DriveObserver) -> None:
        """Tell somebody else from now on; closed with the session, as the others are."""
        self._observers = (*self._observers, observer)

    def drive_by(self, driver: DriverKind) -> None:
        """Whose stick counts from now on."""
        if driver is not self.driver:
            self.driver = driver
            self.say(EventKind.DRIVER, driver.value)

    def assist(self, on: bool) -> None:
        """Switch the assistance; one that broke is tried again, and told of again where it breaks again."""
        if on is not self.assistance.on:
            self._failure = ""
            self.assistance.switch(on)
            if self.assistance.on is on:
                self.say(EventKind.ASSISTANCE, "on" if on else "off")
            self._say_failure()

    def ask_for_help(self) -> None:
        """The person asks for help: once a tick, and it counts at once, as no tick may follow; the next says so too."""
        if self._help:
            return
        self._help = True
        self.tally.helps += self.handed_over
        self.say(EventKind.HELP, "the user asks for help")

    def set_level(self, level: float) -> None:
        """Set how much the policy assists. Raises PolicyError where it has no such level."""
        self.assistance.set_level(level)
        self.say(EventKind.LEVEL, f"{level:g}")

    def new_place(self) -> None:
        """Begin another episode in the same street, at a start that faces its way if one is found in a few tries.

        Where the start is fixed, at that. Each try is an event of its own, so a recording makes them again.
        """
        if not self._ended:
            self._respawn()
        for _ in range(0 if self.place.spec.start else _START_TRIES):
            self._begin()
            if abs(self.bearing_rad) < _FACES_RAD:
                break
            self._respawn()
        self._next("asked for")

    def change_user(self, profile: str) -> None:
        """Put another simulated user into the chair, in an episode of its own. Raises ConfigError for no such user."""
        spec = replace(self.place.spec, profile=profile)
        self.world.dismiss(0)
        try:
            self.world.admit(0, spec)
        except BaseException:
            self.world.admit(0, replace(self.place.spec, profile=self.profile))
            self.say(EventKind.USER, self.profile)
            self._next("as before")
            raise
        self.profile = profile
        self.say(EventKind.USER, profile)
        self._next(f"user {profile}")

    def again(self) -> None:
        """Begin the whole street again from its seed."""
        self.world.rebuild(self.place.seed)
        self.say(EventKind.REBUILT)
        self._next("from the beginning")

    def tick(self, wish: Wish) -> DrivenTick:
        """Drive one tick.

        Raises:
            SumoError, PhysicsError: The world is broken, and the drive with it.
        """
        if self._ended:
            self._next("after the end of the last one")
        if wish.help:
            self.ask_for_help()
        by_user = self.driver is DriverKind.SIMULATED or not self.handed_over
        stick = self._client.user if by_user else in_gate(wish.stick)
        self._see(stick)
        overrule = wish.overrule and self.handed_over
        answer = self.assistance.answer(self._seen, self._info, asked=self.handed_over and not overrule)
        if self.assistance.failed and not self.assistance.on and answer.sent == answer.chosen:
            self._say_failure()
        user, intent = self.world.seats[0].user, self._intent() if by_user else None
        let_wait(user, patient=not by_user)
        self._move(answer)
        sticks = user.sticks.copy() if by_user else NO_STICKS
        driven = self._driven(stick, intent, sticks, answer, replace(wish, overrule=overrule, help=self._help))
        self._help = False
        self._tell(driven)
        return driven

    def say(self, kind: EventKind, told: str = "") -> None:
        """Write an event into the log of whoever looks on."""
        event = DriveEvent(kind=kind, tick=self._ticks, time_s=self.time_s, told=told)
        for observer in self._observers:
            observer.event(event)

    def close(self) -> None:
        """End the world, and close the observers; a second call does nothing."""
        self._held.close()
        for observer in self._observers:
            observer.close()
        self._observers = ()

    # --- one tick ---

    def _see(self, stick: Joystick) -> None:
        """Look at the chair's frame of now with this stick in it; the step before is judged by it."""
        client = replace(self._client, user=stick)
        self._link.now = client
        if self._fresh:
            self._seen, self._info = self._chair.begin(client)
            self._fresh = False
        else:
            step = self._chair.receive(self._link)
            self._seen, self._info = step.observation, step.info

    def _move(self, answer: Answer) -> None:
        self._chair.send(self._link, answer.sent)
        given = Joystick(*self.actions.points[answer.sent].tolist())
        now = self.world.snapshot
        snapshot = self.world.tick((Command(seat=0, tick=now.tick, joystick=given),))
        self._client = snapshot.clients[0]
        self._ended = self._client.first is not None
        if not self._ended:
            self._note_way()
        self._ticks += 1
        self._step += 1

    def _driven(self, stick: Joystick, intent: Joystick | None, sticks: F64, answer: Answer, wish: Wish) -> DrivenTick:
        client, points = self._client, self.actions.points
        events, plant = client.events, client.plant
        return DrivenTick(
            tick=self._ticks,
            time_s=self.time_s,
            episode=self._episode,
            step=self._step,
            driver=DriverKind.PERSON if intent is None else DriverKind.SIMULATED,
            stick=stick,
            intent=intent,
            sticks=sticks,
            action=answer.chosen,
            chosen=Joystick(*points[answer.chosen].tolist()),
            commanded=Joystick(*points[answer.sent].tolist()),
            unsafe=answer.unsafe,
            assisted=self.assistance.on,
            level=self.assistance.level,
            warning=answer.warning,
            intervening=answer.intervening,
            overruled=wish.overrule,
            help_asked=wish.help,
            p_WB_m=plant.p_WB_m.copy(),
            yaw_rad=plant.yaw_rad,
            roll_rad=plant.roll_rad,
            pitch_rad=plant.pitch_rad,
            speed_mps=float(plant.v_B_mps[0]),
            joystick_distance=self.actions.distance(answer.sent, (stick.x, stick.y)),
            progress_m=events.progress_m,
            arrived=events.arrived,
            gave_up=events.gave_up,
            crashed=events.crashed,
            crash_reason=events.crash_reason,
            truncated=events.truncated,
            seed=self.place.seed,
            town=self.place.town.name,
            profile=self.profile,
            policy=self.assistance.name,
        )

    def _tell(self, driven: DrivenTick) -> None:
        """Count the tick, and tell who looks on what happened in it."""
        if driven.step > self.place.handover_step:
            self.tally.add(driven, self.tick_s)
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
        for observer in self._observers:
            observer.tick(driven)

    def _say_failure(self) -> None:
        if self.assistance.failed != self._failure:
            self._failure = self.assistance.failed
            if self._failure:
                self.say(EventKind.POLICY_FAILED, self._failure)

    # --- episodes ---

    def _begin(self) -> None:
        """Look at the first frame of an episode."""
        client = self.world.snapshot.clients[0]
        self._client = client if client.first is None else client.first
        self._step, self._fresh, self._ended = 0, True, False
        self._note_way()

    def _note_way(self) -> None:
        seat = self.world.seats[0]
        self._route, self._done_m = seat.route, seat.user.route_progress_m

    def _respawn(self) -> None:
        self.world.respawn(0)
        self.say(EventKind.RESPAWN)

    def _next(self, why: str) -> None:
        self.tally.end_episode()
        self._episode += 1
        self._begin()
        self.assistance.reset(self._client.drawn)
        self.say(EventKind.EPISODE, why)

    def _intent(self) -> Joystick | None:
        return self.world.seats[0].user.intent


def way_bearing_rad(route: Route, done_m: float, plant: PlantState) -> float:
    """Where a way goes on, so far along it, from the chair's heading to the left; 0 straight ahead."""
    arc_m = min(done_m + _LOOK_AHEAD_M, float(route.arc_m[-1]))
    x_m, y_m = (float(np.interp(arc_m, route.arc_m, route.points_W_m[:, axis])) for axis in (0, 1))
    return wrap(math.atan2(y_m - float(plant.p_WB_m[1]), x_m - float(plant.p_WB_m[0])) - plant.yaw_rad)


def in_gate(stick: Joystick) -> Joystick:
    """A stick within its round gate; one that is no number is at rest.

    >>> in_gate(Joystick(0.0, -3.0)), in_gate(Joystick(math.nan, 1.0))
    (Joystick(x=0.0, y=-1.0), Joystick(x=0.0, y=0.0))
    """
    if not (math.isfinite(stick.x) and math.isfinite(stick.y)):
        return AT_REST
    return Joystick(*on_disc(stick.x, stick.y))

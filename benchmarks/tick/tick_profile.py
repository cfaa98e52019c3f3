"""The dearest functions of a tick: Python's as cProfile sees them, and Bullet's own zones inside of its step."""

from __future__ import annotations

import cProfile
import json
import pstats
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import wcsim
from benchmarks.tick.bridgeless_world import settle
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.config import RunConfig, resolve
from wcsim.core.own_folder import create_temporary_folder
from wcsim.physics.bullet import pybullet
from wcsim.towns.scenario.town import Town
from wcsim.types import SeatSpec

DEAREST = 20
_ZONE_TICKS = 4  # Bullet writes a quarter of a megabyte of zones for each chair and tick
_NATIVE = {"pybullet": "Bullet", "libsumo": "SUMO"}
_PACKAGE = Path(wcsim.__file__).parent  # a folder above it may have any name
_WORDS = re.compile(r"^<built-in method (.*)>$")
_NUMBER = re.compile(r"\d*$")

Function = tuple[str, int, str]  # file, line, name, as pstats has them


@dataclass(frozen=True, slots=True, kw_only=True)
class Dear:
    """One function, or one of Bullet's zones."""

    part: str  # the room of wcsim it belongs to, or was called from; or the simulator
    name: str
    calls: float  # a tick
    own_ms: float  # a tick, without what it calls
    share: float  # of the tick


def profiled(town: Town, config: RunConfig, chairs: int, ticks: int, seed: int) -> tuple[Dear, ...]:
    """The dearest functions of a world's tick, the dearest first; profiling makes small ones look dearer.

    One thread draws all pictures, for cProfile sees only its own.

    Raises:
        WcsimError: What the world raises.
    """
    alone = resolve(config, ("world.draw_threads=1",))
    watched = _Watched(town, alone, (SeatSpec(),) * chairs, seed)
    with watched as world:
        settle(world)
        profile = cProfile.Profile()
        profile.enable()
        _run(world, ticks)
        profile.disable()
        zones = _bullet_zones(watched)
    rows = tuple(_functions(pstats.Stats(profile), ticks))
    return _dearest(rows, zones)


class _Watched(World):
    """A world whose engine can be watched."""

    def begin_zones(self, file: str) -> int:
        """Have PyBullet note when its zones begin and end; returns the number of the log."""
        kind, bullet = pybullet.STATE_LOGGING_PROFILE_TIMINGS, self._open.engine.bullet
        return int(bullet.startStateLogging(kind, file))

    def end_zones(self, log: int) -> None:
        """Have them written."""
        self._open.engine.bullet.stopStateLogging(log)


def _dearest(rows: tuple[Dear, ...], zones: tuple[Dear, ...]) -> tuple[Dear, ...]:
    """Bullet's step as its zones, which share the time that it took without being watched."""
    steps = [row for row in rows if row.name == "pybullet.stepSimulation"]
    if steps and zones:
        scale = sum(row.own_ms for row in steps) / sum(zone.own_ms for zone in zones)
        share = sum(row.share for row in steps) / sum(row.own_ms for row in steps)
        inside = [
            Dear(part=z.part, name=z.name, calls=z.calls, own_ms=scale * z.own_ms, share=share * scale * z.own_ms)
            for z in zones
        ]
        rows = (*(row for row in rows if row not in steps), *inside)
    return tuple(sorted(rows, key=lambda row: -row.own_ms)[:DEAREST])


def _run(world: World, ticks: int) -> None:
    for _ in range(ticks):
        next(rollout(world))


def _functions(stats: pstats.Stats, ticks: int) -> Iterator[Dear]:
    """Every function of a profile; what is not wcsim's is told apart by the room that called it."""
    found: dict[tuple[str, str], list[float]] = defaultdict(lambda: [0.0, 0.0])
    entries: dict[Function, tuple[int, int, float, float, dict[Function, tuple[int, int, float, float]]]]
    entries = stats.stats  # type: ignore[attr-defined]
    for function, (_, calls, own_s, _, callers) in entries.items():
        room = _room(function)
        if room or not callers:
            _add(found, room or "Python", function, calls, own_s)
            continue
        for caller, (_, their_calls, their_s, _) in callers.items():
            _add(found, _room(caller) or "Python", function, their_calls, their_s)
    whole_s = sum(own_s for _, own_s in found.values())
    for (part, name), (count, own_s) in found.items():
        yield Dear(part=part, name=name, calls=count / ticks, own_ms=1e3 * own_s / ticks, share=own_s / whole_s)


def _add(found: dict[tuple[str, str], list[float]], part: str, function: Function, calls: float, own_s: float) -> None:
    row = found[part, _name(function)]
    row[0] += calls
    row[1] += own_s


def _room(function: Function) -> str:
    """The room of wcsim that a function is in, or the simulator; empty for all others."""
    file, name = Path(function[0]), function[2]
    if file.is_relative_to(_PACKAGE):
        return str(file.parent.relative_to(_PACKAGE)) if file.parent != _PACKAGE else _PACKAGE.name
    parts = [part for library, part in _NATIVE.items() if library in name or library == file.parent.name]
    return parts[0] if parts else ""


def _name(function: Function) -> str:
    file, line, name = function
    if not line:
        return _WORDS.sub(r"\1", name).replace("libsumo._libsumo.", "libsumo.")
    return f"{Path(file).name}:{line} {name}"


def _bullet_zones(world: _Watched) -> tuple[Dear, ...]:
    """What PyBullet's own profiler says of the steps of a few ticks, without the rest of what it does."""
    with create_temporary_folder() as folder:
        log = world.begin_zones(str(folder / "zones"))
        _run(world, _ZONE_TICKS)
        world.end_zones(log)
        written = sorted(folder.glob("zones*"))
        events = json.loads(written[0].read_text())["traceEvents"] if written else []
    return tuple(own_times(events, _ZONE_TICKS))


def own_times(events: list[dict[str, object]], ticks: int) -> Iterator[Dear]:
    """The time in each zone without that in the zones inside of it, for the zones within Bullet's step.

    Each entry of a zone has a number of its own behind its name; the file is not in the order of time.
    """
    begun: dict[object, float] = {}
    spans = []
    for event in events:
        name, at_us = str(event["name"]), float(str(event["ts"]))
        if event["ph"] == "B":
            begun[name] = at_us
        elif name in begun:
            spans.append((begun.pop(name), at_us, _NUMBER.sub("", name)))
    calls: dict[str, int] = defaultdict(int)
    own_us: dict[str, float] = defaultdict(float)
    open_: list[tuple[float, str]] = []  # ends and names of the zones around
    for start_us, end_us, name in sorted(spans, key=lambda span: (span[0], -span[1])):
        while open_ and start_us >= open_[-1][0]:
            open_.pop()
        if open_ or name == "internalSingleStepSimulation":
            calls[name] += 1
            own_us[name] += end_us - start_us
            if open_:
                own_us[open_[-1][1]] -= end_us - start_us
            open_.append((end_us, name))
    for name, us in own_us.items():
        yield Dear(part="Bullet", name=name, calls=calls[name] / ticks, own_ms=1e-3 * us / ticks, share=0.0)

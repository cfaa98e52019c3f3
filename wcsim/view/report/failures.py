"""The failures of a test, worst first: what happened, by whose fault, its command, pictures."""

import math
import shlex
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from wcsim.agents.evaluation.suite.drive import Piece
from wcsim.agents.evaluation.suite.playback import Played, PlayedStep, play, require_same
from wcsim.agents.evaluation.suite.records import (
    CRASHED,
    FINISHED,
    GAVE_UP,
    NOT_REACHED,
    ON_THE_WAY,
    TIMED_OUT,
    EpisodeRecord,
)
from wcsim.agents.evaluation.suite.result_files import LIST, TestResult
from wcsim.agents.evaluation.suite.run import SuiteOrder, piece_of, town_addresses
from wcsim.agents.opening.list_file import open_suite
from wcsim.agents.opening.named_policy import resolve_policy_config
from wcsim.agents.policy_api import STATE_SENSE, UNAIDED
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.bridge.world import World
from wcsim.core.processes import run_in_process_pool
from wcsim.core.reading import is_file, pluralize
from wcsim.errors import ConfigError, WcsimError
from wcsim.types import U8, ActorKind
from wcsim.view.filming import around_picture, near, seen_picture, sticks
from wcsim.view.map import MapView
from wcsim.view.street_pictures import StreetPictures, played_moment

_SOMEBODY: Final = frozenset(kind.value for kind in ActorKind)
_FAULTS: Final = {"own": "own fault", "other": "other's fault"}
_SHORT_S: Final = 0.3  # a last leg of the path below this says nothing of the speed
_PICTURES: Final = 3
_SIZE_PX: Final = (480, 270)
_LAST_S: Final = 2.0
_MAP_PX, _MAP_SPAN_M = 360, 24.0
_TRAIL_S: Final = 10.0
_NOT_NAMED: Final = "it is code of your own, which runs when you name it: --own module:Class"

Key = tuple[str, int, int]  # policy, block, seat


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedEpisode:
    """An episode that went wrong."""

    policy: str
    record: EpisodeRecord
    reason: str
    whose: str  # own, other, or that the policy did not drive yet
    severity: int  # 0 is worst
    speed_mps: float | None  # in the last second
    unaided: str  # what became of the user alone
    command: str

    @property
    def key(self) -> tuple[int, int]:
        """Block and seat."""
        return self.record.block, self.record.seat


def failures_of(result: TestResult, folder: Path) -> tuple[FailedEpisode, ...]:
    """All failures of all policies, worst first."""
    alone = {(e.block, e.seat): e for e in result.episodes.get(UNAIDED, ())}
    found = []
    for policy, episodes in result.episodes.items():
        for record in episodes:
            reason, whose, severity = _judged(record)
            if not reason:
                continue
            twin = alone.get((record.block, record.seat))
            # The command that drives it again, for the folder of the test, from which names count.
            words = [
                "wcsim",
                "test",
                policy,
                "--suite",
                result.list_name,
                "--play",
                f"{record.block}.{record.seat}",
            ]
            words += ["--out", result.out or folder.resolve().name]
            words += ["--preset", result.preset] if result.preset != "quick" else []
            words += ["--network", result.network] if result.network else []
            words += [word for setting in result.changed for word in ("--set", setting)]
            found.append(
                FailedEpisode(
                    policy=policy,
                    record=record,
                    reason=reason,
                    whose=whose,
                    severity=severity,
                    speed_mps=_last_speed_mps(record),
                    unaided="not driven" if twin is None else fate(twin),
                    command=shlex.join(words),
                )
            )
    return tuple(
        sorted(found, key=lambda one: (one.severity, -(one.speed_mps or 0.0), one.policy, one.key))
    )


def _judged(record: EpisodeRecord) -> tuple[str, str, int]:
    """Reason, whose fault and severity of an episode; no reason where it went well."""
    if record.status == NOT_REACHED:
        return "not reached", "before the policy", 6
    if record.status == CRASHED:
        own = record.fault == "own"
        return record.reason, record.fault, (0 if record.partner in _SOMEBODY else 1) if own else 2
    if not record.held:
        return record.status.replace("_", " "), "policy", 3
    if record.red_entries:
        return "red light", "own", 4
    if record.status == GAVE_UP or (record.status == TIMED_OUT and record.part in ON_THE_WAY):
        return record.status.replace("_", " "), "", 5
    return "", "", 7


def fate(record: EpisodeRecord) -> str:
    """What became of an episode, in words."""
    if record.status == CRASHED:
        with_ = f" with {record.partner}" if record.partner else ""
        fault = _FAULTS.get(record.fault, record.fault)
        return f"{record.reason}{with_} ({fault}) after {record.time_s:.0f} s"
    said = "no crash" if record.status == TIMED_OUT and record.part not in ON_THE_WAY else ""
    said = said or ("arrived" if record.status == FINISHED else record.status.replace("_", " "))
    return f"{said}, {pluralize(record.red_entries, 'red light')}" if record.red_entries else said


def _last_speed_mps(record: EpisodeRecord) -> float | None:
    """Mean speed in about the last second; None where there is no path.

    A path has the place after each whole second, and the last (`kpi.sum_kpi_steps`): 13 at 12.3 s.
    """
    path_m, time_s = record.path_m, record.time_s
    if len(path_m) < 2 or time_s <= 0.0:
        return None
    leg_s = time_s - (len(path_m) - 1)
    legs = 1 if leg_s >= _SHORT_S or len(path_m) == 2 else 2
    spent_s = leg_s + (legs - 1)
    way_m = sum(math.dist(path_m[-at], path_m[-at - 1]) for at in range(1, legs + 1))
    return way_m / spent_s if spent_s > 0.0 else None


def where_typed(result: TestResult) -> str:
    """Where the commands of a page run, in words."""
    return "in which you ran the test" if result.out else "that contains the folder of the test"


class _SeenMoment(NamedTuple):
    """A moment before the end, from behind the chair and as the network saw it."""

    before_s: float
    speed_mps: float
    asked: str
    given: str
    behind_jpg: bytes
    seen_png: bytes  # empty where the policy gets no pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class Illustration:
    """Pictures of the end of an episode, or why there are none."""

    seen: tuple[_SeenMoment, ...] = ()  # oldest first
    street_png: bytes = b""  # from above at the end, with the way of the last seconds
    near: Sequence[str] = ()  # who was there, nearest first
    missing: str = ""


def chosen(failures: Sequence[FailedEpisode], each: int) -> list[FailedEpisode]:
    """The worst failures of each policy that were driven at all; `failures` are sorted."""
    taken: dict[str, int] = {}
    found = []
    for failure in failures:
        if failure.record.steps and taken.get(failure.policy, 0) < each:
            taken[failure.policy] = taken.get(failure.policy, 0) + 1
            found.append(failure)
    return found


def illustrated(
    order: SuiteOrder,
    failures: Iterable[FailedEpisode],
    own: Collection[str],
    jobs: int,
    done: Callable[[int, int], object],
) -> dict[Key, Illustration]:
    """Pictures of these failures. What cannot be driven as it was says so.

    Args:
        order: How the test was driven, see `order_of`.
        failures: Those to show.
        own: The user's own policies and networks, module:Class, as named to this command: a folder
            that somebody else made does not decide which code runs here.
        jobs: Processes.
        done: Called with the blocks that are done, and how many there are.
    """
    towns = town_addresses(order)
    blocks: dict[tuple[str, int], list[FailedEpisode]] = {}
    found_all: dict[Key, Illustration] = {}
    for failure in failures:
        if parse_policy_name(failure.policy).kind == "class" and failure.policy not in own:
            found_all[failure.policy, *failure.key] = Illustration(missing=_NOT_NAMED)
            continue
        blocks.setdefault((failure.policy, failure.key[0]), []).append(failure)
    pieces = [
        (piece_of(order, block, policy, towns, judged=False), [failure.record for failure in found])
        for (policy, block), found in blocks.items()
    ]
    wheres = list(blocks)
    for number, (place, pictures) in enumerate(
        run_in_process_pool(_illustrate, pieces, jobs), start=1
    ):
        found_all |= {(*wheres[place], seat): picture for seat, picture in pictures.items()}
        done(number, len(pieces))
    return found_all


def order_of(result: TestResult, folder: Path, own: Collection[str]) -> SuiteOrder:
    """How a result was driven; `own` as in `illustrated`.

    Raises:
        ConfigError: Its list is not here, or another one.
    """
    drawn = folder / LIST  # it goes wherever its folder goes
    moved = Path(result.list_name).name == LIST and is_file(drawn)
    suite = open_suite(str(drawn) if moved else result.list_name)
    if suite.sha256 != result.list_sha256:
        raise ConfigError(
            f"list {result.list_name} has the hash {suite.sha256[:12]}; "
            f"expected {result.list_sha256[:12]}, that of the test: "
            "run the test again, or use the version of wcsim that made it"
        )
    network = result.network if result.network in own else ""
    return SuiteOrder(
        suite=suite,
        out=folder,
        preset=result.preset,
        settings=result.changed,
        network=network,
        forks=0,
    )


def _illustrate(wanted: tuple[Piece, Iterable[EpisodeRecord]]) -> dict[int, Illustration]:
    """The pictures of a block, by seat, whose episodes were so; runs in a process of its own."""
    piece, records = wanted
    kept = {record.seat: record for record in records}
    try:
        config = resolve_policy_config(piece.policy, piece.preset, piece.settings, in_list=True)
        tick_s = config.world.tick_s

        def draw(world: World, steps: Sequence[PlayedStep]) -> Illustration:
            pictures, moments = StreetPictures(world.street), []
            above = around_picture(
                MapView(world.street.mesh, _MAP_PX, _MAP_SPAN_M), steps[-1], steps
            )
            last = len(steps) - 1
            places = np.rint(np.linspace(max(0, last - _LAST_S / tick_s), last, _PICTURES)).astype(
                int
            )
            for place in dict.fromkeys(places.tolist()):
                step, before_s = steps[place], round((last - place) * tick_s, 3)
                behind = _encoded(".jpg", pictures.behind(played_moment(step), *_SIZE_PX).picture)
                seen = (
                    b""
                    if STATE_SENSE in step.seen
                    else _encoded(".png", seen_picture(step.seen, config))
                )
                moments.append(_SeenMoment(before_s, step.speed_mps, *sticks(step), behind, seen))
            return Illustration(
                seen=tuple(moments), street_png=_encoded(".png", above), near=near(steps[-1])[:4]
            )

        found = play(piece, tuple(kept), round(_TRAIL_S / tick_s), draw)
    except WcsimError as error:
        return {seat: Illustration(missing=str(error)) for seat in kept}
    return {item.record.seat: _checked(item, kept[item.record.seat]) for item in found}


def _checked(played: Played, kept: EpisodeRecord) -> Illustration:
    try:
        require_same(played.record, kept)
    except ConfigError as error:
        return Illustration(missing=str(error))
    return played.drawn or Illustration(missing="nothing was driven")


def _encoded(form: str, image: U8) -> bytes:
    _, data = cv2.imencode(form, np.ascontiguousarray(image[..., ::-1]))
    return bytes(data.tobytes())

"""Pictures of the worst moments: their episodes are driven once more, by several processes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from wcsim.agents.evaluation.suite.list_file import open_suite
from wcsim.agents.evaluation.suite.list_rules import settings_in_list
from wcsim.agents.evaluation.suite.named_policy import is_own_class
from wcsim.agents.evaluation.suite.playback import Played, PlayedStep, play, require_same
from wcsim.agents.evaluation.suite.result_files import KeptResult
from wcsim.agents.evaluation.suite.run import Piece, SuiteOrder, piece_of, town_addresses
from wcsim.bridge.world import World
from wcsim.errors import ConfigError, WcsimError
from wcsim.types import U8
from wcsim.view.driven_film import around_picture, seen_picture, sticks
from wcsim.view.map import MapView
from wcsim.view.report.failures import FailedEpisode

PICTURES: Final = 8
LAST_S: Final = 2.0
_MAP_PX, _MAP_SPAN_M = 360, 24.0
_TRAIL_S: Final = 10.0
_NOT_NAMED: Final = "it is code of your own, which runs when you name it: --own module:Class"

Key = tuple[str, int, int]  # policy, block, seat


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenMoment:
    """What the network saw at a moment before the end."""

    before_s: float
    speed_mps: float
    asked: str
    given: str
    png: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Illustration:
    """Pictures of the end of an episode, or why there are none."""

    seen: tuple[SeenMoment, ...] = ()  # oldest first
    street_png: bytes = b""  # from above at the end, with the way of the last seconds
    near: tuple[str, ...] = ()  # who was there, nearest first
    missing: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Order:
    """A block to be driven by a process."""

    piece: Piece
    kept: tuple[tuple[int, Mapping[str, Any]], ...]  # seat, and its record as it was kept


def chosen(failures: Sequence[FailedEpisode], each: int) -> list[FailedEpisode]:
    """The worst failures of each policy that were driven at all; `failures` are sorted."""
    taken: dict[str, int] = {}
    found = []
    for failure in failures:
        if failure.episode.record.steps and taken.get(failure.policy, 0) < each:
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
        own: Policies and networks of the user's own, module:Class, as they were named to this command: a folder that
            somebody else made does not decide which code runs here.
        jobs: Processes.
        done: Called with the blocks that are done, and how many there are.
    """
    towns = town_addresses(order)
    blocks: dict[tuple[str, int], list[FailedEpisode]] = {}
    found_all: dict[Key, Illustration] = {}
    for failure in failures:
        if is_own_class(failure.policy) and failure.policy not in own:
            found_all[failure.policy, *failure.key] = Illustration(missing=_NOT_NAMED)
            continue
        blocks.setdefault((failure.policy, failure.key[0]), []).append(failure)
    orders = [
        _Order(
            piece=piece_of(order, block, policy, towns, judged=False),
            kept=tuple((failure.key[1], dict(failure.episode.said)) for failure in found),
        )
        for (policy, block), found in blocks.items()
    ]
    for number, (each, pictures) in enumerate(_driven(orders, jobs), start=1):
        found_all |= {(each.piece.policy, each.piece.index, seat): picture for seat, picture in pictures}
        done(number, len(orders))
    return found_all


def order_of(result: KeptResult, folder: Path, own: Collection[str]) -> SuiteOrder:
    """How a result was driven; `own` as in `illustrated`.

    Raises:
        ConfigError: Its list is not here, or another one.
    """
    suite = open_suite(result.list_name)
    if suite.sha256 != result.list_sha256:
        raise ConfigError(
            f"list {result.list_name} has the hash {suite.sha256[:12]}; expected {result.list_sha256[:12]}, that of "
            "the test: run the test again, or use the version of wcsim that made it"
        )
    network = result.network if result.network in own else ""
    return SuiteOrder(suite=suite, out=folder, preset=result.preset, settings=result.changed, network=network, forks=0)


def _driven(orders: Sequence[_Order], jobs: int) -> Iterator[tuple[_Order, list[tuple[int, Illustration]]]]:
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(_illustrate, order): order for order in orders}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _illustrate(order: _Order) -> list[tuple[int, Illustration]]:
    """The pictures of a block, by seat; runs in a process of its own."""
    kept = dict(order.kept)
    try:
        config = settings_in_list(order.piece.policy, order.piece.preset, order.piece.settings)
        tick_s = config.world.tick_s

        def draw(world: World, steps: Sequence[PlayedStep]) -> Illustration:
            street = around_picture(MapView(world.street.mesh, _MAP_PX, _MAP_SPAN_M), steps[-1], steps)
            last = len(steps) - 1
            places = np.rint(np.linspace(max(0, last - LAST_S / tick_s), last, PICTURES)).astype(int)
            seen = tuple(
                SeenMoment(
                    before_s=round((last - place) * tick_s, 3),
                    speed_mps=steps[place].speed_mps,
                    asked=sticks(steps[place])[0],
                    given=sticks(steps[place])[1],
                    png=_png(seen_picture(steps[place].seen, config)),
                )
                for place in dict.fromkeys(places.tolist())
            )
            return Illustration(seen=seen, street_png=_png(street), near=_near(steps[-1]))

        found = play(order.piece, tuple(kept), round(_TRAIL_S / tick_s), draw)
    except WcsimError as error:
        return [(seat, Illustration(missing=str(error))) for seat in kept]
    return [(item.record.seat, _checked(item, kept[item.record.seat])) for item in found]


def _checked(played: Played, kept: Mapping[str, Any]) -> Illustration:
    try:
        require_same(played.record, kept)
    except ConfigError as error:
        return Illustration(missing=str(error))
    return played.drawn or Illustration(missing="nothing was driven")


def _near(step: PlayedStep) -> tuple[str, ...]:
    gaps = sorted((float(np.hypot(*(actor.p_W_m - step.p_W_m)[:2])), actor.kind.value) for actor in step.actors)
    return tuple(f"{kind} {gap_m:.1f} m" for gap_m, kind in gaps[:4])


def _png(image: U8) -> bytes:
    _, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    return bytes(data.tobytes())

"""A film of two drives of one episode from behind the chair: the user alone and with help."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from wcsim.agents.evaluation.suite.playback import PlayedStep, play, require_same
from wcsim.agents.evaluation.suite.records import CRASHED, FINISHED
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.agents.evaluation.suite.run import SuiteOrder, piece_of, town_addresses
from wcsim.agents.opening.named_policy import resolve_policy_config
from wcsim.agents.policy_api import UNAIDED
from wcsim.bridge.world import World
from wcsim.types import U8
from wcsim.view.filming import with_sticks
from wcsim.view.pictures import captioned, open_video, side_by_side
from wcsim.view.report.failures import fate
from wcsim.view.street_pictures import StreetPictures, played_moment

_SIZE_PX: Final = (560, 420)
_BEFORE_S, _AFTER_S, _HELD_S = 8.0, 3.0, 2.0
_ALL_STEPS: Final = 1_000_000  # the most that an episode can have


def telling_episode(result: TestResult, policy: str) -> tuple[int, int]:
    """Block and seat of the first episode where the user crashes alone, but ends well with help.

    Else it is the first where the policy spares the crash, else the first with one, else the
    first.
    """
    alone, helped = result.episodes[UNAIDED], result.episodes[policy]
    crashed = [record.status == CRASHED for record in alone]
    spared = [was and record.status != CRASHED for was, record in zip(crashed, helped, strict=True)]
    finished = [
        was and record.status == FINISHED for was, record in zip(crashed, helped, strict=True)
    ]
    place = next((found.index(True) for found in (finished, spared, crashed) if any(found)), 0)
    return alone[place].block, alone[place].seat


def film_twins(
    path: Path,
    order: SuiteOrder,
    result: TestResult,
    policy: str,
    key: tuple[int, int],
    done: Callable[[float, str], object],
) -> tuple[str, list[U8]]:
    """Film the end of an episode of the user alone, beside the same seconds with a policy.

    Args:
        path: A .webm file.
        order: How the test was driven.
        result: Of that test; both drives must come out as they did there.
        policy: Who helps.
        key: Block and seat of the episode.
        done: Told which share is done, and what comes now.

    Returns:
        What became of both drives in words, and the frames (H, 2 W, 3).

    Raises:
        ConfigError: A drive went another way, or the film cannot be written.
    """
    towns, told, end = town_addresses(order), [], 0  # end: the step at which the user alone ends
    halves: list[list[U8]] = []
    tick_s = resolve_policy_config(
        UNAIDED, order.preset, (*order.suite.file.settings, *order.settings), in_list=True
    ).world.tick_s
    for name, title in ((UNAIDED, "alone"), (policy, "with help")):
        done(0.5 * len(halves), title)
        piece = piece_of(order, key[0], name, towns, judged=False)
        (played,) = play(piece, (key[1],), _ALL_STEPS, partial(_pictures, end, tick_s))
        (saved,) = (
            record for record in result.episodes[name] if (record.block, record.seat) == key
        )
        require_same(played.record, saved)
        told.append(f"{title}: {fate(played.record)}")
        if played.steps:  # a network that fails at once has no picture
            *pictures, last = played.drawn
            halves.append(
                [*(captioned(picture, title) for picture in pictures), captioned(last, told[-1])]
            )
            end = end or played.steps[-1].step

    # A drive that has ended stands still until the other one has, too.
    frames, many = [], max(map(len, halves)) + round(_HELD_S / tick_s)
    with open_video(path, tick_s) as write:
        for number in range(many):
            frames.append(side_by_side(*(half[min(number, len(half) - 1)] for half in halves)))
            write(frames[-1])
    return "; ".join(told), frames


def _pictures(end: int, tick_s: float, world: World, steps: Sequence[PlayedStep]) -> list[U8]:
    """Pictures of one drive around a step, 0 for its last, and the picture of its last."""
    last, street, found = end or steps[-1].step, StreetPictures(world.street), []
    first, until = last - round(_BEFORE_S / tick_s), last + round(_AFTER_S / tick_s)
    for step in steps:
        if first < step.step <= until or step is steps[-1]:
            picture = street.behind(played_moment(step), *_SIZE_PX).picture
            with_sticks(picture, step.requested, step.given, warning=False)
            found.append(picture)
    return found

"""`wcsim test POLICY --suite LIST --play BLOCK.SEAT`: the end of one episode, driven again and filmed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from wcsim.agents.opening.named_policy import config_for
from wcsim.cli.shared.consoles import stdout_console
from wcsim.core.reading import escaped, is_file
from wcsim.errors import ConfigError

if TYPE_CHECKING:  # loads the simulators, which --help must not
    from wcsim.agents.evaluation.suite.playback import Played, PlayedStep
    from wcsim.agents.evaluation.suite.run import SuiteOrder

_PLACE = re.compile(r"([0-9]{1,6})\.([0-9]{1,3})")
_LAST_S = 10.0
_TOLD_EVERY_S = 0.5
_MAP_PX, _MAP_SPAN_M = 480, 30.0


def _place_of_play(text: str, blocks: int) -> tuple[int, int]:
    """Block and seat. Raises ConfigError.

    >>> _place_of_play("12.3", 20)
    (12, 3)
    """
    found = _PLACE.fullmatch(text)
    if found is None or int(found[1]) >= blocks:
        most = blocks - 1
        raise ConfigError(f"--play {escaped(text)!r}: expected BLOCK.SEAT, such as 0.1, with a block from 0 to {most}")
    return int(found[1]), int(found[2])


def play_episode(order: SuiteOrder, policies: Sequence[str], place: str) -> int:
    """Drive one episode again, film its last 10 s, say what happened.

    An episode that `order.out` holds must come out as it did there.

    Raises:
        ConfigError: The place is none, the policies are not one, or the episode went another way.
        PolicyError: The policy cannot be used.
    """
    index, seat = _place_of_play(place, len(order.suite.file.blocks))
    if len(policies) != 1:
        raise ConfigError(f"--play takes one policy, got {len(policies)}: name the policy whose episode to drive")
    from wcsim.agents.evaluation.suite.playback import play, require_same
    from wcsim.agents.evaluation.suite.result_files import EPISODES, read_episodes
    from wcsim.agents.evaluation.suite.run import piece_of, require_usable, town_addresses
    from wcsim.view.filming import film_steps
    from wcsim.view.map import MapView

    require_usable(order, policies)
    piece = piece_of(order, index, policies[0], town_addresses(order), judged=False)
    config = config_for(piece.policy, piece.preset, piece.settings, in_list=True)
    kept = read_episodes(order.out).get(policies[0], ()) if is_file(order.out / EPISODES) else ()
    film = order.out / "play" / f"{re.sub(r'[^A-Za-z0-9_.-]+', '-', policies[0])}-{index}.{seat}.webm"
    film.parent.mkdir(parents=True, exist_ok=True)
    (played,) = play(
        piece,
        (seat,),
        round(_LAST_S / config.world.tick_s),
        lambda world, steps: film_steps(film, MapView(world.street.mesh, _MAP_PX, _MAP_SPAN_M), steps, config),
    )
    console = stdout_console()
    _tell(console, played, config.world.tick_s)
    twin = next((item for item in kept if (item.block, item.seat) == (index, seat)), None)
    if twin is not None:
        require_same(played.record, twin)
    compared = "the same as the saved one" if twin is not None else f"not compared: none is saved in {order.out}"
    console.print(f"{film if played.steps else 'no video: nothing was driven'}; the episode is {compared}", style="dim")
    return 0


def _tell(console: Console, played: Played, tick_s: float) -> None:
    record = played.record
    how = " ".join(word for word in (record.status, record.reason, record.fault, record.crash) if word)
    table = Table(title=escape(f"{record.part} {record.block}.{record.seat}, {record.town}, {record.profile}: {how}"))
    for heading in ("s", "m/s", "user", "driven", "nearest"):
        table.add_column(heading, justify="right", no_wrap=True)
    every = max(1, round(_TOLD_EVERY_S / tick_s))
    for number, step in reversed(list(enumerate(reversed(played.steps)))):
        if number % every == 0:
            table.add_row(*_row_of(step, number * tick_s))
    console.print(table)


def _row_of(step: PlayedStep, before_s: float) -> tuple[str, ...]:
    from wcsim.view.filming import sticks

    gaps = sorted((float(np.hypot(*(actor.p_W_m - step.p_W_m)[:2])), actor.kind.value) for actor in step.actors)
    nearest = f"{gaps[0][1]} {gaps[0][0]:.1f} m" if gaps else "-"
    return f"-{before_s:.1f}", f"{step.speed_mps:.2f}", *sticks(step), nearest

"""`wcsim export`: a trained policy for machines that have no wcsim."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from wcsim.agents.policy_api import Observation
from wcsim.agents.runs.policy_file import is_danger
from wcsim.agents.runs.run_folder import config_of, policy_path, split_level
from wcsim.cli.shared.common import OutFile, check_folder, parse, write_json
from wcsim.cli.shared.exit_codes import Exit
from wcsim.config import RunConfig
from wcsim.core.reading import shown
from wcsim.errors import ConfigError, PolicyError


@dataclass
class Options:
    """Write a policy as an ONNX model with its state, its rule, its meaning and reference steps."""

    policy: Annotated[str, tyro.conf.Positional]
    """A run of a danger network, its policy folder, or shipped; RUN@0.2 sets the assistance level."""
    onnx: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder to make."""
    town: str = "helsinki"
    """Where the reference steps are driven, by turns with the user's stick and with one that is pushed: a town's name,
    its folder, or anybody's .sumocfg."""
    ride: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """A recorded drive, or the journal of a run, whose first episode gives the reference steps and actions instead."""
    seat: int = 0
    """Of a journal."""
    steps: int = 200
    """Reference steps, at the most."""
    delay_ticks: int | None = None
    """From a command to the chair that obeys it; by default the recording's, or as in training."""
    force: bool = False
    """Export it although a decision takes longer than a tick less what segmenting the picture takes."""
    json: OutFile = None
    """Write what was measured to this file."""


def run(words: list[str]) -> int:
    """Export, and say what was measured."""
    options = parse(Options, words, "export")
    if options.onnx is None:
        raise ConfigError("nothing to write to; expected --onnx FOLDER")
    if not 2 <= options.steps <= 100_000:
        raise ConfigError(f"--steps {options.steps}; expected 2 to 100000")
    check_folder("--onnx", options.onnx)
    if options.ride is not None and not options.ride.exists():
        raise ConfigError(
            f"--ride {shown(options.ride)}: is not there; expected a recorded drive, a journal, or the folder of a run"
        )
    path = policy_path(options.policy)
    if not is_danger(path):
        raise PolicyError(f"{options.policy} gives values for actions; expected a danger network (learn.head=danger)")
    from wcsim.agents.danger.export.onnx_export import export_danger  # torch is loaded here
    from wcsim.agents.networks.costs import LIMIT_MS, RESERVE_MS

    config, ride, actions = _ride(options)
    limit_ms = math.inf if options.force else LIMIT_MS - RESERVE_MS
    facts = export_danger(path, options.onnx, config, ride, limit_ms, split_level(options.policy)[1], actions)
    small, cost, slow = facts.int8_cost, facts.cost, facts.quota_share
    borders = f" ({facts.border_off:.1g} in {facts.border_steps} of the steps, at borders of cells)"
    borders = borders if facts.border_steps else ""
    within = "within" if cost.p99_ms <= facts.bar_ms else "over"
    print(
        f"exported to {options.onnx}: {facts.bytes / 1e6:.1f} MB, dangers off by {facts.most_off:.1g} at most"
        f"{borders}\n"
        f"{facts.same_actions:.1%} of {facts.steps} actions the same ({facts.same_as_wcsim:.1%} as in wcsim), "
        f"{facts.interventions} of them not the user's own; {facts.warnings} steps with a warning\n"
        f"one thread: {cost.p50_ms:.2f} ms a step (p99 {cost.p99_ms:.2f}, {within} the bar of {facts.bar_ms:g} ms; "
        f"{cost.cpu_p50_ms:.2f} ms of the processor), {cost.peak_mb:.0f} MB of memory\n"
        f"{slow:.0%} of a core, by {facts.quota_by} every {1000.0 * facts.quota_period_s:g} ms: "
        f"{cost.quota_p50_ms:.2f} ms (p99 {cost.quota_p99_ms:.2f})\n"
        f"in 8 bits: {facts.int8_bytes / 1e6:.1f} MB, {small.p50_ms:.2f} ms (p99 {small.p99_ms:.2f}), dangers off by "
        f"{facts.int8_most_off:.2g}, {facts.int8_same_actions:.1%} the same"
    )
    if options.json is not None:
        write_json(options.json, asdict(facts))
    return Exit.DONE


def _ride(options: Options) -> tuple[RunConfig, list[Observation], tuple[int, ...] | None]:
    """The settings, the reference steps, and the actions of a recording."""
    from wcsim.agents.evaluation.suite.named_policy import open_named
    from wcsim.agents.rounds.recorded_ride import recorded_ride
    from wcsim.agents.rounds.reference_ride import reference_ride

    held = None if options.ride is None else recorded_ride(options.ride, options.steps, options.seat)
    delay = options.delay_ticks if held is None or options.delay_ticks is not None else held.delay_ticks
    own = () if delay is None else (f"world.action_delay_ticks={delay}",)
    config = config_of(options.policy, "laptop", own)
    if held is not None:
        return config, list(held.seen), held.actions
    policy = open_named(options.policy, config, 0)
    return config, reference_ride(options.town, config, options.steps, policy), None

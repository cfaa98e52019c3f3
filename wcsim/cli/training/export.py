"""`wcsim export`: a trained policy for machines that have no wcsim."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from tyro.conf import Positional, arg

from wcsim.agents.export.export_folder import require_replaceable_folder
from wcsim.agents.opening.learner_registry import learner_from_policy
from wcsim.agents.opening.named_policy import (
    list_policy_overrides,
    open_named_policy,
    resolve_policy_config,
)
from wcsim.agents.policy_api import BASELINES, UPPER_BOUNDS, Observation, Policy
from wcsim.agents.runs.policy_file import SHIPPED, parse_policy_name
from wcsim.agents.runs.run_folder import policy_folder_from_name
from wcsim.cli.shared.common import (
    Bounds,
    InFile,
    OutFile,
    parse_options,
    require_writable_folder,
    write_json,
)
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.shared.run_config import require_usable_policy
from wcsim.config import RunConfig, resolve
from wcsim.core.reading import escape, is_folder, pluralize
from wcsim.errors import ConfigError, PolicyError, meant

if TYPE_CHECKING:
    from wcsim.agents.export.onnx_export import ExportMeasurements

# Of a recording's actions: with fewer it was hardly this policy that chose them.
_SAME_POLICY: Final = 0.95


@dataclass
class _Options:
    """Export a trained network as an ONNX model, with a reference ride to check it."""

    policy: Annotated[str, Positional]
    """Run, RUN:phase1, policy folder, or shipped; RUN@0.2 sets the threshold of a danger network."""  # noqa: E501 - help text
    onnx: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Output folder; an earlier export in it is replaced."""
    town: str = "helsinki"
    """Town of the reference ride: a town's name, its folder, or a .sumocfg file."""
    ride: InFile = None
    """Recorded drive, or journal of a run, to use as the reference ride instead. Its first episode counts. The command
    reports how many of the policy's actions match the recorded ones."""  # noqa: E501 - help text
    seat: int = 0
    """Seat of the journal in --ride."""
    steps: Annotated[int, Bounds(2, 100_000)] = 200
    """Maximum length of the reference ride."""
    delay_ticks: int | None = None
    """Ticks from a command to the chair's motion; by default as in the recording or in training."""
    network: str = ""
    """Your own network as module:Class, for a run that was trained with it."""
    force: bool = False
    """Export even if a decision is too slow: a tick less the time for segmenting the picture."""
    json: OutFile = None
    """Write the measurements to this file."""


def run(words: list[str]) -> int:
    """Export, and say what was measured."""
    options = parse_options(_Options, words, "export")
    if options.onnx is None:
        raise ConfigError("nothing to write to; expected --onnx FOLDER")
    require_writable_folder("--onnx", options.onnx)
    require_replaceable_folder("--onnx", options.onnx)
    if options.ride is not None and not options.ride.exists():
        raise ConfigError(
            f"--ride {escape(options.ride)}: not found; expected a recorded drive, a journal, or "
            "the folder of a run"
        )
    path = _network(options.policy)
    require_usable_policy(options.policy, options.network, alone=True, bare_for="an export")
    from wcsim.agents.export.onnx_export import export_policy  # torch is loaded here
    from wcsim.agents.networks.costs import LIMIT_MS, RESERVE_MS
    from wcsim.agents.networks.onnx_form import require_onnx_installed

    require_onnx_installed()
    learner = learner_from_policy(path)
    own = resolve_policy_config(options.policy, learner.export_preset)
    policy = open_named_policy(
        options.policy, resolve(own, _delay(options.delay_ticks)), 0, options.network or None
    )
    own = resolve(own, list_policy_overrides(own, policy))
    delay, seen, actions, by = _ride(options, own, policy)
    bar_ms = LIMIT_MS - RESERVE_MS
    config, level = resolve(own, delay), parse_policy_name(options.policy).level
    facts = export_policy(
        *learner.open_graph(path, config, level, options.network or None),
        options.onnx,
        config,
        seen,
        math.inf if options.force else bar_ms,
        actions,
    )
    print(f"exported to {options.onnx}: {_compared(facts)}")
    if facts.same_as_recorded is not None:
        print(_beside_recording(facts.same_as_recorded, by, options.policy))
    cost, slow = facts.cost, facts.quota_share
    within = "within" if cost.p99_ms <= bar_ms else "over"
    print(
        f"one thread: {cost.p50_ms:.2f} ms per step (p99 {cost.p99_ms:.2f}, {within} the limit of "
        f"{bar_ms:g} "
        f"ms; {cost.cpu_p50_ms:.2f} ms CPU time), {cost.peak_mb:.0f} MB of memory\n"
        f"{slow:.0%} of a core, by {facts.quota_by} every {1000.0 * facts.quota_period_s:g} ms: "
        f"{cost.quota_p50_ms:.2f} ms (p99 {cost.quota_p99_ms:.2f})"
    )
    write_json(options.json, asdict(facts))
    return ExitCode.DONE


def _network(name: str) -> Path:
    """The folder of a network that may be exported.

    Raises:
        PolicyError: There is no such policy, or it drives without a network.
    """
    named = parse_policy_name(name)
    if not named.is_network:
        raise PolicyError(
            f"{escape(name)} has no network that can be exported; expected a run that `wcsim "
            f"train` made, RUN:phase1, a policy folder, or {SHIPPED}"
        )
    if named.kind != "shipped" and not is_folder(named.folder):
        raise PolicyError(
            f"{escape(named.place)} is not a run: there is no such folder; expected one that "
            f"`wcsim train` made, a policy folder, or {SHIPPED}{meant(named.place, (SHIPPED,))}"
        )
    return policy_folder_from_name(name)


def _compared(facts: ExportMeasurements) -> str:
    """How the model compares with the network and with wcsim."""
    borders = ""
    if facts.border_steps:
        steps = pluralize(facts.border_steps, "step")
        borders = f" ({facts.border_off:.1g} in {steps} at borders of map cells)"
    return (
        f"{facts.bytes / 1e6:.1f} MB, outputs differ by at most {facts.most_off:.1g} of the largest"
        f"{borders}\n"
        f"{facts.same_actions:.1%} of {facts.steps} actions match the network, "
        f"{facts.same_as_wcsim:.1%} match wcsim's "
        f"policy; {pluralize(facts.interventions, 'intervention')}, "
        f"{pluralize(facts.warnings, 'step')} with a warning"
    )


def _beside_recording(same: float, by: str, policy: str) -> str:
    """How the network's own actions compare with those of a recording."""
    driver = f", which {escape(by, 80)} drove" if by else ""
    text = f"{same:.1%} of the actions match the recording{driver}"
    if same >= _SAME_POLICY and by.partition("@")[0] not in (*BASELINES, *UPPER_BOUNDS):
        return text
    return (
        f"{text}: another policy or threshold. The reference ride holds the actions of "
        f"{escape(policy)} for these observations. Record it while it drives: wcsim drive "
        f"--policy {shlex.quote(policy)} --record FILE"
    )


def _ride(
    options: _Options, own: RunConfig, policy: Policy
) -> tuple[tuple[str, ...], Sequence[Observation], tuple[int, ...] | None, str]:
    """The reference ride: delay and observations; of a recording also its actions and policy."""
    from wcsim.agents.export.export_folder import require_matching_recording
    from wcsim.agents.rounds.recorded_ride import read_ride_header, recorded_ride, reference_ride
    from wcsim.bridge.replay.replayed import config_of

    delay = _delay(options.delay_ticks)
    if options.ride is None:
        return (
            delay,
            reference_ride(options.town, resolve(own, delay), options.steps, policy),
            None,
            "",
        )
    header = read_ride_header(options.ride)
    require_matching_recording(
        config_of(header), own, options.ride, options.policy
    )  # before its world is made again
    held = recorded_ride(options.ride, options.steps, options.seat)
    by = "" if header.drive is None else header.drive.policy
    return delay or _delay(held.delay_ticks), held.seen, held.actions, by


def _delay(ticks: int | None) -> tuple[str, ...]:
    return () if ticks is None else (f"world.action_delay_ticks={ticks}",)

"""`wcsim collect`: drive, and record observations, actions, and which actions would end badly."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from wcsim.cli.shared.common import (
    Bounds,
    Cluster,
    Jobs,
    OutFile,
    OutFolder,
    SettingsOptions,
    parse_options,
    require_writable_folder,
    split_nonempty_list,
    workers_from_options,
    write_json,
)
from wcsim.cli.shared.consoles import warn
from wcsim.cli.shared.exit_codes import ExitCode
from wcsim.cli.shared.run_config import refuse_held_out_users, require_usable_policy
from wcsim.cli.shared.training import find_training_town
from wcsim.config import resolve
from wcsim.core.reading import pluralize
from wcsim.errors import InterruptedRunError


@dataclass(kw_only=True)
class _Options(SettingsOptions):
    """Record driving as training data; `wcsim train --data FOLDER` reads it."""

    town: str = "helsinki"
    """Training towns, used in turn, joined by commas: a town's name, its folder, or a .sumocfg file."""  # noqa: E501 - help text
    preset: str = "laptop"
    """Preset to start from. Its section [collect] sets drivers and segments."""
    segments: Annotated[int, Bounds(1)] = 10
    """Total segments, each a fresh world of collect.ticks ticks. Existing segments are kept."""
    policy: str = ""
    """Trained danger network that drives some of the episodes. By default, users and the oracle drive all."""  # noqa: E501 - help text
    worlds: Jobs = 1
    """Worker processes that drive at once. The data does not depend on their number."""
    cluster: Cluster = ""
    """HOST:PORT of a Ray cluster that drives, or `local`. The data stays the same (docs/cluster.md)."""  # noqa: E501 - help text
    seed: int = 0
    """Random seed: equal seeds give equal data."""
    out: OutFolder = None
    """Data folder; default data/TOWN-SEED."""
    json: OutFile = None
    """Write the path and hash of the data to this file."""


def run(words: list[str]) -> int:
    """Drive, and leave a data folder."""
    options = parse_options(_Options, words, "collect")
    config = resolve(options.preset, options.config, options.set)
    if options.policy:
        require_usable_policy(options.policy, "", bare_for="collecting")
    refuse_held_out_users(config, (options.set, options.config))
    machines = replace(
        workers_from_options(options.cluster, options.worlds, "--worlds"), report=warn
    )
    towns = [
        find_training_town(name, False) for name in split_nonempty_list("--town", options.town)
    ]
    out = options.out or Path("data") / f"{towns[0].name}-{options.seed}"
    require_writable_folder("--out", out)
    from wcsim.agents.rounds.collect_data import DataOrder, collect_data  # torch is loaded here
    from wcsim.agents.runs.data_folder import SEGMENTS
    from wcsim.agents.runs.run_folder import policy_folder_from_name

    order = DataOrder(
        folder=out,
        config=config,
        towns=tuple(str(town.address) for town in towns),
        seed=options.seed,
        segments=options.segments,
        policy=str(policy_folder_from_name(options.policy)) if options.policy else "",
        machines=machines,
    )
    try:
        sha256 = collect_data(order, lambda done, of: print(f"{done} of {of} segments", flush=True))
    except KeyboardInterrupt:
        segments = len(list(out.glob(f"{SEGMENTS}/*.npz.zst")))
        if not segments:
            raise
        raise InterruptedRunError(
            f"stopped; {out} holds {pluralize(segments, 'segment')}; the same command continues"
        ) from None
    learn = f"wcsim train --preset laptop --data {shlex.quote(str(out))}"
    print(f"data folder: {out}, SHA-256 {sha256}    train on it: {learn}")
    write_json(options.json, {"data": str(out), "sha256": sha256, "segments": options.segments})
    return ExitCode.DONE

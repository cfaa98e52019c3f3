"""Puts a trained run where `shipped` finds it: python tools/ship_policy.py RUN [--level 0.1] [--result result.json].

The folder holds policy.json, weights.safetensors, the ONNX model with what it means, and a card made from the run's
manifest and the rows of the results that are given.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wcsim.agents.export.export_folder import REFERENCE
from wcsim.agents.export.guard import MEANING
from wcsim.agents.export.onnx_export import export_policy
from wcsim.agents.opening.learner_registry import DANGER_ROUNDS
from wcsim.agents.policy_api import MODEL_FILE, Observation
from wcsim.agents.rounds.train_rounds import read_data_hashes
from wcsim.agents.runs.data_folder import DATA, SEGMENTS, hash_segments, read_data_manifest, segment_key_from_name
from wcsim.agents.runs.policy_file import (
    EXPORTED,
    FILES,
    HELD,
    POLICY_JSON,
    WEIGHTS,
    find_shipped_policy,
    get_shipped_policy_path,
)
from wcsim.agents.runs.run_folder import MANIFEST, RunFolder, open_run
from wcsim.config import CameraConfig, CollectConfig, resolve
from wcsim.config.held_out import HELD_OUT
from wcsim.core import files
from wcsim.towns.scene_folders.families import TRAINED

_COLUMNS = (
    "policy",
    "part",
    "crashes_any",
    "crashes_own",
    "km",
    "followed",
    "speed_mps",
    "arrived",
    "unneeded",
    "warned_share",
    "false_warnings_per_km",
    "score",
)
_LIMITS = """- Simulation only: this says nothing about a real street, and no person has driven with it.
- Its input is depth cameras at the positions above, with a class for each pixel.
  Real cameras have more errors.
- It remembers 4 s. It cannot detect what comes from outside their pictures.
- It is only valid with the chair, cameras and delay above.
- Its dangers are not probabilities. The threshold was chosen on the towns above alone."""


def ship(run: RunFolder, ride: Sequence[Observation], results: Sequence[Path], to: Path, level: float) -> Path:
    """Write the folder of a shipped policy of this level in one step; returns it."""
    # Before what takes long.
    told = card(run, [row for path in results for row in rows_of(path, run.path)], level)
    with tempfile.TemporaryDirectory() as held:
        policy = shutil.copytree(run.policy("final"), Path(held) / "policy")
        facts = json.loads((policy / POLICY_JSON).read_text(encoding="utf-8"))
        facts["rule"]["threshold"] = level
        files.write_json(policy / POLICY_JSON, facts)
        for delay, name in EXPORTED.items():
            config = resolve(run.config, f"world.action_delay_ticks={delay}")
            export_policy(*DANGER_ROUNDS.open_graph(policy, config), Path(held) / name, config, ride)
        onnx = Path(held) / EXPORTED[run.config.world.action_delay_ticks]
        with files.write_folder_atomically(to) as target:
            readme = to.glob("README.md")
            for source in (policy / POLICY_JSON, policy / WEIGHTS, onnx / MEANING, onnx / REFERENCE, *readme):
                shutil.copy(source, target)
            for name in EXPORTED.values():
                shutil.copyfile(Path(held) / name / MODEL_FILE, target / name)
            (target / "MODEL_CARD.md").write_text(told, encoding="utf-8")
            files.write_json(target / FILES, {"sha256": {name: files.sha256_from_file(target / name) for name in HELD}})
    return find_shipped_policy(to)


def rows_of(path: Path, run: Path) -> list[dict[str, Any]]:
    """The rows of a result that `wcsim test --json` or `--suite` wrote, with the folder's name; `run` is what ships."""
    data = json.loads(path.read_text(encoding="utf-8"))
    found = [*data.get("rows", ()), *({**row, "part": "all"} for row in data.get("pooled", ()))]
    place = path.parent.name or path.name
    return [{**row, "from": place, "policy": row["policy"].replace(str(run), "shipped")} for row in found]


def card(run: RunFolder, rows: Sequence[dict[str, Any]], level: float) -> str:
    """The model card, as Markdown."""
    manifest, config = run.manifest, run.config
    danger, collect = config.danger, config.collect
    towns, users, kept = driving(run)
    streets = f" (streets of {manifest.town} {manifest.town_sha256[:12]})" if manifest.town in towns else ""
    met = "".join(f"; {name} is held out" for name in HELD_OUT["profile"] if name not in users)
    lines = [
        "# Model card: the policy that comes with wcsim",
        "It scores the danger of each joystick position and drives the safe one nearest to the user: `docs/danger.md`.",
        "",
        "| | |",
        "|---|---|",
        f"| trained in | {', '.join(towns)}{streets} |",
        f"| users | {', '.join(users)}{met} |",
        f"| scenes | {', '.join(TRAINED) if collect.scene_share else 'none'} |",
        f"| data | {kept} segments of {collect.ticks} ticks with {collect.chairs} chairs, labels {danger.teacher} |",
        f"| seed | {manifest.seed} |",
        f"| network | street map, width {danger.width} |",
        f"| rule | threshold {level:g}, at once {danger.at_once:g}, warn {danger.warn:g} |",
        *(f"| camera `{camera.name}` | {camera_told(camera)} |" for camera in config.eyes.values()),
        f"| delay | {config.world.action_delay_ticks} ticks of {config.world.tick_s:g} s |",
        f"| versions | {', '.join(f'{name} {version}' for name, version in manifest.versions.items())} |",
        f"| code | {manifest.git_revision or 'unknown'} |",
        f"| settings | SHA-256 {manifest.config_sha256} |",
        "",
        "Reproduce it with:",
        "",
        *(f"    {command}" for command in commands(run)),
        "",
        "## Test results",
        *table(rows),
        "",
        "## Limits",
        _LIMITS,
        "",
    ]
    return "\n".join(lines)


def camera_told(camera: CameraConfig) -> str:
    """What a camera is like, and where it sits.

    >>> camera_told(CameraConfig(width_px=80, height_px=60))
    '80x60, 87 deg, range 40 m, noise none, at x 0.35, y 0, z 1 m of the chair, 0 deg to the left, -15 deg up'
    """
    x_m, y_m, z_m = camera.p_BC_m
    return (
        f"{camera.width_px}x{camera.height_px}, {camera.hfov_deg:g} deg, range {camera.range_m:g} m, "
        f"noise {noise_told(camera)}, at x {x_m:g}, y {y_m:g}, z {z_m:g} m of the chair, "
        f"{camera.yaw_deg:g} deg to the left, {camera.pitch_deg:g} deg up"
    )


def noise_told(camera: CameraConfig) -> str:
    """The word for a camera's noise, or its numbers where there is no word."""
    if camera.noise is None:
        return "none"
    if camera.noise == CameraConfig.model_validate({"noise": "typical"}).noise:
        return "typical"
    parts = camera.noise.model_dump(mode="json", exclude_none=True)
    return ", ".join(f"{part}.{key} {value}" for part, numbers in parts.items() for key, value in numbers.items())


def driving(run: RunFolder) -> tuple[list[str], list[str], int]:
    """Towns, users and number of segments of all that it learned from: what was driven for it, and data folders."""
    collect, others = run.config.collect, read_data_hashes(run)
    towns, users = list[str](), list[str]()
    if collect.segments:
        made = [f"{collect.made_towns} generated"] if collect.made_towns else []
        towns, users = [run.manifest.town, *collect.towns, *made], list(collect.profiles)
    for folder in map(Path, others):
        towns += read_data_manifest(folder).towns
        if is_of_run(folder):  # all profiles that took turns
            users += open_run(folder.parent).config.collect.profiles
        else:
            users += read_data_manifest(folder).config.get("collect", {}).get("profiles", CollectConfig().profiles)
    kept = sum(1 for _ in (run.path / DATA / SEGMENTS).glob("*")) + sum(map(len, others.values()))
    return list(dict.fromkeys(towns)), list(dict.fromkeys(users)), kept


def is_of_run(folder: Path) -> bool:
    """Whether a data folder is the one of a run."""
    return folder.name == DATA and (folder.parent / MANIFEST).is_file()


def commands(run: RunFolder) -> list[str]:
    """What was typed for the driving that it learned from, then for the run; no place of this machine is told."""
    data = [
        command for folder, segments in read_data_hashes(run).items() for command in driven_by(Path(folder), segments)
    ]
    return [*data, typed(run)]


def driven_by(folder: Path, segments: dict[str, str]) -> list[str]:
    """How segments of a data folder came to be: the command of its run, or `wcsim collect` for each seed."""
    if is_of_run(folder):
        return [typed(open_run(folder.parent))]
    seeds = Counter(segment_key_from_name(name).run for name in segments)
    where = ["--town", ",".join(read_data_manifest(folder).towns), "--out", f"data/{folder.name}"]
    return [
        shlex.join(["wcsim", "collect", *where, "--seed", str(seed), "--segments", str(count)])
        + f"  # with the settings in its data.json; SHA-256 of the data {hash_segments(segments)[:12]}"
        for seed, count in sorted(seeds.items())
    ]


def typed(run: RunFolder) -> str:
    """The command of a run."""
    return shlex.join(map(run_folder, run.manifest.command)) or "unknown"


def run_folder(word: str) -> str:
    """An absolute path in a command, as one below `runs`; any other word as it is.

    >>> [run_folder(word) for word in ("--seed", "/home/me/a", "/home/me/a/data")]
    ['--seed', 'runs/a', 'runs/a/data']
    """
    path = Path(word)
    if not path.is_absolute():
        return word
    return str(Path("runs", *(path.parts[-2:] if path.name == DATA else path.parts[-1:])))


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Rows of results as a table; a line when there are none."""
    if not rows:
        return ["No results were given when it was shipped."]
    columns = ["from", *(name for name in _COLUMNS if any(name in row for row in rows))]
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    return lines + [f"| {' | '.join(cell(row.get(name)) for name in columns)} |" for row in rows]


def cell(value: Any) -> str:
    """A value in a table."""
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Ship what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--result", type=Path, action="append", default=[], help="a result.json; several are allowed")
    parser.add_argument("--level", type=float, help="the threshold; else that of its training")
    asked = parser.parse_args()
    from wcsim.agents.opening.named_policy import open_named_policy  # these load the simulators
    from wcsim.agents.rounds.recorded_ride import reference_ride

    run = open_run(asked.run)
    level = asked.level or run.config.danger.threshold
    ride = reference_ride("helsinki", run.config, 200, open_named_policy(f"{asked.run}@{level:g}", run.config, 0))
    ship(run, ride, asked.result, get_shipped_policy_path(), level)


if __name__ == "__main__":
    main()

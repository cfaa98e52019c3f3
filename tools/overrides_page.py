"""`docs/overrides.md`: the SUMO options that wcsim overrides."""

from __future__ import annotations

from tools.pages import table
from wcsim.towns.scenario.overrides import AGGREGATED, RULES, WHY
from wcsim.towns.sumo.warning_log import ERROR_LOG

PAGE = """# SUMO options that wcsim overrides

Your `.sumocfg` and its files are never changed. A world runs filtered copies from `RUN/sumo/`. A file that writes
nothing is read in place. In a file that names outputs (detectors, `edgeData`, `timedEvent`, `<param>` of devices and
signals), only those paths change: to `RUN/sumo/`.

Every file that SUMO would read is checked first, at any depth of `<include>`:

- It lies in the folder of the `.sumocfg` or `town.toml`, links followed. `--allow-outside` of `wcsim town run` and
  `wcsim town import` permits files elsewhere.
- It is XML 1.0 in UTF-8, ASCII, ISO-8859 or a Windows encoding, plain or gzip, without a document type. It has at
  most 200 MiB and is nested at most 100 deep. A list of edges may be text.
- SUMO gets a copy of a file whose name it may spell in another way, such as one with an umlaut.

{table}

A run prints which options differ, shows the reasons with `--verbose`, and saves both in its manifest. The filtered
`RUN/sumo/TOWN.sumocfg` opens in sumo and sumo-gui. Without a run folder, as in a Gymnasium environment, SUMO's
outputs are deleted when the world closes. A world that starts again overwrites its outputs.

SUMO's warnings go to `RUN/sumo/sumo-warnings.log`, or to the scenario's `error-log`, until it has 4 MiB; later ones are
only counted. A scenario with `output.format` `parquet` has no such file. `town run` prints the first warning of each
kind, and `town check` those of 300 s.

SUMO dies when it writes some outputs as parquet. Such a scenario is refused by the name of the output: `tripinfo`,
`personinfo`, `vehroute`, `personroute`, `full`, `netstate-dump`, logs, and `fcd` with `stage`, `vehicle`, `all` or a
leader distance.

## Steps shorter than the author's

SUMO's drivers decide once per step. A scenario that was calibrated for steps of 1 s therefore drives 10 to 20 %
faster in steps of 0.1 s. The example is Bologna (acosta), plain sumo, 1500 s, two seeds:

| | mean speed in m/s | time loss in s | arrived |
| --- | --- | --- | --- |
| steps of 1 s, as the author's | 5.34, 5.34 | 177, 176 | 2571, 2584 |
| steps of 0.1 s | 6.34, 6.46 | 132, 128 | 2853, 2853 |
| steps of 0.1 s, `world.action_step_s=0.5` | 5.54, 5.53 | 167, 168 | 2591, 2638 |
| steps of 0.1 s, `world.action_step_s=0.7` | 5.41, 5.32 | 175, 178 | 2552, 2568 |
| steps of 0.1 s, `world.action_step_s=1` | 4.49, 4.65 | 233, 219 | 2265, 2333 |

`--set world.action_step_s=0.7` sets SUMO's `default.action-step-length`: drivers decide that often and still move in
every step. Try 0.5 to 0.7 of your step, and measure with `--chairs 0 --outputs tripinfo`. Drivers that decide less
often also brake for a wheelchair later. The setting is off by default.

## Traffic without wheelchairs

`wcsim town run TOWN --chairs 0` builds no street. Its traffic is that of plain sumo with the same step length and
seed (`sumo_seed` in the manifest). `--outputs fcd,tripinfo` writes the same bytes, except for the comment at the top.

## The warm-up

A warm-up of a minute or more (`world.warmup_s`) is done once: by steps of 1 s, after which SUMO saves its state into
the cache. Every world of this scenario and seed loads that state, the first one too, so all of them are equal to the
bit. Their outputs, teleports and collisions begin there. Where SUMO dies of the state (a child tries it once), with
JuPedSim, and with a step hook, each world warms up by ticks.

## Step hooks

`--hook module:Class` (`town run`, `train`, `test`) loads your class from the current folder or the Python path. Each
start of the world makes one object with the libsumo module. wcsim calls `before_step(time_s, chairs)` and
`after_step(time_s, chairs)` around each SUMO step; either may be missing.

`chairs` has a `HookChair` for each wheelchair: seat, position, angle and speed as in the net, route as points and
edges, and the signal whose button it has pressed. Both calls get the state before the step. With `--chairs 0` the
list is empty.

`examples/own_signals.py` has signals that are red at times, and a crossing that stays green while a chair is on it. A
hook may do anything to vehicles and signals. One that steps, loads or closes the simulation ends the run with an
error. Hooks are loaded from the command line only: a town cannot name one.
"""


def page() -> str:
    """The page, in Markdown."""
    rows = [(f"`{rule.option}`", rule.effect, rule.why) for rule in RULES]
    rows += [
        ("`end`", "kept, but does not end the run", WHY["end"]),
        ("`begin`, `lateral-resolution`, collisions, routing, devices, models, ...", "kept", "they define the traffic"),
        ("each option that writes a file", "a file of the same name in `RUN/sumo/`", WHY["outputs"]),
        *(
            (f"`{name}`", told, WHY[name])
            for name, told in (
                ("device.ssm.file", "`RUN/sumo/ssm.xml`, unless the scenario names a file"),
                (ERROR_LOG, "`RUN/sumo/sumo-warnings.log`, unless the scenario names a file"),
                ("save-state.prefix", "`RUN/sumo/state`, unless the scenario names one"),
                (AGGREGATED, "true if there is such an output"),
            )
        ),
        ("`output-prefix`, `output-suffix`", "left out", WHY["output"]),
        ("options of sumo-gui", "left out", WHY["gui_only"]),
        ("`remote-port`, `num-clients`", "left out", WHY["traci_server"]),
        ("`save-configuration`, `save-template`, ...", "left out", WHY["configuration"]),
    ]
    return PAGE.format(table="\n".join(table(("option", "in a run", "why"), rows)))

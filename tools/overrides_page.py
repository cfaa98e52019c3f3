"""Print `docs/overrides.md`, what wcsim overrides of a scenario's options: `python tools/overrides_page.py`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # of this checkout, wherever it is called from

from wcsim.towns.scenario.overrides import AGGREGATED, DROP_WHY, END_WHY, OUTPUT_WHY, PREFIX_WHY, RULES, UNASKED_WHY

PAGE = """# What wcsim overrides of a SUMO scenario

A `.sumocfg` and the files it names stay as they are. A world runs filtered copies of them from `RUN/sumo/`: a file that
writes nothing is read where it lies; one that names outputs (detectors, `edgeData`, `timedEvent`, `<param>` of devices
and signals, at any depth of `<include>`) is copied with those names led to `RUN/sumo/`. Everything else in it stays.

Every file that SUMO reads because of a scenario is looked through first, whichever option or element names it. It must
lie in the folder of the `.sumocfg`, or of the `town.toml`, links followed; `--allow-outside` of `wcsim town run` and
`wcsim town import` trusts a scenario with files elsewhere. It must be XML 1.0 in UTF-8, ASCII or a relative of theirs
(ISO-8859, Windows), plain or gzip, without a document type, of at most 200 MiB, nested at most 100 deep; a list of
edges may be text. A file whose name SUMO may spell in another way, as one with an umlaut, is read from a copy.

{table}

What differs from the author's values is named when a run begins, shown with its reasons by `--verbose`, and kept in the
manifest. The filtered
`RUN/sumo/TOWN.sumocfg` opens in sumo and sumo-gui as it is. Without a run folder (a Gymnasium environment) everything
that SUMO writes goes when the world closes. When a world is made anew, its outputs begin anew.

## Steps shorter than the author's

SUMO's drivers decide once a step, so a scenario that was written, and calibrated, for steps of 1 s drives faster in
steps of 0.1 s: by some 10 % in one German town, by 20 % in Bologna (acosta, plain sumo, 1500 s, two seeds):

| | mean speed in m/s | time loss in s | arrived |
| --- | --- | --- | --- |
| steps of 1 s, as the author's | 5.34, 5.34 | 177, 176 | 2571, 2584 |
| steps of 0.1 s | 6.34, 6.46 | 132, 128 | 2853, 2853 |
| steps of 0.1 s, `world.action_step_s=0.5` | 5.54, 5.53 | 167, 168 | 2591, 2638 |
| steps of 0.1 s, `world.action_step_s=0.7` | 5.41, 5.32 | 175, 178 | 2552, 2568 |
| steps of 0.1 s, `world.action_step_s=1` | 4.49, 4.65 | 233, 219 | 2265, 2333 |

`--set world.action_step_s=0.7` is SUMO's `default.action-step-length`: drivers decide so often, and move in every step.
The author's whole step overshot here, 0.7 of it came within 1 %; measure your own with `--chairs 0 --outputs tripinfo`.
Drivers who decide less often also brake for a wheelchair later, when they next decide. It is off by default.

## Traffic alone

With `wcsim town run TOWN --chairs 0` no street is built, and the traffic is that of plain sumo with the same step
length and seed (`sumo_seed` in the manifest): `--outputs fcd,tripinfo` writes the same bytes, but for the comment at
their top.

## Your own logic: a step hook

`--hook module:Class` (`town run`, `train`, `test`) names a class of yours, in the current folder or on the Python path.
It is made with the libsumo module for every epoch of the world; `before_step(time_s, chairs)` and
`after_step(time_s, chairs)` are called around each step of SUMO, either may be missing. `chairs` are the wheelchairs,
which SUMO has not: for each a `HookChair` with seat, place, angle and speed as in the net, its way as points and as
edges, and the light whose button it has pressed. Both calls tell those before the step; `--chairs 0` gives none.
`examples/own_signals.py` has lights that are red at times, and a crossing that stays green while a chair is on it.
Code is loaded from
your own command line alone: a town cannot name a hook, because towns are made by others. What a hook does to vehicles
and signals is up to you; do not step, load or close the simulation in it.
"""


def page() -> str:
    """The page, in Markdown."""
    rows = [(f"`{rule.option}`", rule.says, rule.why) for rule in RULES]
    rows += [
        ("`end`", "kept, but it does not end the run", END_WHY),
        ("`begin`, `lateral-resolution`, collisions, routing, devices, models, ...", "kept", "they are the traffic"),
        ("every option that writes a file", "a file of the same name in `RUN/sumo/`", OUTPUT_WHY),
        *(
            (f"`{name}`", told, UNASKED_WHY[name])
            for name, told in (
                ("device.ssm.file", "`RUN/sumo/ssm.xml`, unless the author names a file"),
                ("save-state.prefix", "`RUN/sumo/state`, unless the author names one"),
                (AGGREGATED, "true where there is such an output"),
            )
        ),
        ("`output-prefix`, `output-suffix`", "left out", PREFIX_WHY),
        ("options of sumo-gui", "left out", DROP_WHY["gui_only"]),
        ("`remote-port`, `num-clients`", "left out", DROP_WHY["traci_server"]),
        ("`save-configuration`, `save-template`, ...", "left out", DROP_WHY["configuration"]),
    ]
    lines = [f"| {' | '.join(row)} |" for row in (("option", "in a run", "why"), ("---", "---", "---"), *rows)]
    return PAGE.format(table="\n".join(lines))


if __name__ == "__main__":
    print(page(), end="")

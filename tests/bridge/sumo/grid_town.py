"""A generated town of any size: a grid of streets with pavements and crossings, full of traffic at once."""

from collections import defaultdict
from pathlib import Path

import numpy as np

from wcsim.towns.importing.folder_texts import sumocfg_text, town_toml_text
from wcsim.towns.sumo.tools import run_tool
from wcsim.towns.sumo.xml_io import read_root

BLOCK_M = 200
STEPS = 12  # edges of a way


def make_grid_town(folder: Path, blocks: int, vehicles: int, people: int, seed: int = 1) -> Path:
    """Write a town of `blocks` x `blocks` blocks of 200 m; vehicles and people all start at once, spread over it."""
    folder.mkdir(parents=True)
    grid = ["--grid", "--grid.number", str(blocks + 1), "--grid.length", str(BLOCK_M), "--default.speed", "13.89"]
    walk = ["--sidewalks.guess", "--sidewalks.guess.from-permissions", "--crossings.guess", "--walkingareas"]
    run = run_tool("netgenerate", [*grid, *walk, "--tls.guess", "-o", "big.net.xml"], folder)
    assert not run.returncode, run.reason()
    (folder / "big.rou.xml").write_text(_routes(folder / "big.net.xml", vehicles, people, seed))
    (folder / "big.sumocfg").write_text(sumocfg_text("big", seed, "big.rou.xml", ()).replace(".net.xml.gz", ".net.xml"))
    middle = blocks * BLOCK_M // 2
    toml = town_toml_text(name="big", split="train", origin_m=(middle, middle)) + "warmup_s = 1.0\n"
    (folder / "town.toml").write_text(toml)
    return folder


def _routes(net: Path, vehicles: int, people: int, seed: int) -> str:
    """Ways of STEPS edges that drive straight on or turn as chance has it."""
    after: dict[str, set[str]] = defaultdict(set)
    for link in read_root(net).iterfind("connection"):
        if not link.attrib["from"].startswith(":") and link.get("dir") != "t":
            after[link.attrib["from"]].add(link.attrib["to"])
    names = sorted(name for name in after if after[name])
    rng = np.random.default_rng(seed)
    lines = ["<routes>", '    <vType id="car" vClass="passenger"/>']
    for number in range(vehicles + people):
        way = [names[rng.integers(len(names))]]
        for _ in range(STEPS):
            ahead = sorted(name for name in after[way[-1]] if name in after and name not in way)
            if not ahead:
                break
            way.append(ahead[rng.integers(len(ahead))])
        edges = " ".join(way)
        if number < vehicles:
            head = f'id="v{number}" type="car" depart="0" departPos="random_free" departSpeed="max"'
            lines.append(f'    <vehicle {head}><route edges="{edges}"/></vehicle>')
        else:
            lines.append(f'    <person id="p{number}" depart="0" departPos="random"><walk edges="{edges}"/></person>')
    return "\n".join([*lines, "</routes>", ""])

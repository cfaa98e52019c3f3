"""With no wheelchair in it, a world's traffic is that of plain sumo, byte for byte."""

from pathlib import Path

import pytest

from tests.bridge.neutrality.neutral import same
from tests.support.worlds import quick_config
from wcsim.bridge.world import World
from wcsim.core import seeding
from wcsim.towns.scenario.town import Town, find_town
from wcsim.towns.sumo.tools import Limits, run_tool
from wcsim.types.episode import RunPlace

SEED = 7
OUTPUTS = ("fcd", "tripinfo")
OWN_NAMES = {"tripinfo": ("tripinfo.xml", "tripinfos.xml")}  # the author of Bologna's scenario has a name of his own


def by_wcsim(town: Town, seconds: float, folder: Path, look: bool = False, seed: int = SEED) -> dict[str, Path]:
    with World(town, quick_config(), (), seed, RunPlace(folder=folder, outputs=OUTPUTS)) as world:
        for _ in range(round(seconds / 0.1)):
            world.tick(())
            if look:
                world.sumo.everyone()
    made = {path.name: path for path in (folder / "sumo").iterdir()}
    names = {output: OWN_NAMES.get(output, (f"{output}.xml",)) for output in OUTPUTS}
    return {output: next(made[name] for name in names[output] if name in made) for output in OUTPUTS}


def by_sumo(town: Town, seconds: float, folder: Path) -> dict[str, Path]:
    """The author's own file under plain sumo, with the options that the table of overrides names."""
    folder.mkdir()
    options = [
        "-c",
        str(town.sumocfg.resolve()),
        "--step-length",
        "0.1",
        "--seed",
        str(seeding.derive_seed(SEED, "sumo")),
    ]
    options += ["--end", str(seconds), "--no-step-log", "--no-warnings", "--xml-validation", "never"]
    options += ["--xml-validation.net", "never", "--xml-validation.routes", "never", "--log", str(folder / "log")]
    for output in (*OUTPUTS, "stop"):
        options += [f"--{output}-output", str(folder / f"{output}.xml")]
    run = run_tool("sumo", options, folder, Limits(wall_s=900.0, cpu_s=880, file_bytes=4 << 30))
    assert run.returncode == 0, run.output
    return {output: folder / f"{output}.xml" for output in OUTPUTS}


def compare(town: Town, seconds: float, tmp_path: Path, look: bool = True) -> None:
    ours, plain = by_wcsim(town, seconds, tmp_path / "run", look), by_sumo(town, seconds, tmp_path / "plain")
    assert plain["fcd"].stat().st_size > 100_000
    assert [output for output in OUTPUTS if not same(ours[output], plain[output])] == []
    for path in (*ours.values(), *plain.values()):
        path.unlink()  # ten minutes of a city are close to a gigabyte


def test_a_street_corner_flows_as_in_plain_sumo(corner_town, tmp_path):
    compare(corner_town, 60.0, tmp_path)


def test_monaco_flows_as_in_plain_sumo(tmp_path):
    compare(find_town("monaco"), 60.0, tmp_path)


def test_another_seed_is_another_traffic(tmp_path):
    town = find_town("monaco")
    ours = by_wcsim(town, 20.0, tmp_path / "run")
    other = by_wcsim(town, 20.0, tmp_path / "other", seed=SEED + 1)
    assert not same(ours["fcd"], other["fcd"])


@pytest.mark.proof
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("name", ["helsinki", "monaco", "manhattan"])
def test_ten_minutes_of_each_town_flow_as_in_plain_sumo(name, tmp_path):
    compare(find_town(name), 600.0, tmp_path, look=name == "monaco")


@pytest.mark.proof
@pytest.mark.shared
@pytest.mark.timeout(1500)
def test_ten_minutes_of_somebody_elses_town_flow_as_in_plain_sumo(shared, tmp_path):
    compare(find_town(str(shared / "towns" / "nets" / "bologna_acosta" / "run.sumocfg")), 600.0, tmp_path, look=False)

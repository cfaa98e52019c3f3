import pytest

from tests.bridge.sumo.test_actor_kinds import ADDITIONAL, EVENTS, TYPES
from tests.cli.conftest import QUICK, parsed
from tests.support.menagerie import HITTING, build_street
from tests.towns.made import hostile
from wcsim.bridge.town_run import CrashFact
from wcsim.cli.main import main
from wcsim.cli.town.run import _crash_lines
from wcsim.towns.scenario.town import find_town


def test_a_town_runs_and_is_replayed(corner, tmp_path, capsys):
    out, written = tmp_path / "run", tmp_path / "told.json"
    words = ["town", "run", str(corner), "--seconds", "3", "--seed", "3", "--out", str(out), "--json", str(written)]
    assert main([*words, "--outputs", "fcd,tripinfo", "--verbose", *QUICK]) == 0
    shown = capsys.readouterr()
    assert "vehicles" in shown.out and "what this run overrides" in shown.out
    manifest = parsed(out / "manifest.json")
    assert manifest["status"] == "done" and manifest["seed"] == 3
    assert manifest["command"][:3] == ["wcsim", "town", "run"]
    rows = {row["option"]: row for row in manifest["overrides"]}
    assert rows["seed"]["wcsim"] == str(manifest["sumo_seed"])
    assert set(manifest["outputs"]) == {"sumo/fcd.xml", "sumo/tripinfo.xml"}
    assert all((out / name).is_file() for name in (*manifest["outputs"], "trace"))
    result = parsed(written)
    assert result["ticks"] == 30 and result["episodes"] >= 1
    assert main(["log", "convert", str(out), str(tmp_path / "replay.xml")]) == 0
    assert 'id="wheelchair.0"' in (tmp_path / "replay.xml").read_text()
    assert "30 time steps" in capsys.readouterr().out
    assert main(words) == 2
    assert "is not empty" in capsys.readouterr().err


def test_traffic_alone_begins_where_the_scenario_begins(corner, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["town", "run", str(corner), "--seconds", "2", "--chairs", "0", "--out", str(out)]) == 0
    assert parsed(out / "manifest.json")["facts"]["end_s"] == pytest.approx(2.0)
    assert "road users near a wheelchair" not in capsys.readouterr().out


def test_jams_are_counted_as_they_are_told(tmp_path, capsys, caplog):
    sumocfg = build_street(tmp_path, TYPES + EVENTS, ADDITIONAL, lanes=1)
    settings = ["--set", "world.jam_teleport_s=5", "--set"]
    for warmup_s, seconds, cell in ((20, 2, "1, 1 during warm-up "), (0, 20, "1 ")):
        caplog.clear()
        out = tmp_path / f"run-{warmup_s}"
        words = ["town", "run", str(sumocfg), "--chairs", "0", "--seconds", str(seconds), "--out", str(out)]
        assert main([*words, *settings, f"world.warmup_s={warmup_s}"]) == 0
        (line,) = (record.getMessage() for record in caplog.records if "jam: " in record.getMessage())
        assert line.startswith("jam: SUMO teleported jammed, which stood too long on edge SC, at 17.")
        assert f"teleports out of jams            │ {cell}" in capsys.readouterr().out
        facts = parsed(out / "manifest.json")["facts"]
        assert (facts["teleports"], facts["teleports_warming"]) == (1, int(warmup_s > 0))


def test_collisions_of_the_warm_up_are_counted_apart(tmp_path, capsys):
    sumocfg = build_street(tmp_path, HITTING, lanes=1)
    out = tmp_path / "run"
    words = ["town", "run", str(sumocfg), "--chairs", "0", "--seconds", "1", "--out", str(out)]
    assert main([*words, "--set", "world.warmup_s=10"]) == 0
    assert "within SUMO's traffic │ 1, 1 during warm-up" in capsys.readouterr().out
    facts = parsed(out / "manifest.json")["facts"]
    assert (facts["collisions"], facts["collisions_warming"]) == (1, 1)


def two_streets(corner_town, tmp_path, vclass):
    """A scenario of two streets without pavements for vehicles of one class, and such a vehicle."""
    sumocfg = hostile.scenario(corner_town, tmp_path / "theirs")
    net = sumocfg.with_name("a.net.xml")
    kind = f'numLanes="1" speed="13" allow="{vclass}"'
    edges = f'<edge id="e1" from="a" to="b" {kind}/><edge id="e2" from="b" to="c" {kind}/>'
    nodes = '<node id="a" x="0" y="0"/><node id="b" x="90" y="0"/><node id="c" x="180" y="9"/>'
    (tmp_path / "p.nod.xml").write_text(f"<nodes>{nodes}</nodes>")
    (tmp_path / "p.edg.xml").write_text(f"<edges>{edges}</edges>")
    from wcsim.towns.sumo.tools import run_tool

    assert run_tool("netconvert", ["-n", "p.nod.xml", "-e", "p.edg.xml", "-o", str(net)], tmp_path).returncode == 0
    kind, route = f'<vType id="kind" vClass="{vclass}"/>', '<route edges="e1 e2"/>'
    text = f'<routes>{kind}<vehicle id="v" type="kind" depart="0">{route}</vehicle></routes>'
    sumocfg.with_name("a.rou.xml").write_text(text)
    return sumocfg


def test_a_net_without_pavements_runs_traffic_and_refuses_chairs(corner_town, tmp_path, capsys):
    sumocfg = two_streets(corner_town, tmp_path, "passenger")
    words = ["town", "run", str(sumocfg), "--seconds", "2"]
    assert main([*words, "--chairs", "0", "--out", str(tmp_path / "none")]) == 0
    assert "wcsim town pave" in capsys.readouterr().out  # nobody walks, and how to change that
    assert main([*words, "--chairs", "1", "--out", str(tmp_path / "one"), *QUICK]) == 2
    message = capsys.readouterr().err
    assert "no pavement" in message and f"wcsim town pave {sumocfg}" in message and "--chairs 0" in message
    assert not (tmp_path / "one").exists()


def test_a_hook_of_the_users_own_is_loaded_from_the_command_line_only(corner, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (
        "class Stop:\n    def __init__(self, libsumo): pass\n"
        "    def before_step(self, time_s, chairs): raise ValueError('x')\n"
    )
    (tmp_path / "stops_at_once.py").write_text(text)
    words = ["town", "run", str(corner), "--seconds", "1", "--chairs", "0", "--hook", "stops_at_once:Stop"]
    assert main([*words, "--out", "run"]) == 2
    assert "step hook 'stops_at_once:Stop' failed in before_step: ValueError: x" in capsys.readouterr().err
    assert parsed(tmp_path / "run" / "manifest.json")["status"] == "interrupted"
    toml = corner / "town.toml"
    before = toml.read_text()
    try:
        toml.write_text(before + '\nhook = "stops_at_once:Stop"\n')
        assert main(["town", "run", str(corner), "--chairs", "0", "--out", "other"]) == 2
        assert "unknown key 'hook'" in capsys.readouterr().err
    finally:
        toml.write_text(before)


def test_somebodys_scenario_is_imported_as_it_is(corner_town, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sumocfg = hostile.scenario(corner_town, tmp_path / "theirs")
    main(["town", "import", "--sumocfg", str(sumocfg), "--name", "mine", "--split", "test"])
    assert "scenarios/sumo/mine" in capsys.readouterr().out
    town = find_town("mine")
    assert (town.split, town.sumocfg.read_bytes()) == ("test", sumocfg.read_bytes())
    assert main(["town", "import", "--sumocfg", str(sumocfg), "--osm", "x.osm", "--name", "y"]) == 2


def test_training_keeps_what_it_overrides_and_the_outputs_of_the_scenario(corner, tmp_path, capsys):
    summary = "<summary value='s.xml'/><lateral-resolution value='0.4'/>"
    town = find_town(str(corner))
    sumocfg = tmp_path / "theirs.sumocfg"
    for file in (town.net, *town.routes):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    parts = "".join(
        f"<{name} value='{','.join(file.name for file in files)}'/>"
        for name, files in (("n", [town.net]), ("r", town.routes))
    )
    sumocfg.write_text(f"<c>{parts}{summary}</c>", encoding="utf-8")
    out = tmp_path / "run"
    small = ["--set", "learn.total_steps=60", "--set", "learn.phase1_steps=30", *QUICK]
    assert main(["train-q", "--town", str(sumocfg), "--out", str(out), *small]) == 0
    message = capsys.readouterr().out
    assert "what this run overrides" not in message and "summary-output" in message and "--verbose" in message
    rows = {row["option"]: row for row in parsed(out / "manifest.json")["overrides"]}
    assert rows["summary-output"]["wcsim"] == "sumo/s.xml" and (out / "sumo" / "s.xml").stat().st_size > 1000
    from wcsim.agents.runs.run_folder import open_run

    assert open_run(out).manifest.overrides[0].option in rows
    assert not (tmp_path / "s.xml").exists()


def test_the_first_crashes_are_listed(corner, tmp_path, capsys):
    crash = "was hit by car cars.8.1, at x 10.0 y 0.0 in the net, edge :C_c0"
    fact = CrashFact(seat=1, reason="collision", time_s=2.5, at_m=(10.0, 0.0), fault="other", told=crash)
    crashed = (fact,) * 7
    lines = _crash_lines(crashed)
    assert lines[0] == f"wheelchair 1, 2.5 s: collision, other fault: it {crash}"
    assert len(lines) == 6 and lines[-1] == "and 2 more crashes; all of them are in the manifest"
    assert _crash_lines(()) == [] and len(_crash_lines(crashed[:5])) == 5
    jolts = ["--set", "reward.accel_window_mps2=[0.001, 0.002]", "--set", "imu.saturation_mps2=10"]
    words = ["town", "run", str(corner), "--seconds", "2", "--out", str(tmp_path / "run"), *QUICK, *jolts]
    assert main(words) == 0
    done = capsys.readouterr()
    assert "s: acceleration, own fault: it was shaken too hard, at x " in done.out and " in the net, edge " in done.out
    assert "traffic warm-up of 0 s" in done.err

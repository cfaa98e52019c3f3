from pathlib import Path

import pytest

from wcsim.errors import TownError
from wcsim.towns.scenario.options import Treatment, read_configuration, sumo_options
from wcsim.towns.scenario.overrides import RULES

WRITERS = """
    netstate-dump emission-output battery-output elechybrid-output chargingstations-output
    overheadwiresegments-output substations-output fcd-output person-fcd-output full-output queue-output vtk-output
    amitran-output summary-output person-summary-output tripinfo-output personinfo-output vehroute-output
    personroute-output link-output railsignal-block-output railsignal-vehicle-output bt-output lanechange-output
    stop-output collision-output edgedata-output lanedata-output statistic-output deadlock-output save-state.prefix
    save-state.files pedestrian.jupedsim.wkt pedestrian.jupedsim.py device.rerouting.output log message-log
    error-log device.ssm.file device.toc.file device.taxi.dispatch-algorithm.output
    device.taxi.idle-algorithm.output
"""
"""Options whose value is a file that SUMO writes."""

WORDS = """
    weight-attribute load-state.remove-vehicles output.compression output.format output.column-header
    output.column-separator emission-output.attributes fcd-output.params fcd-output.attributes
    fcd-output.filter-shapes save-state.times save-state.suffix collision.action intermodal-collision.action
    scale-suffix insertion-checks railsignal.moving-block.default-classes railsignal.default-classes
    default.departspeed default.departlane default.carfollowmodel default.emergencydecel pedestrian.model
    pedestrian.jupedsim.model routing-algorithm persontrip.transfer.car-walk persontrip.transfer.taxi-walk
    persontrip.transfer.walk-taxi persontrip.default.group device.rerouting.explicit device.rerouting.mode
    person-device.rerouting.explicit person-device.rerouting.mode person-device.rerouting.scope xml-validation
    xml-validation.net xml-validation.routes language device.emissions.explicit device.emissions.begin
    device.emissions.period device.btreceiver.explicit device.btsender.explicit person-device.btsender.explicit
    person-device.btreceiver.explicit device.stationfinder.explicit device.stationfinder.rescueAction
    device.stationfinder.chargeType device.stationfinder.chargingStrategy device.battery.explicit
    device.example.explicit device.ssm.explicit device.ssm.measures device.ssm.thresholds
    device.ssm.exclude-conflict-types device.toc.explicit device.toc.manualType device.toc.automatedType
    device.toc.mrmSafeSpot device.driverstate.explicit device.bluelight.explicit device.fcd.explicit
    device.fcd.begin device.fcd.period person-device.fcd.explicit person-device.fcd.period
    device.elechybrid.explicit device.taxi.explicit device.taxi.dispatch-algorithm
    device.taxi.dispatch-algorithm.params device.taxi.idle-algorithm device.taxi.vclasses device.glosa.explicit
    device.tripinfo.explicit device.vehroute.explicit device.friction.explicit device.fcd-replay.explicit
    device.fcd-replay.consistency meso-ignore-lanes-by-vclass
"""
"""Options whose value is a text, but no file."""


def configuration(tmp_path: Path, inside: str, root: str = "sumoConfiguration"):
    path = tmp_path / "x.sumocfg"
    path.write_text(f"<{root}>{inside}</{root}>", encoding="utf-8")
    return read_configuration(path)


@pytest.mark.parametrize(
    "inside",
    [
        '<input><net-file value="a.net.xml"/></input>',
        '<n v="a.net.xml"/>',
        "<anything><deep><net> a.net.xml </net></deep></anything>",
        '<input><net value="a.net.xml"/></input>',
    ],
)
def test_every_spelling_that_sumo_takes_is_read(tmp_path: Path, inside: str) -> None:
    for root in ("configuration", "sumoConfiguration", "whatever"):
        config = configuration(tmp_path, inside, root)
        assert config.files("net-file") == (tmp_path / "a.net.xml",)


def test_several_files_and_variables_are_taken_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HERE", "sub")
    config = configuration(tmp_path, '<r value="a.xml, ${HERE}/b%20c.xml,/d.xml"/>')
    assert config.files("route-files") == (tmp_path / "a.xml", tmp_path / "sub" / "b c.xml", Path("/d.xml"))


@pytest.mark.parametrize(
    "inside, says",
    [
        ('<nosuch value="1"/>', "no option <nosuch>"),
        ('<lateral-resolution value="wide"/>', "<lateral-resolution> is 'wide'; expected a number"),
        ('<lateral-resolution value="nan"/>', "expected a number"),
        ('<end value="soon"/>', "expected a time"),
        ('<ignore-route-errors value="maybe"/>', "expected true or false"),
        ('<n value="a"/><net-file value="b"/>', "sets <net-file> twice"),
    ],
)
def test_what_sumo_would_refuse_is_refused_with_the_file_named(tmp_path: Path, inside: str, says: str) -> None:
    with pytest.raises(TownError, match=rf"x\.sumocfg: .*{says}"):
        configuration(tmp_path, inside)


def test_every_option_that_takes_a_file_has_a_treatment() -> None:
    options = sumo_options()
    read = {name for name, item in options.items() if item.name == name and item.treatment is Treatment.INPUT}
    assert read == {
        "net-file",
        "route-files",
        "additional-files",
        "weight-files",
        "load-state",
        "fcd-output.filter-edges.input-file",
        "device.ssm.filter-edges.input-file",
        "astar.all-distances",
        "astar.landmark-distances",
        "phemlight-path",
        "device.fcd-replay.files",
    }
    for name in ("log", "error-log", "device.ssm.file", "device.toc.file", "device.rerouting.output", "netstate-dump"):
        assert options[name].treatment is Treatment.OUTPUT, name
    for name in ("save-configuration", "gui-settings-file", "remote-port", "output-prefix"):
        assert options[name].treatment is Treatment.DROP, name
    for name in ("fcd-output.geo", "step-length", "collision.action", "lateral-resolution", "precision"):
        assert options[name].treatment is Treatment.KEEP, name


def test_every_option_of_this_sumo_that_could_name_a_file_was_looked_at() -> None:
    """A newer SUMO has new options: whoever meets one here says what it is, and leads its files into the run folder."""
    numbers = ("BOOL", "INT", "FLOAT", "TIME")
    options = {name: item for name, item in sumo_options().items() if name == item.name and item.kind not in numbers}
    written = {name for name, item in options.items() if item.treatment is Treatment.OUTPUT}
    kept = {name for name, item in options.items() if item.treatment is Treatment.KEEP}
    assert written == set(WRITERS.split())
    assert kept == set(WORDS.split())
    assert {item.kind for item in sumo_options().values()} <= {*numbers, "FILE", "STR", "STR[]"}
    defaults = {item.name: item.default for item in sumo_options().values() if item.kind == "FILE" and item.default}
    assert defaults == {"save-state.prefix": "state", "phemlight-path": "./PHEMlight/"}


@pytest.mark.parametrize("suffix", ["/../../x.xml", "a/b", "\u00e4", "${HOME}"])
def test_an_ending_of_files_is_no_path(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(TownError, match=r"save-state\.suffix> is .* expected letters"):
        configuration(tmp_path, f'<save-state.suffix value="{suffix}"/>')


def test_a_net_is_no_configuration(tmp_path: Path) -> None:
    net = tmp_path / "a.net.xml"
    net.write_text('<?xml version="1.0"?>\n<!-- made -->\n<net version="1"><edge id="a"/></net>', encoding="utf-8")
    with pytest.raises(TownError, match=r"a\.net\.xml: is a net; give the \.sumocfg"):
        read_configuration(net)


def test_every_rule_is_about_an_option_that_sumo_has() -> None:
    assert {rule.option for rule in RULES} <= set(sumo_options())

import math
import sys
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from tests.bridge.sumo.test_session import options
from tests.server.servers import alone
from tests.support.lit_road import CROSSING_LINKS, lit_road
from tests.support.worlds import follow, quick_config
from wcsim.bridge.sumo.session import SumoSession, world_in_this_process
from wcsim.bridge.sumo.step_hook import HookChair
from wcsim.bridge.world import World
from wcsim.core.frames import sumo_from_yaw
from wcsim.errors import HookError
from wcsim.server.links.socket import ProcessSeatLinkGroup
from wcsim.server.specs import WorldBuildSpec
from wcsim.towns.scenario.town import find_town
from wcsim.towns.sumo.net import LaneKind, read_net
from wcsim.types import SeatSpec, StartSpec
from wcsim.types.episode import RunPlace

MODULE = '''
MADE = []

class Signals:
    """Puts up a sign of its own, and keeps what it was told."""

    def __init__(self, libsumo):
        self.libsumo, self.calls, self.chairs = libsumo, [], []
        MADE.append(self)

    def before_step(self, time_s, chairs):
        self.calls.append(("before", time_s))
        self.chairs.append(chairs)
        if len(self.calls) == 1:
            self.libsumo.poi.add("mine", 1.0, 2.0, (255, 0, 0, 255))

    def after_step(self, time_s, chairs):
        self.calls.append(("after", time_s))
        self.chairs.append(chairs)

class Fails:
    def __init__(self, libsumo):
        pass

    def after_step(self, time_s, chairs):
        if time_s > 0.25:
            raise RuntimeError("no more")

class Meddles:
    """Does one of what only wcsim may, at its first call."""

    def __init__(self, libsumo):
        self.libsumo, self.calls = libsumo, 0

    def before_step(self, time_s, chairs):
        self.calls += 1
        if self.calls == 1:
            self.meddle()

class Steps(Meddles):
    def meddle(self):
        self.libsumo.simulationStep()

class Loads(Meddles):
    def meddle(self):
        self.libsumo.load(["-c", self.libsumo.simulation.getOption("configuration-file")])

class Restarts(Meddles):
    def meddle(self):
        self.libsumo.start(["sumo", "-c", self.libsumo.simulation.getOption("configuration-file")])

class Closes(Meddles):
    def meddle(self):
        self.libsumo.close()

class ClosesAfterwards(Closes):
    before_step = None

    def after_step(self, time_s, chairs):
        Meddles.before_step(self, time_s, chairs)

class LoadsAtOnce(Loads):
    def __init__(self, libsumo):
        self.libsumo = libsumo
        self.meddle()

class Wrong:
    def __init__(self, libsumo):
        pass

class CannotBeMade:
    def __init__(self):
        pass

    before_step = None
    def after_step(self, time_s, chairs):
        pass
'''


@pytest.fixture
def signals(tmp_path, monkeypatch):
    """A module of the user's own, in the folder where wcsim is started."""
    name = f"signals_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return name


def world(corner, hook: str, *specs: SeatSpec) -> World:
    return World(find_town(str(corner)), quick_config(), specs, 1, RunPlace(hook=hook))


def test_a_hook_is_called_around_every_step_with_libsumo(corner, signals):
    with world(corner, f"{signals}:Signals") as here:
        for _ in range(3):
            here.tick(())
        (hook,) = sys.modules[signals].MADE
        times = [0.0, 0.1, 0.1, 0.2, 0.2, 0.3]
        assert [name for name, _ in hook.calls] == ["before", "after"] * 3
        assert [time_s for _, time_s in hook.calls] == pytest.approx(times)
        assert hook.libsumo.poi.getIDList() == ("mine",)
        assert hook.chairs == [()] * 6
        here.rebuild(2)
        here.tick(())
        assert len(sys.modules[signals].MADE) == 2  # traffic made anew meets a hook made anew
        assert sys.modules[signals].MADE[1].calls[0] == ("before", 0.0)
        assert len(hook.calls) == 6  # the drain step before a reload is none of the hook's business


def test_a_hook_is_told_of_the_chairs_before_the_step_in_the_coordinates_of_the_net(corner, signals):
    start = StartSpec(p_W_m=(-20.0, 5.0), yaw_rad=0.0, goal_W_m=(20.0, -5.0))
    with world(corner, f"{signals}:Signals", SeatSpec(start=start, profile="competent")) as here:
        plants = [here.snapshot.clients[0].plant]
        for _ in range(30):
            plants.append(follow(here).clients[0].plant)
        told = sys.modules[signals].MADE[0].chairs
        assert [len(chairs) for chairs in told] == [1] * 60
        origin_m, lanes = np.array(here.town.file.origin_m), read_net(here.town.net).lanes(*LaneKind)
    for k, plant in enumerate(plants[:-1]):
        chair = told[2 * k][0]
        assert chair is told[2 * k + 1][0] and chair.seat == 0 and chair.button_tls_id == ""
        assert chair.p_net_m[:2] == pytest.approx(plant.p_WB_m[:2] + origin_m)
        assert (chair.speed_mps, chair.angle_deg) == pytest.approx((plant.v_B_mps[0], sumo_from_yaw(plant.yaw_rad)))
        assert chair.way_net_m[0] == chair.p_net_m[:2]
        assert chair.way_net_m[-1] == pytest.approx(origin_m + start.goal_W_m, abs=1.5)
        assert 0.0 < np.hypot(*np.subtract(chair.way_net_m[1], chair.way_net_m[0])) < 3.0
    assert plants[-2].v_B_mps[0] > 0.3  # it has driven
    assert len(told[-1][0].way_net_m) < len(told[0][0].way_net_m)
    kinds = [next(lane.kind for lane in lanes if lane.edge_id == name) for name in told[0][0].edges]
    assert kinds[0] is LaneKind.SIDEWALK and kinds[-1] is LaneKind.SIDEWALK and LaneKind.CROSSING in kinds


def test_a_failing_hook_is_named_with_its_line(corner, signals):
    with (
        world(corner, f"{signals}:Fails") as here,
        pytest.raises(HookError, match=rf"{signals}:Fails.*no more.*line 27"),
    ):
        for _ in range(5):
            here.tick(())


@pytest.mark.parametrize("chairs", [0, 1])
@pytest.mark.parametrize("name", ["Steps", "Loads", "Restarts", "Closes", "ClosesAfterwards", "LoadsAtOnce"])
def test_a_hook_that_does_what_only_wcsim_may_is_named(corner, signals, name, chairs):
    said = rf"'{signals}:{name}' stepped, loaded or closed the simulation in (before_step|after_step|__init__); "
    with pytest.raises(HookError, match=said), world(corner, f"{signals}:{name}", *[SeatSpec()] * chairs) as here:
        follow(here)
    assert not world_in_this_process()


@pytest.mark.parametrize(
    "name, says",
    [
        ("{}:Wrong", "neither before_step nor after_step"),
        ("{}:Nobody", "no class 'Nobody'"),
        ("{}:CannotBeMade", "failed in __init__"),
        ("{}", "not module:Class"),
        ("no_such_module_here:X", "was not found"),
    ],
)
def test_a_hook_that_cannot_be_made_is_refused_and_leaves_no_world(corner, signals, name, says):
    with pytest.raises(HookError, match=says):
        world(corner, name.format(signals))
    assert not world_in_this_process()


def test_a_world_in_another_process_runs_the_hook_too(corner, signals):
    order = WorldBuildSpec(town=str(corner), config=quick_config(), seat=SeatSpec(), seed=1, hook=f"{signals}:Fails")
    with alone(ProcessSeatLinkGroup(order)) as link:
        snapshot = link.join()
        with pytest.raises(HookError, match="no more"):
            for _ in range(5):
                snapshot = link.act(snapshot.tick, snapshot.user)


def test_the_example_turns_every_light_red_and_back(monkeypatch):
    monkeypatch.chdir(Path(__file__).parents[3] / "examples")
    place = RunPlace(hook="own_signals:AllRedAtTimes")
    with World(find_town("monaco"), quick_config("world.tick_s=0.2"), (), 1, place) as here:
        here.tick(())
        red = {light.colours for light in here.sumo.signals(np.zeros((1, 2)), math.inf)}
        assert red and set("".join(red)) == {"r"}
        for _ in range(80):
            here.tick(())
        assert set("".join(light.colours for light in here.sumo.signals(np.zeros((1, 2)), math.inf))) > {"r"}


def test_the_example_keeps_a_crossing_green_while_a_chair_is_on_it(tmp_path, monkeypatch):
    road = lit_road(tmp_path, "static").folder
    monkeypatch.chdir(Path(__file__).parents[3] / "examples")
    chair = HookChair(
        seat=0, p_net_m=(0.0, 0.0, 0.0), angle_deg=0.0, speed_mps=0.0, way_net_m=((0.0, 0.0),), edges=(":C_c0",),
        button_tls_id="",
    )  # fmt: skip

    def green_steps(chairs) -> int:
        with SumoSession(replace(options(road), hook="own_signals:GreenForChairs")) as sumo:
            seen = []
            for _ in range(1000):
                sumo.step(lambda: chairs)
                seen.append(sumo.signals(np.zeros((1, 2)), 500.0)[0].colours[CROSSING_LINKS[0]])
        return next(len(list(steps)) for shown, steps in groupby(seen) if shown in "gG")

    usual = green_steps(())
    assert usual == 50 and green_steps((chair,)) == 200
    assert green_steps((replace(chair, edges=("WC",)),)) == usual

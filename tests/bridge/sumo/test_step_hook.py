from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.support.worlds import quick_config
from wcsim.bridge.sumo.run_place import RunPlace
from wcsim.bridge.sumo.session import world_in_this_process
from wcsim.bridge.world import World
from wcsim.errors import HookError
from wcsim.server.links.child_world import ProcessLink
from wcsim.server.specs import WorldOrder
from wcsim.towns.scenario.town import find_town
from wcsim.types import SeatSpec

MODULE = '''
MADE = []

class Signals:
    """Puts up a sign of its own, and keeps what it was told."""

    def __init__(self, libsumo):
        self.libsumo, self.calls = libsumo, []
        MADE.append(self)

    def before_step(self, time_s):
        self.calls.append(("before", time_s))
        if len(self.calls) == 1:
            self.libsumo.poi.add("mine", 1.0, 2.0, (255, 0, 0, 255))

    def after_step(self, time_s):
        self.calls.append(("after", time_s))

class Fails:
    def __init__(self, libsumo):
        pass

    def after_step(self, time_s):
        if time_s > 0.25:
            raise RuntimeError("no more")

class Wrong:
    def __init__(self, libsumo):
        pass

class CannotBeMade:
    def __init__(self):
        pass

    before_step = None
    def after_step(self, time_s):
        pass
'''


@pytest.fixture
def signals(tmp_path, monkeypatch):
    """A module of the user's own, in the folder where wcsim is started."""
    name = f"signals_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return name


def world(corner, hook: str) -> World:
    return World(find_town(str(corner)), quick_config(), (), 1, RunPlace(hook=hook))


def test_a_hook_is_called_around_every_step_with_libsumo(corner, signals):
    import sys

    with world(corner, f"{signals}:Signals") as here:
        for _ in range(3):
            here.tick(())
        (hook,) = sys.modules[signals].MADE
        times = [0.0, 0.1, 0.1, 0.2, 0.2, 0.3]
        assert [name for name, _ in hook.calls] == ["before", "after"] * 3
        assert [time_s for _, time_s in hook.calls] == pytest.approx(times)
        assert hook.libsumo.poi.getIDList() == ("mine",)
        here.rebuild(2)
        here.tick(())
        assert len(sys.modules[signals].MADE) == 2  # traffic made anew meets a hook made anew
        assert sys.modules[signals].MADE[1].calls[0] == ("before", 0.0)
        assert len(hook.calls) == 6  # the drain step before a reload is none of the hook's business


def test_a_failing_hook_is_named_with_its_line(corner, signals):
    with (
        world(corner, f"{signals}:Fails") as here,
        pytest.raises(HookError, match=rf"{signals}:Fails.*no more.*line 25"),
    ):
        for _ in range(5):
            here.tick(())


@pytest.mark.parametrize(
    ("name", "says"),
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
    order = WorldOrder(town=str(corner), config=quick_config(), seat=SeatSpec(), seed=1, hook=f"{signals}:Fails")
    with ProcessLink(order) as link:
        snapshot = link.join()
        with pytest.raises(HookError, match="no more"):
            for _ in range(5):
                snapshot = link.act(snapshot.tick, snapshot.user)


def test_the_example_turns_every_light_red_and_back(monkeypatch):
    monkeypatch.chdir(Path(__file__).parents[3] / "examples")
    place = RunPlace(hook="own_signals:AllRedAtTimes")
    with World(find_town("monaco"), quick_config("world.tick_s=0.2"), (), 1, place) as here:
        here.tick(())
        red = {light.colours for light in here._sumo.signals(np.zeros((1, 2)), math.inf)}
        assert red and set("".join(red)) == {"r"}
        for _ in range(80):
            here.tick(())
        assert set("".join(light.colours for light in here._sumo.signals(np.zeros((1, 2)), math.inf))) > {"r"}

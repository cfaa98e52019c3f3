"""The ground of nets that nobody would draw, and of those that others made."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.towns.made.nets import (
    DRIVE,
    PAVED,
    WALK,
    WAYS,
    assert_sound,
    edge,
    generated,
    ground_of,
    hilly,
    lane,
    spiral,
    street,
    write_net,
)
from wcsim.towns.ground.relief import fit_relief, on_land
from wcsim.towns.ground.surfaces import make_surfaces
from wcsim.towns.sumo.net import read_net
from wcsim.types.street import ClassId

BOW_TIE = edge(":w0", lane("60,-4 66,4 66,-4 60,4", WALK, "2.0"), function="walkingarea")
RING = " ".join(f"{30 + 12 * math.cos(a):.2f},{30 + 12 * math.sin(a):.2f}" for a in np.linspace(0.0, 2 * math.pi, 25))
ODD = {
    "zero length": (street(), edge("z", lane("10,20 10,20", WALK, "2.0"), lane("10,23 10,23 10,23"))),
    "one point": (street(), edge("p", lane("10,20", WALK)), edge(":x", lane("", WALK), function="walkingarea")),
    "bow tie": (street(), BOW_TIE),
    "one on the other": (street(), street("t"), street("u", 1.0), edge("v", lane("0,1 60,1", WALK, "2.0"))),
    "half a metre": (street(), edge("n", lane("0,20 60,20", DRIVE, "0.5"), lane("0,24 60,24", WALK, "0.5"))),
    "widths that are none": (edge("w", lane("0,0 50,0"), lane("0,4 50,4", DRIVE, "-1"), lane("0,9 50,9", WALK, "0")),),
    "no shape": (street(), '<junction id="a" type="priority" x="0" y="0"/>', '<junction id="b" shape="1,1 2,2"/>'),
    "roundabout": (street(), edge("r", lane(RING), lane(RING, WALK, "2.0")), street("q", 30.0, 20.0)),
    "hairpin": (edge("h", lane("0,0 40,0 0,2 40,4 0,6"), lane("0,-4 40,-4 0,-2", WALK, "2.0")),),
    "far away": (street("f", 5_334_567.89),),
    "rails": (street(), edge("rail", lane("0,12 60,12", 'allow="tram"'), lane("0,3.2 60,3.2", 'allow="tram rail"'))),
}


@pytest.mark.parametrize("name", list(ODD))
def test_odd_nets_have_sound_ground(name: str, tmp_path: Path) -> None:
    assert_sound(write_net(tmp_path, *ODD[name]))


@pytest.mark.parametrize(
    "options",
    [
        ("--grid", "--grid.number", "3", "--grid.length", "60", "-L", "3", *PAVED),
        ("--grid", "--grid.number", "3", "--grid.length", "70", "--lefthand", *PAVED),
        ("--spider", "--spider.arm-number", "5", "--spider.circle-number", "2", *PAVED),
        ("--rand", "--rand.iterations", "15", "--seed", "3", *PAVED),
    ],
    ids=["three lanes", "left hand", "spider", "random"],
)
def test_nets_of_netgenerate_have_sound_ground(options: tuple[str, ...], tmp_path: Path) -> None:
    assert_sound(generated(tmp_path, *options))


@pytest.mark.parametrize("steep", [False, True])
def test_a_net_that_is_built_in_blocks_has_no_seams(steep: bool, tmp_path: Path) -> None:
    length = "--grid.x-length", "683", "--grid.y-length", "41.7"
    net = generated(tmp_path, "--grid", "--grid.x-number", "3", "--grid.y-number", "3", *length, *PAVED)
    if steep:
        lifted = hilly(
            tmp_path / "made.net.xml", tmp_path / "hill.net.xml", lambda x, y: 0.05 * x + 3.0 * math.sin(x / 50)
        )
        net = read_net(lifted)
    assert_sound(net, fit_relief(net))


@pytest.mark.proof
@pytest.mark.parametrize("seed", range(12))
def test_many_random_nets_have_sound_ground(seed: int, tmp_path: Path) -> None:
    more = ("--rand.min-angle", "20") if seed % 2 else ("--default.lanenumber", "2")
    assert_sound(generated(tmp_path, "--rand", "--rand.iterations", "50", "--seed", str(seed), *more, *PAVED))


@pytest.mark.proof
@pytest.mark.shared
@pytest.mark.parametrize("name", ["acosta_peds", "acosta_buslanes"])
def test_a_net_of_others_has_sound_ground(name: str, shared: Path) -> None:
    assert_sound(read_net(shared / "towns" / "nets" / "bologna_acosta" / f"{name}.net.xml"))


def test_a_ramp_over_itself_is_ground_once(tmp_path: Path) -> None:
    net = write_net(tmp_path, spiral(), street(y=-40.0))
    relief = fit_relief(net)
    kept = on_land(net, relief)
    assert_sound(kept, relief)
    assert relief.z_m.max() - relief.z_m.min() < 8.0  # the upper turns are no hill


def test_rails_of_their_own_are_no_road(tmp_path: Path) -> None:
    net = write_net(tmp_path, *ODD["rails"])
    surfaces = make_surfaces(net, WAYS)
    assert surfaces.rail.area == pytest.approx(60 * 3.2, rel=0.02)  # the other track lies in the carriageway
    ground = ground_of(net)
    assert ground.low[ground.face_class == ClassId.RAIL_TRACK].all()


def test_a_small_loop_of_road_is_filled_and_a_large_one_or_an_island_of_pavement_is_not(tmp_path: Path) -> None:
    ring = "0,0 {0},0 {0},{0} 0,{0} 0,0"
    for size_m, holes in ((12, 0), (40, 1)):
        net = write_net(tmp_path, street(y=-30), edge("loop", lane(ring.format(size_m))))
        assert sum(len(part.interiors) for part in make_surfaces(net, WAYS).low.geoms) == holes
    island = edge("island", lane("4,6 8,6", WALK, "3.0"))
    net = write_net(tmp_path, edge("loop", lane(ring.format(12))), island)
    assert make_surfaces(net, WAYS).pavement.area > 8.0

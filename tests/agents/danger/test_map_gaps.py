"""How near each joystick position comes to what the chair's own street map shows."""

from __future__ import annotations

import numpy as np
import pytest

from tests.agents.danger.test_street_map import AHEAD, CONFIG, ON_ONE_SIDE, observation, off_in_a_mirror
from tests.agents.policies.test_baselines import box
from wcsim.agents.danger.map_gaps import FAR_CELLS, STANDS, discs_of, distances, in_the_way
from wcsim.agents.danger.network import DangerNet, DangerSpec
from wcsim.agents.danger.roll_outs import GAP, MOVER_GAP, TOUCH
from wcsim.agents.danger.sight import DangerSight, Eye
from wcsim.agents.danger.street_map import CELL_M, HIGHEST, LOWEST, OWN_PLANES, PLANES, SIDE, TRAIL
from wcsim.config import RunConfig, parse, with_overrides
from wcsim.config.run_file import DangerNetFile
from wcsim.errors import ConfigError
from wcsim.supervisor.actions import action_set
from wcsim.types import ClassId

OWN = with_overrides(CONFIG, ("danger.gaps=map", "danger.rival=false"))
BACK = action_set("square81").nearest((0.0, -1.0))


def looked(surface, kind=0, speed=1.0) -> DangerSight:
    return Eye(OWN).look(observation(surface, speed=speed, kind=kind))


def street(**planes: np.ndarray) -> np.ndarray:
    picture = np.zeros((PLANES, SIDE, SIDE), np.uint8)
    picture[[HIGHEST, LOWEST]] = 85
    for name, where in planes.items():
        picture[{"high": HIGHEST, "low": LOWEST, "trail": TRAIL}[name]] = where
    return picture


def blocked(picture: np.ndarray) -> np.ndarray:
    cells = np.empty((2, SIDE, SIDE), np.int32)
    in_the_way(picture, cells)
    return cells == 0


def test_the_way_into_a_wall_is_close_and_the_way_back_is_not():
    near, far = (looked(box(x, 6.0, -3, 3, 0, 2)) for x in (1.3, 4.5))
    assert near.actions[AHEAD, GAP] < 80 < far.actions[AHEAD, GAP] == 255
    assert near.actions[AHEAD, TOUCH] < 255 == far.actions[AHEAD, TOUCH]
    assert near.actions[BACK, GAP] > near.actions[AHEAD, GAP]
    assert not near.picture[OWN_PLANES:].any(), "what the rival remembers is not asked for"


def test_people_count_as_what_moves():
    person = box(1.5, 1.8, -0.2, 0.2, 0, 1.7)
    stands, moves = looked(person), looked(person, kind=ClassId.PERSON)
    assert stands.actions[AHEAD, GAP] < 80 and stands.actions[AHEAD, MOVER_GAP] == 255
    assert moves.actions[AHEAD, MOVER_GAP] < 80 and moves.actions[AHEAD, GAP] == 255


def test_level_ground_and_ramps_are_free_and_both_sides_of_a_kerb_meet_its_upper_edge():
    ramp = 85 + 2 * np.arange(SIDE, dtype=np.uint8)[:, None].repeat(SIDE, 1)
    assert not blocked(street()).any() and not blocked(street(high=ramp, low=ramp)).any()
    kerb = np.where(np.arange(SIDE) < 20, 115, 85)[None].repeat(SIDE, 0)
    found = blocked(street(high=kerb, low=kerb))[STANDS]
    assert found[30, 19] and found[30].sum() == 1
    kerb[:, 20:23] = 0  # hidden behind the edge
    assert blocked(street(high=kerb, low=kerb))[STANDS][30, 19]
    kerb[:, 20:26] = 0
    assert not blocked(street(high=kerb, low=kerb)).any(), "too far apart to tell a kerb from a slope"


def test_distances_are_those_of_the_nearest_cell():
    rng = np.random.default_rng(0)
    cells = np.where(rng.random((SIDE, SIDE)) < 0.004, 0, FAR_CELLS).astype(np.int32)
    rows, columns = np.nonzero(cells == 0)
    i, j = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    wanted = np.sqrt(((i[..., None] - rows) ** 2 + (j[..., None] - columns) ** 2).min(-1))
    out = np.empty((SIDE, SIDE))
    assert distances(cells, out)
    assert np.allclose(out, CELL_M * np.minimum(wanted, FAR_CELLS))
    assert not distances(np.full((SIDE, SIDE), FAR_CELLS, np.int32), out)


def test_discs_fill_the_outline():
    rear, front, half = chair = Eye(OWN).around.box_B_m
    x, y = np.meshgrid(np.linspace(rear, front, 60), np.linspace(-half, half, 40))
    edge = (x == rear) | (x == front) | (np.abs(y) == half)
    discs = discs_of(chair)
    away = np.hypot(x[..., None] - discs[:, 0], y[..., None] - discs[:, 1]) - discs[:, 2]
    assert away.min(-1).max() < 0.06 and (away.min(-1)[edge] > -1e-9).all(), "inside the outline, and nearly all of it"


@ON_ONE_SIDE
def test_left_and_right_change_places_as_they_should(surface):
    mirrored, same = off_in_a_mirror(lambda street: looked(street, speed=0.8), surface)
    assert (mirrored < 1.0).all() and (same > 20.0).all()


def test_true_and_false_of_before_mean_the_rival_and_nothing():
    for said, meant in (("true", "rival"), ("false", "none"), ("map", "map")):
        assert with_overrides(RunConfig(), (f"danger.gaps={said}",)).danger.gaps == meant
    old = {"roll_out": True, "gaps": True, "rival": True, "context": True, "width": 20, "actions": "square81"}
    assert parse(DangerNetFile, old, "policy.json").gaps == "rival"
    with pytest.raises(ConfigError, match=r"danger\.gaps.*'map'"):
        with_overrides(RunConfig(), ("danger.gaps=dwa",))


def test_a_network_sees_as_it_was_made_to_whatever_the_test_says():
    import torch

    from wcsim.agents.danger.policy import DangerPolicy
    from wcsim.agents.danger.rule import DangerRule

    net = DangerNet(DangerSpec(gaps="map", rival=False), torch.as_tensor(action_set("square81").points))
    policy = DangerPolicy("own", net, CONFIG, DangerRule())
    seen = observation(box(1.3, 6.0, -3, 3, 0, 2), speed=1.0)
    assert (policy._eye.look(seen).actions == looked(box(1.3, 6.0, -3, 3, 0, 2)).actions).all()

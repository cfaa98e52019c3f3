"""Families of scenes: a seed always writes the same, every street builds, and each holds the danger that it says."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from wcsim.bridge.world_rollout import rollout
from wcsim.core import seeding
from wcsim.errors import ConfigError, DiskFullError
from wcsim.scenes.run import _open_scene, play
from wcsim.towns.scene_folders.build import _scene_of
from wcsim.towns.scene_folders.draft import Push, mirrored, predict_path
from wcsim.towns.scene_folders.families import FAMILIES, TRAINED, _scooter_cuts_in, family_of, write_scene
from wcsim.types import ClassId
from wcsim.types.chair import AT_REST

LONGEST_S = 25.0
# family: a seed, why the episode of a follower ends, and with whom ("" for kerbs and walls)
MEANT = {
    "bus-at-corner": (1, "collision", "v:bus"),
    "car-door": (0, "collision", "v:door"),
    "footplate-swing": (0, "collision", ""),
    "oncoming-pair": (0, "collision", "p:left"),
    "out-of-place": (0, "collision", ""),
    "overtaking-rider": (0, "collision", "v:rider"),
    "person-turns-round": (2, "collision", "p:walker"),
    "person-turns-round-2": (0, "collision", "p:walker"),
    "reversing-off-kerb": (0, "drop", ""),
    "scooter-cuts-in": (0, "collision", "v:rider"),
    "turning-beside-drop": (0, "drop", ""),
    "twisted-ramp": (0, "drop", ""),
}
MEANT |= {f"{name}-near": (0, *MEANT[name][1:]) for name in TRAINED}
MEANT |= {"oncoming-pair-near": (1, "collision", "p:left"), "out-of-place-near": (3, "collision", "")}


@pytest.fixture(autouse=True)
def own_cache() -> None:
    """None: these scenes are those of every run, and their streets are kept until what makes them changes."""


def texts(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize("family", FAMILIES)
def test_a_seed_writes_the_same_bytes_and_another_one_others(family: str, tmp_path: Path) -> None:
    once, again, other = (
        texts(write_scene(family, seed, tmp_path / name)) for name, seed in (("a", 3), ("b", 3), ("c", 7))
    )
    assert once == again
    changed = {name for name in once if once[name] != other.get(name)}
    assert {"scene.toml", "stick.csv"} <= changed
    assert "street.nod.xml" in changed or "street.typ.xml" in changed


@pytest.mark.parametrize("family", FAMILIES)
def test_both_sides_and_short_scenes_are_drawn(family: str, tmp_path: Path) -> None:
    scenes = [_scene_of(write_scene(family, seed, tmp_path / str(seed))) for seed in range(12)]
    assert {scene.lefthand for scene in scenes} == {False, True}
    assert max(scene.duration_s for scene in scenes) <= LONGEST_S
    assert len({scene.seed for scene in scenes}) == len(scenes)


def first_crash(world, scene):
    """The client at its first crash."""
    ticks = (step.after.clients[0] for step in play(world, scene))
    return next(client for client in ticks if client.events.crashed)


@pytest.mark.parametrize("family", FAMILIES)
def test_who_only_follows_from_a_start_on_pavement_meets_the_danger_that_is_meant(family: str, tmp_path: Path) -> None:
    seed, reason, partner = MEANT[family]
    with _open_scene(write_scene(family, seed, tmp_path / "scene")) as (world, scene):
        start_m = np.array(scene.seats[0].start_m)
        ground = ClassId.ROAD if family.startswith("out-of-place") else ClassId.SIDEWALK
        assert int(world.street.grid.class_at(start_m)) == ground
        assert float(world.street.grid.clearance_at(start_m)) > 0.3
        end = first_crash(world, scene)
    assert end.events.crash_reason == reason
    assert {contact.actor_id for contact in end.contacts} <= {partner}
    assert bool(end.contacts) == (reason == "collision")


@pytest.mark.parametrize(
    "seed, where, ground, reason, partner",
    [
        (2, "in the gutter", ClassId.ROAD, "collision", ""),
        (3, "in a drive", ClassId.GROUND, "drop", ""),
        (5, "on grass", ClassId.TERRAIN, "drop", ""),
        (13, "on the road, against a rider", ClassId.ROAD, "collision", "v:rider"),
        (24, "on a cycle path, against a rider", ClassId.ROAD, "collision", "v:rider"),
    ],
)
def test_where_a_chair_does_not_belong_its_stick_leads_into_danger(seed, where, ground, reason, partner, tmp_path):
    with _open_scene(write_scene("out-of-place", seed, tmp_path / "scene")) as (world, scene):
        assert f" is {where}, " in scene.shows
        assert int(world.street.grid.class_at(np.array(scene.seats[0].start_m))) == ground
        end = first_crash(world, scene)
    assert end.events.crash_reason == reason and {contact.actor_id for contact in end.contacts} <= {partner, ""}


def test_who_stops_dead_in_front_of_a_chair_stays_there(tmp_path):
    with _open_scene(write_scene("person-turns-round-2", 0, tmp_path / "scene")) as (world, scene):
        ticks = islice(rollout(world, {0: lambda now: AT_REST}), round(scene.duration_s / world.config.world.tick_s))
        places_m = np.array([actor.p_W_m[:2] for tick in ticks for actor in tick.after.actors])
    steps_m = np.hypot(*np.diff(places_m, axis=0).T)
    assert len(places_m) > 100 and steps_m[:30].mean() > 0.05
    assert steps_m.max() < 0.2 and steps_m[-60:].max() < 0.002 and np.ptp(places_m[:, 1]) < 0.02


def test_another_family_takes_its_share_and_moves_no_other(monkeypatch):
    before = [family_of(seed) for seed in range(600)]
    monkeypatch.setattr("wcsim.towns.scene_folders.families.TRAINED", (*TRAINED, "a-new-one"))
    after = [family_of(seed) for seed in range(600)]
    taken = [new == "a-new-one" for new in after]
    assert [new for new, out in zip(after, taken, strict=True) if not out] == [
        old for old, out in zip(before, taken, strict=True) if not out
    ]
    assert 20 < sum(taken) < 100 and set(before) == set(TRAINED)


def test_trainings_draw_no_scene_of_a_family_that_is_held_out():
    held = {"bus-at-corner", "overtaking-rider"}
    assert held < set(FAMILIES) and not held & set(TRAINED)


def test_a_mirror_turned_over_twice_changes_nothing() -> None:
    draft = _scooter_cuts_in(seeding.make_rng(1, "mirror"))
    other = mirrored(draft)
    assert other.place.edges != draft.place.edges
    assert other.lefthand
    back = mirrored(other)
    assert back.place.nodes == draft.place.nodes
    assert back.place.edges.count(",-") == draft.place.edges.count(",-")
    assert replace(back, place=draft.place) == draft


def test_where_a_stick_leads() -> None:
    straight = predict_path((1.0, 2.0), 0.0, (Push(0.0, 0.0, 0.5),), 4.0)
    assert straight[-1, 1:].tolist() == pytest.approx([1.0, 4.6, np.pi / 2], abs=0.3)
    assert straight[4, 2] == 2.0, "it obeys late"
    turned = predict_path((0.0, 0.0), 90.0, (Push(0.0, -0.5, 0.0), Push(2.0, 0.0, 0.0)), 3.0)
    assert turned[-1, 3] > 0.8
    assert np.abs(turned[:, 1:3]).max() < 1e-9


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"unknown family of scenes 'car-dor'.*did you mean 'car-door'"):
        write_scene("car-dor", 1, tmp_path / "a")
    with pytest.raises(ConfigError, match="seed -1 cannot be used"):
        write_scene("car-door", -1, tmp_path / "a")
    write_scene("car-door", 1, tmp_path / "a")
    with pytest.raises(ConfigError, match="already exists"):
        write_scene("car-door", 1, tmp_path / "a")
    (tmp_path / "file").write_text("")
    with pytest.raises(DiskFullError, match="could not be written"):
        write_scene("car-door", 1, tmp_path / "file" / "a")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "file"]

import re
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from tests.support.samples import ACTIONS
from tests.support.worlds import dqn_config
from wcsim.agents.rounds.drive_segment import (
    HINDSIGHT_S,
    OFF_WAY_STEPS,
    SegmentOrder,
    _DataDriver,
    _draw_variant,
    _is_of_scenes,
    _iter_world_setups,
    _town_index,
    drive_segment,
    require_recordable,
)
from wcsim.agents.runs.data_folder import (
    FOLLOW,
    ORACLE,
    RECKLESS,
    SAFE,
    DrivingSegment,
    DrivingSegmentKey,
    crash_times_to_codes,
)
from wcsim.bridge.world import World
from wcsim.config import CollectConfig, RunConfig, resolve
from wcsim.errors import ConfigError
from wcsim.supervisor.observation import make_observation
from wcsim.supervisor.oracle import CrashOracle
from wcsim.types import F64, Command, Joystick, Verdict

KEY = DrivingSegmentKey(run=5, round=0, index=0)


def order_in(corner: Path, *overrides: str, key: DrivingSegmentKey = KEY) -> SegmentOrder:
    varied = 'collect.variants=["vary.action_delay_ticks=[0,2]"]'
    shares = ("collect.scene_share=0", "collect.off_way_share=0")
    config = dqn_config("collect.ticks=40", "collect.chairs=2", *shares, varied, *overrides)
    return SegmentOrder(key=key, towns=(str(corner),), config=config)


@pytest.fixture(scope="module")
def segment(corner: Path) -> DrivingSegment:
    return drive_segment(order_in(corner, "collect.episode_steps=15"), None)


def test_every_chair_has_a_row_for_every_tick(segment: DrivingSegment):
    assert len(segment) == 80
    assert segment.ended.sum() >= 6 and segment.ended[39] and segment.ended[79]
    assert segment.depth.shape == (80, 24, 32) and segment.visible.shape == (80, 81)
    assert set(segment.delay.tolist()) <= {0, 1, 2}
    assert set(segment.driver.tolist()) <= {FOLLOW, ORACLE, RECKLESS}


def test_the_same_key_gives_the_same_segment_and_another_another(corner: Path, segment: DrivingSegment):
    again = drive_segment(order_in(corner, "collect.episode_steps=15"), None)
    assert all((column == again.arrays()[name]).all() for name, column in segment.arrays().items())
    other = drive_segment(
        order_in(corner, "collect.episode_steps=15", key=DrivingSegmentKey(run=5, round=0, index=1)), None
    )
    assert not np.array_equal(other.stick, segment.stick)


def test_a_share_of_the_chairs_begins_off_the_way_and_is_pushed(corner: Path):
    orders = (order_in(corner, f"collect.off_way_share={share}", "collect.ticks=130") for share in (0, 1))
    usual, pushed = (drive_segment(order, None) for order in orders)
    assert pushed.ended.sum() >= 2 * (130 // OFF_WAY_STEPS) > usual.ended.sum()
    assert pushed.wish[:, 1].mean() > 0.6 > usual.wish[:, 1].mean()
    assert (pushed.visible != SAFE).any(axis=1).mean() > 1.5 * (usual.visible != SAFE).any(axis=1).mean()


def test_who_learns_from_crashes_asks_no_oracle_and_drives_in_the_same_world(corner: Path):
    words = ("collect.ticks=60", "collect.follow_share=1", "collect.astray_spread=0.9", "collect.astray_ticks=[10,40]")
    judged, alone = (
        drive_segment(order_in(corner, *words, f"danger.teacher={name}"), None) for name in ("truth", "crashes")
    )
    assert alone.visible.shape == alone.truth.shape == (120, 0)
    same = {name: column for name, column in alone.arrays().items() if name not in ("visible", "truth")}
    assert all((column == judged.arrays()[name]).all() for name, column in same.items())
    assert set(alone.driver.tolist()) == {FOLLOW, RECKLESS} and not (alone.own & ~alone.crashed).any()


def test_an_oracle_that_would_drive_is_refused_where_crashes_teach():
    with pytest.raises(ConfigError, match=r"follow_share=0\.4 lets the oracle drive; expected 1"):
        require_recordable(dqn_config("danger.teacher=crashes"))
    with pytest.raises(ConfigError, match=r"reward\.crash=0; expected more"):
        require_recordable(dqn_config("danger.teacher=returns", "collect.follow_share=1", "reward.crash=0"))
    two = dqn_config('env.camera=["front","rear"]')
    require_recordable(two)
    for words in ('env.camera=["rear","front"]', "cameras.1.width_px=40"):
        with pytest.raises(ConfigError, match="in their order, of one width_px"):
            require_recordable(resolve(two, words))
    with pytest.raises(ConfigError, match="expected the shorter time first"):
        dqn_config("collect.astray_ticks=[12,4]")


def test_scenes_are_driven_in_their_share(corner: Path, tmp_path: Path):
    config = resolve(RunConfig(), ("collect.scene_share=0.25", "collect.segments=4"))
    keys = [DrivingSegmentKey(run=0, round=r, index=i) for r in range(2) for i in range(4)]
    assert [_is_of_scenes(config, key) for key in keys].count(True) == 2
    place = next(_iter_world_setups(order_in(corner, "collect.scene_share=1"), tmp_path))
    assert len(place.seats) == 1 and place.seats[0].profile.startswith("recorded:")


def test_streets_are_driven_in_each_town_in_turn_also_with_scenes_between_and_over_rounds(corner: Path, tmp_path: Path):
    towns = []
    for name in ("a", "b", "c"):
        copytree(corner, tmp_path / name)
        towns.append(str(tmp_path / name))
    order = order_in(corner, "collect.scene_share=0.5", "collect.segments=3")
    keys = [DrivingSegmentKey(run=5, round=n, index=k) for n in range(4) for k in range(3)]
    streets = [key for key in keys if not _is_of_scenes(order.config, key)]
    places = [next(_iter_world_setups(replace(order, key=key, towns=tuple(towns)), tmp_path)) for key in streets]
    driven = [place.town.folder.name for place in places]
    assert sorted(driven[:3]) == ["a", "b", "c"] and driven[3:] == driven[:3]
    firsts = {_town_index(order.config, DrivingSegmentKey(run=run, round=0, index=0), 3) for run in range(30)}
    assert firsts == {0, 1, 2}, "many short runs leave no town out"


def test_variants_are_drawn_by_key():
    config = resolve(RunConfig(), 'collect.variants=["a=1 b=2", "c=3"]')
    drawn = {_draw_variant(config, DrivingSegmentKey(run=0, round=0, index=index)) for index in range(20)}
    assert drawn == {("a=1", "b=2"), ("c=3",)}
    assert _draw_variant(RunConfig(), KEY) == ()


@pytest.mark.parametrize(
    "variant, told",
    [
        ("world.attention_share=0.7 cameras.0.width=3", "unknown key"),
        ("vary.action_delay_ticks=[0, 2]", "no blanks within a value"),
        ("world.attention_share=2", "less than or equal to 1"),
        ("env.actions=stick", "unknown action set 'stick'"),
    ],
)
def test_a_variant_that_cannot_be_used_is_named_before_anything_is_driven(variant: str, told: str):
    usable = "vary.action_delay_ticks=[0,2] world.attention_share=0.7"
    config = dqn_config(f'collect.variants=["{usable}", "{variant}"]')
    with pytest.raises(ConfigError, match=f"variants: '{re.escape(variant)}' cannot be used.*{told}"):
        require_recordable(config)
    require_recordable(dqn_config(f'collect.variants=["{usable}"]'))


class Recorder:
    """A network that always answers the same, and writes down what it is told."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def reset(self) -> None:
        self.calls.append("reset")

    def choose(self, observation: object) -> int:
        self.calls.append("choose")
        return 3

    def observe(self, observation: object) -> None:
        self.calls.append("observe")

    def sent(self, action: int) -> None:
        self.calls.append(f"sent {action}")


def test_a_network_is_told_what_is_sent_in_its_place():
    learned = Recorder()
    settings = CollectConfig(network_share=1.0, astray_share=0.5)
    driver = _DataDriver(settings, ACTIONS, np.random.default_rng(0), learned)
    stick = np.array([0.0, 1.0], np.float32)
    said = Verdict(danger=False, first_s=np.full(81, np.inf))
    chosen = [driver.choose({"joystick": stick}, said) for _ in range(300)]
    reckless = [choice for choice in chosen if choice["driver"] == RECKLESS]
    assert 10 < len(reckless) < 150
    assert all(choice["action"] == ACTIONS.nearest(choice["wish"]) for choice in reckless)
    assert all(choice["action"] == 3 for choice in chosen if choice["driver"] != RECKLESS)
    assert learned.calls[1:3] in (["choose", "sent 3"], ["observe", f"sent {chosen[0]['action']}"])
    assert learned.calls.count("observe") == len(reckless)
    assert sum(call.startswith("sent") for call in learned.calls) == 300


def test_the_oracle_takes_the_nearest_action_that_ends_well():
    settings = CollectConfig(follow_share=0.0, astray_share=0.0)
    driver = _DataDriver(settings, ACTIONS, np.random.default_rng(0), None)
    first_s = np.where(ACTIONS.points[:, 1] > 0.3, 0.4, np.inf)
    choice = driver.choose({"joystick": np.array([0.0, 1.0], np.float32)}, Verdict(danger=True, first_s=first_s))
    assert ACTIONS.points[choice["action"]].tolist() == [0.0, 0.25] and choice["driver"] == ORACLE


def test_labels_and_senses_are_of_the_moment_in_which_the_action_is_chosen(
    corner: Path, tmp_path: Path, segment: DrivingSegment
):
    place = next(_iter_world_setups(order_in(corner, "collect.episode_steps=15"), tmp_path))
    specs = tuple(replace(spec, truth=True, truth_visible=True) for spec in place.seats)
    actions, told = segment.action.reshape(2, 40), []
    with World(place.town, place.config, specs, place.seed) as world:
        for tick in range(40):
            now = [client.first or client for client in world.snapshot.clients]
            all_knowing = [crash_times_to_codes(client.truth.first_s) for client in now]
            visible = [crash_times_to_codes(client.truth.visible.first_s) for client in now]
            odometry = [make_observation(client, place.config)["odometry"] for client in now]
            told.append((all_knowing, visible, odometry))
            sticks = (Joystick(*ACTIONS.points[action].tolist()) for action in actions[:, tick])
            at = world.snapshot.tick
            world.tick(tuple(Command(seat=seat, tick=at, joystick=stick) for seat, stick in enumerate(sticks)))
    for said, column in zip(zip(*told, strict=True), (segment.truth, segment.visible, segment.odometry), strict=True):
        rows = column.reshape(2, 40, -1).swapaxes(0, 1)
        assert np.array_equal(said, rows)
        assert not np.array_equal(said[1:], rows[:-1]), "a tick late is something else"


def test_labels_are_judged_again_by_how_others_went_on(corner: Path, segment: DrivingSegment, monkeypatch):
    asked: list[int] = []

    def reassess(*told: object) -> F64:
        asked.append(round(float(str(told[-1])) / 0.1))
        return np.where(np.arange(81) == 7, 0.2, np.inf)

    monkeypatch.setattr(CrashOracle, "reassess", reassess)
    order = order_in(corner, "collect.episode_steps=15")
    again = drive_segment(order, None)
    ends = np.flatnonzero(again.ended) + 1
    assert len(ends) > 4, "episodes end before all is seen"
    left = ends[np.searchsorted(ends, np.arange(80), side="right")] - np.arange(80)
    once_each = [
        min(round(10 * after_s), left[40 * seat + tick])
        for seat in range(2)
        for tick in reversed(range(40))
        for after_s in HINDSIGHT_S
    ]
    assert asked == once_each and np.array_equal(again.truth, segment.truth)
    assert (again.visible[:, 7] <= crash_times_to_codes(np.array([0.2]))).all()
    others = np.delete(np.arange(81), 7)
    assert (again.visible[:, others] >= segment.visible[:, others]).all(), "the earlier failure counts"
    drive_segment(replace(order, config=resolve(order.config, "danger.teacher=truth")), None)
    assert asked == once_each, "the all-knowing oracle is asked once"


def test_who_knows_less_fears_less(segment: DrivingSegment):
    unsafe = segment.truth != SAFE
    assert (segment.visible[~unsafe] == SAFE).mean() > 0.99

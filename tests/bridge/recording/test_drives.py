"""A simulated user's drive is recorded, made again to the last bit, and drives a chair of its own town alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.samples import write_recording
from tests.support.worlds import open_world, push, quick_config
from wcsim.bridge.replay.replayed import first_inputs, verify
from wcsim.bridge.user_drives import (
    drawn_user,
    drive_header,
    record_user,
    seen_drive,
    with_shadow,
)
from wcsim.bridge.world import World
from wcsim.bridge.world_rollout import rollout
from wcsim.core.seeding import make_rng
from wcsim.errors import ConfigError, TownError
from wcsim.log.drive import read_drive
from wcsim.log.records import Admitted, DriveTick, Respawned, end_fields_from_snapshot, with_fields
from wcsim.log.writer import LogWriter
from wcsim.towns.scenario.town import Town, content_hash, find_town
from wcsim.types import Joystick, SeatSpec
from wcsim.users.profiles import (
    _read_profile,
    find_builtin_profile,
    list_profile_names,
    profile_to_json,
    profile_to_toml,
    sample_profile,
)
from wcsim.users.recordings.recorded_user import find_user


@pytest.fixture(scope="module")
def driven(corner_town: Town, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drives") / "a.drive"
    user = drawn_user(find_builtin_profile("tremor"), 5)
    record_user(path, corner_town, quick_config(), user, ticks=60, seed=2)
    return path


def test_a_drive_says_what_it_was_and_is_made_again_to_the_last_bit(corner_town, driven):
    drive = read_drive(driven)
    assert (drive.about.profile, drive.about.policy, len(drive.ticks)) == ("tremor", "follow", 60)
    assert drive.header.town_sha256 == content_hash(corner_town)
    (sat,) = (record for record in drive.records if isinstance(record, Admitted))
    assert find_user(sat.spec.profile) == drawn_user(find_builtin_profile("tremor"), 5)
    assert drive.knows_intents
    assert all(tick.sticks.shape == (24, 2) for tick in drive.ticks)
    assert all(
        np.allclose(a.sticks[-1], (b.stick.x, b.stick.y), atol=1e-6)
        for a, b in zip(drive.ticks, drive.ticks[1:], strict=False)
    )
    found = verify(drive)
    assert (found.ticks, found.mismatches, found.farthest_m) == (60, 0, 0.0)


@pytest.mark.parametrize("own", ["spread = 0.9", "gain = [0.2, 0.2]\nspread = 0.3", "give_up_s = 3600\nspread = 0.1"])
def test_a_user_drawn_of_a_wide_profile_can_be_recorded(tmp_path, own):
    (tmp_path / "me.toml").write_text(own)
    base = _read_profile(tmp_path / "me.toml")
    for seed in range(60):
        user = drawn_user(base, seed)
        (tmp_path / "drawn.toml").write_text(profile_to_toml(user, {}))
        assert _read_profile(tmp_path / "drawn.toml") == find_user(profile_to_json(user)) == user


def test_a_user_drawn_of_a_usual_profile_is_the_one_of_the_episodes():
    for name in list_profile_names():
        drawn = sample_profile(find_builtin_profile(name), make_rng(3, "drive", "user"))
        assert drawn_user(find_builtin_profile(name), 3) == replace(drawn, spread=0.0)


def test_a_drive_that_is_not_what_it_says_is_noticed(driven):
    drive = read_drive(driven)
    wrong = with_fields(drive.ticks[20], commanded=Joystick(1.0, 0.0))
    found = verify(replace_ticks(drive, {20: wrong}))
    assert (found.ticks, found.first.tick) == (60, 21)
    assert found.mismatches >= 39 and found.farthest_m > 0.01
    moved = with_fields(drive.ticks[30], p_WB_m=drive.ticks[30].p_WB_m + np.array([0.0, 1e-9, 0.0]))
    found = verify(replace_ticks(drive, {30: moved}))
    assert (found.mismatches, found.first.tick) == (1, 31)
    with pytest.raises(TownError, match=r"\(cdcdcdcdcdcd\).*expected the same town") as caught:
        verify(replace_header(drive, town_sha256="cd" * 32))
    assert str(caught.value).startswith("the drive was in ")


def test_a_drive_is_replayed_as_a_user_in_its_own_town(corner, driven):
    drive = read_drive(driven)
    with open_world(corner, seed=2, spec=SeatSpec(profile=f"recorded:{driven}", truth=True)) as world:
        for tick in drive.ticks:
            assert world.snapshot.clients[0].user == tick.stick
            assert world.snapshot.clients[0].truth.intent == tick.intent
            assert np.array_equal(push(world, tick.commanded).plant.p_WB_m, tick.p_WB_m)
    with pytest.raises(ConfigError, match=r"was driven in .*\(\w{12}\), this is helsinki \("):
        World(find_town("helsinki"), quick_config(), (SeatSpec(profile=f"recorded:{driven}"),), 1, find_user=find_user)


def test_a_persons_drive_with_a_cut_episode_is_made_again(corner_town, tmp_path):
    """A person is whoever gives sticks: here a table of them, and an episode that is begun anew after tick 12."""
    rng, config, town = np.random.default_rng(4), quick_config(), corner_town
    sticks = np.clip(np.c_[rng.normal(0.0, 0.2, 40), rng.uniform(0.3, 0.8, 40)], -0.7, 0.7)
    write_recording(tmp_path / "sticks.csv", 0.1 * np.arange(40), sticks)
    spec, path = SeatSpec(profile=f"recorded:{tmp_path / 'sticks.csv'}"), tmp_path / "a.drive"
    header = drive_header(town, config, 6, policy="dwa", level="1", episode="dev 1.0")
    with (
        World(town, config, (spec,), 6, find_user=find_user) as world,
        LogWriter(path, header) as recorder,
    ):
        for record in first_inputs(spec, 6):
            recorder.append(record)
        for number in range(30):
            if number == 12:
                recorder.append(Respawned(epoch=0, tick=12, seat=0))
                world.respawn(0)
            before = world.snapshot.clients[0].first or world.snapshot.clients[0]
            step = next(rollout(world))
            (command,), (after,) = step.commands, step.after.clients
            at = {"tick": after.tick, "episode": after.events.episode, "time_s": after.tick * 0.1}
            given = command.joystick
            recorder.append(
                DriveTick(**at, stick=before.user, commanded=given, chosen=given, **end_fields_from_snapshot(after))
            )
    drive = read_drive(path)
    assert (drive.about.driver, drive.about.episode, len(drive.episodes)) == ("person", "dev 1.0", 2)
    assert not drive.knows_intents
    found = verify(drive)
    assert (found.ticks, found.mismatches) == (30, 0)


def replace_ticks(drive, others):
    by_tick = {tick.tick: tick for tick in others.values()}
    records = (by_tick.get(one.tick, one) if isinstance(one, DriveTick) else one for one in drive.records)
    return replace(drive, records=tuple(records))


def replace_header(drive, **changes):
    return replace(drive, header=with_fields(drive.header, **changes))


def test_a_driver_of_the_model_beside_a_person_wants_what_the_person_wants(corner_town, tmp_path):
    """A user of the model, whose intents are known, stands for the person; both know the same street."""
    user = replace(drawn_user(find_builtin_profile("competent"), 3), noise=0.0)
    config = quick_config("world.demand_scale=0")
    record_user(tmp_path / "a.drive", corner_town, config, user, ticks=120, seed=4)
    drive = read_drive(tmp_path / "a.drive")
    hidden = replace_ticks(drive, {tick.tick: with_fields(tick, intent=None) for tick in drive.ticks})
    seen = seen_drive(hidden)
    assert len(seen.views) == 120
    made = with_shadow(seen, user)
    assert made.knows_intents and not hidden.knows_intents
    assert np.median(gaps(made, drive)) < 1e-6
    late = with_shadow(seen, replace(user, reaction_s=0.9))
    assert np.median(gaps(late, drive)) > 1e-4


def gaps(one, other):
    """How far the intents of two drives lie apart, tick by tick."""
    pairs = ((a.intent, b.intent) for a, b in zip(one.ticks, other.ticks, strict=True))
    return [np.hypot(a.x - b.x, a.y - b.y) for a, b in pairs]

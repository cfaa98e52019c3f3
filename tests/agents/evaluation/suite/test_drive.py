"""A block of a suite, driven in a street corner: how episodes end, whatever a policy does."""

from dataclasses import fields
from functools import partial

import pytest

from tests.agents.evaluation.suite.lists import (
    Dies,
    Held,
    Levels,
    NoNumber,
    OutOfTheGrid,
    Sleeps,
    Starts,
    Waits,
    WarnsAlways,
    block_of,
    config,
    order_of,
)
from wcsim.agents.evaluation.suite import drive
from wcsim.agents.evaluation.suite.drive import Piece, drive_block, refused
from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.policies.baselines import make_baseline_policy
from wcsim.agents.policies.dwa import VetoPolicy
from wcsim.users.user import SimulatedUser


def follow():
    return make_baseline_policy("follow", config())


def test_who_follows_obeys_and_ends_in_one_of_the_ways_that_there_are(corner):
    block = block_of(corner, max_steps=400)
    records = drive_block(*order_of(corner, block, judged=True), follow)
    assert len(records) == 2 and [record.seat for record in records] == [0, 1]
    for record, episode in zip(records, block.episodes, strict=True):
        assert record.status in ("finished", "chair_crashed", "gave_up", "timed_out")
        assert record.within == record.steps > 0 and record.interventions == ()
        assert record.steps == pytest.approx(10.0 * record.time_s) and record.m > 0.0
        assert record.route_m == pytest.approx(episode.route_m) and record.done_m <= record.route_m + 1.0
        if record.status == "finished":
            assert record.done_m == record.route_m


@pytest.mark.parametrize(
    "policy, late_s, said",
    [
        (Dies, 10.0, "no more"),
        (OutOfTheGrid, 10.0, "0 to 80"),
        (NoNumber, 10.0, "nan"),
        (Sleeps, 0.2, "0.2 s"),
        (Starts, 0.05, "0.3 s"),
    ],
)
def test_a_policy_that_fails_fails_its_episode_and_the_others_go_on(corner, policy, late_s, said):
    made = iter([policy(), follow()])
    failed, other = drive_block(*order_of(corner, block_of(corner, max_steps=8), late_s=late_s), lambda: next(made))
    assert failed.status == "policy_failed" and said in failed.reason
    assert failed.steps == {Dies: 5, Sleeps: 1}.get(policy, 0) and not failed.score
    assert other.status != "policy_failed" and other.steps > 5


def test_a_policy_that_a_busy_machine_keeps_waiting_has_not_failed(corner):
    records = drive_block(*order_of(corner, block_of(corner, max_steps=3), late_s=0.1), lambda: Waits(0.0, 0.0))
    assert [record.status for record in records] == ["timed_out", "timed_out"]


def test_before_the_handover_the_user_drives_alone(corner):
    held, handed = (
        drive_block(*order_of(corner, block_of(corner, max_steps=30, handover=steps)), lambda: Held(0.0, 0.0))
        for steps in (0, 20)
    )
    assert all(record.m < 0.1 for record in held)
    assert all(record.steps == 10 and record.status == "timed_out" for record in handed)
    block = block_of(corner)
    for record, episode in zip(handed, block.episodes, strict=True):
        assert record.route_m < episode.route_m  # what was driven before is not the policy's


@pytest.mark.parametrize("wrapped", [lambda held, _: held, partial(VetoPolicy, "veto:held")], ids=["alone", "veto"])
def test_one_call_judges_what_all_chairs_see_that_have_chosen_once(corner, monkeypatch, wrapped):
    judged = []
    monkeypatch.setattr(Held, "judge_together", lambda _, seen: judged.append(len(seen)) or 1 / 0, raising=False)
    piece, place = order_of(corner, block_of(corner, max_steps=6, handover=2))
    drive_block(piece, place, lambda: wrapped(Held(), place.config))
    assert judged == [2, 2, 2]


def test_what_ends_before_the_handover_is_not_the_policys(corner):
    """The list's step limit ends it here; the rule asks when, not how."""
    records = drive_block(*order_of(corner, block_of(corner, max_steps=20, handover=20)), lambda: Held(0.0, 0.0))
    assert [(record.status, record.steps, record.counts, record.own) for record in records] == [
        ("not_reached", 0, False, False)
    ] * 2


def test_what_a_policy_does_and_warns_of_is_judged_by_letting_the_user_drive_alone(corner):
    block, policies = block_of(corner, max_steps=30), iter((Held(0.0, 0.0), WarnsAlways(0.0, 0.0)))
    stands = drive_block(*order_of(corner, block, judged=True), policies.__next__)
    assert all(item.verdict in ("needed", "needless") for record in stands for item in record.interventions)
    assert all(record.interventions for record in stands)
    assert [(record.false_warnings, record.to_warn) for record in stands] == [(0, 0), (1, 0)]
    unjudged = drive_block(*order_of(corner, block), lambda: Held(0.0, 0.0))
    assert [len(record.interventions) for record in unjudged] == [len(record.interventions) for record in stands]
    assert all(item.verdict == "not_judged" for record in unjudged for item in record.interventions)
    for one, other in zip(stands, unjudged, strict=True):  # a fork leaves no trace in the world
        assert (one.m, one.steps, one.end_m) == (other.m, other.steps, other.end_m)
        assert one.distance_sum == other.distance_sum


def test_users_requests_for_help_are_counted_and_raise_levels_where_that_is_set(corner, monkeypatch):
    monkeypatch.setattr(SimulatedUser, "look", _asks_after(SimulatedUser.look, 10))
    found, without_levels = [], []
    for settings in ((), ("world.help_users=true", "world.help_s=0.5")):
        block = block_of(corner, max_steps=20, handover=5).model_copy(update={"settings": settings})
        policies = [Levels(0.0, 0.0), Levels(0.0, 0.0)]
        records = drive_block(*order_of(corner, block), iter(policies).__next__)
        assert [(record.helps, record.steps) for record in records] == [(1, 15), (1, 15)]
        found.append({tuple(policy.noted) for policy in policies})
        without_levels += [record.m for record in drive_block(*order_of(corner, block), lambda: Held(0.0, 1.0))]
    plain, helped = found
    assert plain == {(1.0,) * 15} and helped == {(*[1.0] * 5, *[2.0] * 5, *[1.0] * 5)}
    assert all(slow_m < 0.9 * m for m, slow_m in zip(without_levels[:2], without_levels[2:], strict=True))


def _asks_after(look, steps):
    """`look` of a user who asks for help in this step of its episode."""

    def looks(user, view):
        look(user, view)
        user.looked = getattr(user, "looked", -1) + 1
        user.requests_help = user.looked == steps

    return looks


def test_a_policy_that_cannot_be_used_is_refused_in_every_episode(corner):
    records = refused(Piece(index=4, block=block_of(corner)), "it has another action set")
    assert [record.status for record in records] == ["refused"] * 2 and records[0].block == 4
    assert all(not record.score and "action set" in record.reason for record in records)


def test_a_record_has_a_field_for_each_measure_and_no_other(corner, monkeypatch):
    monkeypatch.setattr(drive, "EpisodeRecord", lambda **named: named)
    found, _ = drive_block(*order_of(corner, block_of(corner, max_steps=3)), follow)
    of_crashes = {"fault", "partner", "crash", "last_moment_s", "cause"}
    assert found.keys() | of_crashes == {field.name for field in fields(EpisodeRecord)}

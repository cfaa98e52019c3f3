"""The verdict of a test: figures of the result in plain words, and no winner by chance."""

from dataclasses import replace
from textwrap import wrap

from tests.view.report.results import SCRIPT, crashed, record, with_episodes
from wcsim.agents.evaluation.suite.records import NEEDLESS, Intervention
from wcsim.view.report.comparisons import _paired, verdict
from wcsim.view.report.twin_film import telling_episode


def only(result, *names):
    return with_episodes(result, {name: result.episodes[name] for name in names})


def driven(result, policy, records):
    """The result with other episodes of a policy."""
    return with_episodes(result, {**result.episodes, policy: tuple(records)})


def test_it_counts_crashes_and_arrivals_and_says_what_help_costs(result):
    two = only(result, "follow", "dwa")
    said = verdict(two)
    assert said.startswith(
        "Of 12 drives, the user crashed in 8 alone and in 0 with dwa; "
        "of 4 with a destination, 1 arrived alone and 4 with dwa. "
    )
    assert said.endswith(" Over all steps dwa did 95 % as requested, with 0 unneeded interventions.")
    needless = Intervention(first=1, last=2, verdict=NEEDLESS)
    busy = driven(two, "dwa", [record(0, interventions=(needless,)), *map(record, range(1, 12))])
    assert verdict(busy).endswith("with 1 unneeded intervention.")
    some = driven(busy, "dwa", [record(0, interventions=(needless,)), *(record(n, judged=False) for n in range(1, 12))])
    assert verdict(some).endswith("with 1 unneeded intervention in 1 judged drive.")
    blind = driven(busy, "dwa", [record(n, judged=False) for n in range(12)])
    assert verdict(blind).endswith(" as requested.")


def test_no_policy_is_best_that_the_intervals_cannot_tell_from_another(result):
    assert _paired(result, "dwa", ["dwa"], "follow", "").separated
    two = only(result, "follow", "dwa")
    assert " The highest score is that of dwa. " in verdict(two)
    known = driven(two, "oracle", result.episodes["dwa"])
    assert " But for the oracles, the highest score is that of dwa. " in verdict(known)
    apart = [_paired(result, "dwa", ["dwa"], name, "").separated for name in result.episodes if name != "dwa"]
    assert not all(apart)
    said = verdict(result)
    assert "highest" not in said and " cannot be told apart here." in said
    assert f"The scores of the best {1 + apart.count(False)} of 5 policies" in said
    three = only(result, "dwa", "net@0.25", "net@0.75")
    assert " The scores of dwa, net@0.25 and net@0.75 cannot be told apart here. " in verdict(three)
    strangers = driven(result, "follow", [replace(item, block=item.block + 9) for item in result.episodes["follow"]])
    assert "the user alone among them" in verdict(strangers), "they share no episode"
    few = with_episodes(two, {name: found[4:6] for name, found in two.episodes.items()})
    assert "Of 2 drives, " in verdict(few) and "Fewer than 6 drives cannot tell policies apart." in verdict(few)


def test_the_film_is_of_a_drive_that_the_help_brought_to_its_end(result):
    helped = record(0, status="gave_up"), *map(record, range(1, 12))
    assert telling_episode(driven(result, "dwa", helped), "dwa") == (0, 1)


def test_own_policies_come_first_and_it_stays_short(result):
    said = verdict(result)
    assert len(wrap(said, 100)) <= 4
    assert "; net@0.25 failed in 1; " in said and SCRIPT not in said
    two = only(result, "follow", "dwa")
    both = verdict(driven(two, "own_policy:Careful", two.episodes["dwa"]))
    assert " and 4 with dwa. The scores of dwa and own_policy:Careful cannot be told apart here." in both
    assert both.endswith(" did 95 % as requested and dwa 95 %, with 0 and 0 unneeded interventions.")
    far = "runs/" + "x" * 200
    found = {"follow": two.episodes["follow"], "net": two.episodes["dwa"], far: two.episodes["dwa"]}
    assert " 4 with net." in verdict(with_episodes(two, found))


def test_a_test_of_the_user_alone_or_of_bounds_crowns_nothing(result):
    assert (
        verdict(only(result, "follow"))
        == "Of 12 drives, the user crashed in 8 alone; of 4 with a destination, 1 arrived alone."
    )
    assert verdict(only(result, "dwa")).startswith(
        "Of 12 drives, the user crashed in 0 with dwa; of 4 with a destination, 4 arrived with dwa. Over all"
    )
    one = driven(only(result, "follow"), "follow", [crashed(0)])
    assert verdict(one) == "Of 1 drive, the user crashed in 1 alone; of 1 with a destination, 0 arrived alone."

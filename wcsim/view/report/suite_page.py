"""The page of a test on a suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import KeptResult
from wcsim.core.reading import counted
from wcsim.view.report.comparisons import RIVALS, Paired, compared, verdict, verdicts
from wcsim.view.report.failure_list import failure_exhibit, worst_link
from wcsim.view.report.failures import FailedEpisode, where_typed
from wcsim.view.report.figures import figures_of
from wcsim.view.report.glossary import glossary
from wcsim.view.report.illustrate import Illustration, Key
from wcsim.view.report.markup import Exhibit, Markup, csv_of, el, joined
from wcsim.view.report.page import Section, facts, page, shown, write_page
from wcsim.view.report.tables import comparison_table, legend, result_table, weights_table

_BEST = 3
_COLOURS_SAY = (
    "Pictures: above, the classes as the network gets them (violet road, pink pavement, green plants, grey houses, red "
    "people and riders, dark red bicycles, dark blue cars, black unknown). Below, the depth (red near, blue far, black "
    "out of range, white not measured). The last one is the end. The camera looks ahead only. Stick positions are x "
    "right and y ahead: the user's, and the driven one. Run a command in the folder "
)


def write_suite_page(
    result: KeptResult,
    folder: Path,
    failures: Sequence[FailedEpisode],
    pictures: Mapping[Key, Illustration],
    why_none: str,
    out: Path,
) -> Path:
    """Write the page of a test and what belongs to it; where the page is.

    Args:
        result: The test.
        folder: Where it lies.
        failures: Those of all policies, worst first.
        pictures: Of some of them.
        why_none: Why there are no pictures at all, or "".
        out: Where the page goes.

    Raises:
        DiskFullError: It cannot be written.
    """
    names = list(result.episodes)
    parts = list(dict.fromkeys(row["part"] for row in result.rows))
    pooled = result_table(result, "", lambda policy: worst_link(failures, names, policy))
    by_part = [result_table(result, part) for part in parts]
    pairs = compared(result)
    against, weights = comparison_table(pairs), weights_table(result)
    drawn, listed = figures_of(result, folder), failure_exhibit(result, failures, pictures, why_none)
    episodes = _episodes(result)
    pictured = el("p", f"{_COLOURS_SAY}{where_typed(result)}.", class_="says")
    sections = (
        Section(name="results", title="Results", body=joined((shown(pooled), legend(), _who(result, parts)))),
        Section(name="decided", title="Comparisons", body=_decided(pairs, parts, against, weights)),
        Section(name="figures", title="Figures", body=el("div", *map(shown, drawn), class_="charts")),
        Section(name="failures", title="Failures", body=shown(listed, pictured)),
        Section(name="parts", title="Part by part", body=joined(map(shown, by_part))),
        Section(name="episodes", title="Episodes", body=shown(episodes)),
    )
    title = f"{result.suite} {result.set}: {_policies(result)}"
    text = page(title, _intro(result), sections)
    return write_page(out, text, (pooled, *by_part, against, weights, *drawn, listed, episodes))


def _policies(result: KeptResult) -> str:
    return counted(len(result.episodes), "policy", "policies")


def _who(result: KeptResult, parts: Sequence[str]) -> Markup:
    users = sorted({e.record.profile for episodes in result.episodes.values() for e in episodes})
    return glossary(result.episodes, parts, users)


def _intro(result: KeptResult) -> Markup:
    km = sum(float(row.get("km") or 0.0) for row in result.pooled)
    count = sum(len(episodes) for episodes in result.episodes.values())
    best = sorted(result.pooled, key=lambda row: -float(row.get("score") or 0.0))
    ranked = ", ".join(f"{row['policy']} {float(row.get('score') or 0.0):.3f}" for row in best[:_BEST])
    changed: object = el("strong", " ".join(result.changed)) if result.changed else "no settings of the list"
    told = facts(
        (
            ("suite", f"{result.suite}, set {result.set}"),
            ("list", el("code", result.list_sha256)),
            ("changed", changed),
            ("driven", f"{counted(count, 'episode')}, {km:.2f} km, by {_policies(result)}"),
            ("highest scores", ranked),
        )
    )
    return joined((el("p", el("strong", verdict(result))), told))


def _decided(pairs: Sequence[Paired], parts: Sequence[str], against: Exhibit, weights: Exhibit) -> Markup:
    items = []
    for part in ("", *parts):
        here = [pair for pair in pairs if pair.part == part]
        if here:
            name = f"{part or 'All parts'} ({counted(max(pair.episodes for pair in here), 'episode')})"
            items.append(el("li", el("b", name), el("ul", *_against(here))))
    intro = (
        "All policies drove the same episodes. Two are called different if the 95 % interval of the difference of "
        "their scores excludes 0."
    )
    return joined((el("p", intro), el("ul", *items, class_="verdicts"), shown(against), shown(weights)))


def _against(pairs: Sequence[Paired]) -> list[Markup]:
    """A line a rival."""
    found = []
    for rival in RIVALS:
        said = verdicts([pair for pair in pairs if pair.rival == rival])
        if said:
            found.append(el("li", "compared with ", el("b", rival), f": {'; '.join(said)}."))
    return found


def _episodes(result: KeptResult) -> Exhibit:
    """Every episode of every policy, for other tools."""
    plain = [field.name for field in fields(EpisodeRecord) if str(field.type) in ("int", "float", "str", "bool")]
    columns = ("policy", *plain, "x_m", "y_m", "interventions", "way_share", "pace", "obeyed", "score")
    rows = [
        [name, *(getattr(e.record, key) for key in plain), *e.record.end_m, len(e.record.interventions),
         *(round(value, 6) for value in (*e.record.score_parts, e.record.score))]
        for name, episodes in result.episodes.items()
        for e in episodes
    ]  # fmt: skip
    said = f"{counted(len(rows), 'row')}: every episode of every policy, with the parts of its score."
    return Exhibit(name="episodes", title="Every episode", says=said, body=Markup(""), csv=csv_of(columns, rows))

"""The page of a test on a suite: its tables and figures, all failures, and what its words mean."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType

from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import TestResult
from wcsim.core.constants import RECORDED
from wcsim.core.reading import counted
from wcsim.view.report.comparisons import RIVALS, Paired, compared, verdict, verdicts
from wcsim.view.report.failures import WORST, FailedEpisode, Illustration, Key, SeenMoment, where_typed, worst_of
from wcsim.view.report.figures import figures_of
from wcsim.view.report.markup import (
    Exhibit,
    Markup,
    Section,
    csv_of,
    data_uri,
    el,
    facts,
    joined,
    page,
    shown,
    write_page,
)
from wcsim.view.report.tables import comparison_table, legend, result_table, weights_table

POLICIES: Mapping[str, str] = MappingProxyType(
    {
        "follow": "the user alone, without assistance",
        "shipped": "the policy that comes with wcsim",
        "stop": "stops when the depth image shows an obstacle in the way",
        "dwa": "a classical controller on the chair's own sensors: the stick position nearest to the user's from which "
        "it can still brake",
        "zero": "never moves; for comparison",
        "random": "any stick position; for comparison",
        "oracle": "knows the true state of the street: an upper bound, not an assistant that can be built",
        "oracle-visible": "the same, but knows only the road users that the camera showed lately: an upper bound",
    }
)
_PARTS: Mapping[str, str] = MappingProxyType(
    {
        "free": "routes along pavements and over crossings; the aim is to arrive",
        "crossing": "one crossing each; the aim is to arrive",
        "hazard": "routes on which the user alone crashes: the policy takes over 10 s before, for 30 s; the aim is not "
        "to crash",
        "tight": "generated scenes with dangers that are out of view or need more than stopping; the aim is not to "
        "crash",
    }
)
_USERS: Mapping[str, str] = MappingProxyType(
    {
        "competent": "practised, obeys lights",
        "inattentive": "notices a third of what comes, looks away, obeys four lights of five",
        "ataxic": "a shaking hand; no network was trained with it",
        "slow": "slow, with late reactions",
        "tremor": "a trembling hand",
        "switch": "four switches: full stick or none",
    }
)
_HEADINGS = (
    *(("policy", "policy"), ("reason", "what happened"), ("whose", "fault"), ("partner", "with")),
    ("speed", "m/s in the last second"),
    *(("part", "part"), ("place", "place (x, y in m)"), ("user", "user"), ("unaided", "the user alone")),
)
_BEST = 3
_COLOURS_SAY = (
    "Pictures: above, the classes as the network gets them (violet road, pink pavement, green plants, grey houses, red "
    "people and riders, dark red bicycles, dark blue cars, black unknown). Below, the depth (red near, blue far, black "
    "out of range, white not measured). The last one is the end. The camera looks ahead only. Stick positions are x "
    "right and y ahead: the user's, and the driven one. Run a command in the folder "
)


def _glossary(policies: Iterable[str], parts: Iterable[str], users: Iterable[str]) -> Markup:
    """A list of those that occur."""
    rows = [(name, _policy(name)) for name in policies]
    rows += [(f"part {name}", _PARTS.get(name, "")) for name in parts]
    rows += [(f"user {name}", _USERS.get(name, "a simulated user of your own")) for name in users if ":" not in name]
    return joined((el("h3", "Policies, parts and users"), facts(rows)))


def _policy(name: str) -> str:
    kind, at, level = name.partition("@")
    said = POLICIES.get(kind, "a policy named in the command")
    return f"{said}; assistance level {level}" if at else said


def _anchor_of(failure: FailedEpisode, names: Sequence[str]) -> str:
    """Where a failure stands on the page."""
    block, seat = failure.key
    return f"f-{names.index(failure.policy)}-{block}-{seat}"


def _worst_link(failures: Sequence[FailedEpisode], names: Sequence[str], policy: str) -> object:
    """A link to a policy's worst moment, a dash where it has none."""
    worst = worst_of(failures, policy)
    if worst is None:
        return "–"
    partner = _partner(worst.record)
    return el("a", f"{worst.reason}{f' with {partner}' if partner else ''}", href=f"#{_anchor_of(worst, names)}")


def _failure_exhibit(
    result: TestResult, failures: Sequence[FailedEpisode], pictures: Mapping[Key, Illustration], why_none: str
) -> Exhibit:
    """All failures; `why_none` says why there are no pictures at all."""
    names = list(result.episodes)
    columns = ("policy", "block", "seat", "part", "town", "x_m", "y_m", "user", "reason", "whose", "partner")
    plain = [
        [failure.policy, *failure.key, record.part, record.town, *record.end_m, record.profile, failure.reason,
         failure.whose, record.partner, failure.speed_mps, failure.severity, failure.unaided, failure.command]
        for failure in failures
        for record in (failure.record,)
    ]  # fmt: skip
    head = el("div", *(el("button", text, type="button", data_sort=key) for key, text in _HEADINGS), class_="row head")
    rows = [
        _entry(number, failure, _anchor_of(failure, names), pictures.get((failure.policy, *failure.key)))
        for number, failure in enumerate(failures)
    ]
    note = el("p", why_none, class_="note") if why_none else ""
    return Exhibit(
        name="failures",
        title="All failures, worst first",
        says=WORST,
        body=joined((_filters(failures), note, el("div", head, *rows, id="failures-list"))),
        csv=csv_of((*columns, "last_second_mps", "severity", "unaided", "command"), plain),
    )


def _filters(failures: Sequence[FailedEpisode]) -> Markup:
    """Two choices; they need the script, and are not shown without it."""
    chosen = (
        ("policy", dict.fromkeys(failure.policy for failure in failures)),
        ("reason", dict.fromkeys(failure.reason for failure in failures)),
    )
    labels = (
        el("label", f"{name} ", el("select", el("option", "all", value=""), *(el("option", v, value=v) for v in values),
                                   data_filter=name))
        for name, values in chosen
    )  # fmt: skip
    return el("p", *labels, el("span", counted(len(failures), "failure"), id="failures-count"), class_="filters")


def _entry(number: int, failure: FailedEpisode, anchor: str, pictures: Illustration | None) -> Markup:
    record = failure.record
    speed = "–" if failure.speed_mps is None else f"{failure.speed_mps:.2f}"
    cells = (
        ("policy", failure.policy),
        ("reason", failure.reason),
        ("whose", failure.whose),
        ("partner", _partner(record)),
        ("speed", speed),
        ("part", record.part),
        ("place", f"{record.town} ({record.end_m[0]:.0f}, {record.end_m[1]:.0f})"),
        ("user", record.profile.replace(RECORDED, "recording ", 1)),
        ("unaided", failure.unaided),
    )
    row = el("summary", *(el("span", text, class_=f"c-{key}") for key, text in cells), class_="row")
    keys = {f"data_{key}": text for key, text in cells}
    shown = pictures is not None and bool(pictures.seen)
    return el(
        "details", row, _detail(failure, anchor, pictures), class_="failure pictured" if shown else "failure",
        data_number=number, **keys,
    )  # fmt: skip


def _detail(failure: FailedEpisode, anchor: str, pictures: Illustration | None) -> Markup:
    record = failure.record
    interventions = counted(len(record.interventions), "intervention")
    said = (
        f"Episode {record.block}.{record.seat}: {record.m:.1f} m and {record.time_s:.1f} s driven, "
        f"{_done(record)}score {record.score:.3f}, "
        f"{interventions}{', none in the last 5 s before the crash' if record.missed else ''}. "
        f"{f'It {record.crash}. ' if record.crash else ''}The user alone in the same episode: {failure.unaided}."
    )
    parts: list[object] = [el("p", said)]
    if record.status == "policy_failed" or record.status == "refused":
        parts.append(el("p", record.reason, class_="note"))
    if pictures is None:
        parts.append(el("p", "No pictures of this one; the command below repeats and films it.", class_="note"))
    elif pictures.missing:
        parts.append(el("p", f"No pictures: {pictures.missing}", class_="note"))
    else:
        parts.append(_pictures(pictures))
    parts.append(el("pre", failure.command, class_="command"))
    return el("div", *parts, id=anchor, class_="detail")


def _partner(record: EpisodeRecord) -> str:
    return "a fixed object" if record.partner == "static" else record.partner


def _done(record: EpisodeRecord) -> str:
    """How much of the way was done; nothing where there is none to do."""
    return f"{record.done_m:.0f} of {record.route_m:.0f} m of the route done, " if record.route_m > 0.0 else ""


def _pictures(pictures: Illustration) -> Markup:
    street = el(
        "figure",
        el("img", src=data_uri("image/png", pictures.street_png), alt="the street around at the end", width=300),
        el("figcaption", "The end from above, 24 m wide: the chair is yellow, its path green. "
                         f"Nearest: {', '.join(pictures.near) or 'no road user'}."),
        class_="street",
    )  # fmt: skip
    return el("div", el("div", *(_seen(each) for each in pictures.seen), class_="strip"), street, class_="moment")


def _seen(moment: SeenMoment) -> Markup:
    when = f"−{moment.before_s:.1f} s" if moment.before_s > 0.05 else "the end"
    caption = joined((
        el("b", when), f" {moment.speed_mps:.2f} m/s", el("br"),
        f"user {moment.asked}", el("br"), f"driven {moment.given}",
    ))  # fmt: skip
    picture = data_uri("image/png", moment.png)
    return el("figure", el("img", src=picture, alt=f"seen {moment.before_s:.1f} s before"), el("figcaption", caption))


def write_suite_page(
    result: TestResult,
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
    parts = list(dict.fromkeys(row.part for row in result.rows))
    pooled = result_table(result, "", lambda policy: _worst_link(failures, names, policy))
    by_part = [result_table(result, part) for part in parts]
    pairs = compared(result)
    against, weights = comparison_table(pairs), weights_table(result)
    drawn, listed = figures_of(result, folder), _failure_exhibit(result, failures, pictures, why_none)
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


def _policies(result: TestResult) -> str:
    return counted(len(result.episodes), "policy", "policies")


def _who(result: TestResult, parts: Sequence[str]) -> Markup:
    users = sorted({e.profile for episodes in result.episodes.values() for e in episodes})
    return _glossary(result.episodes, parts, users)


def _intro(result: TestResult) -> Markup:
    km = sum(row.km for row in result.pooled)
    count = sum(len(episodes) for episodes in result.episodes.values())
    best = sorted(result.pooled, key=lambda row: -(row.score or 0.0))
    ranked = ", ".join(f"{row.policy} {row.score or 0.0:.3f}" for row in best[:_BEST])
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


def _episodes(result: TestResult) -> Exhibit:
    """Every episode of every policy, for other tools."""
    plain = [field.name for field in fields(EpisodeRecord) if str(field.type) in ("int", "float", "str", "bool")]
    columns = ("policy", *plain, "x_m", "y_m", "interventions", "way_share", "pace", "obeyed", "score")
    rows = [
        [name, *(getattr(e, key) for key in plain), *e.end_m, len(e.interventions),
         *(round(value, 6) for value in (*e.score_parts, e.score))]
        for name, episodes in result.episodes.items()
        for e in episodes
    ]  # fmt: skip
    said = f"{counted(len(rows), 'row')}: every episode of every policy, with the parts of its score."
    return Exhibit(name="episodes", title="Every episode", says=said, body=Markup(""), csv=csv_of(columns, rows))

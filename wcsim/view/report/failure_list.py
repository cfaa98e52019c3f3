"""The list of failures as HTML: a row each, which opens into pictures, a map and the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from wcsim.agents.evaluation.suite.records import EpisodeRecord
from wcsim.agents.evaluation.suite.result_files import KeptResult
from wcsim.core.constants import RECORDED
from wcsim.core.reading import counted
from wcsim.view.report.failures import WORST, FailedEpisode, worst_of
from wcsim.view.report.illustrate import Illustration, Key, SeenMoment
from wcsim.view.report.markup import Exhibit, Markup, csv_of, data_uri, el, joined

_HEADINGS = (
    *(("policy", "policy"), ("reason", "what happened"), ("whose", "fault"), ("partner", "with")),
    ("speed", "m/s in the last second"),
    *(("part", "part"), ("place", "place (x, y in m)"), ("user", "user"), ("unaided", "the user alone")),
)


def _anchor_of(failure: FailedEpisode, names: Sequence[str]) -> str:
    """Where a failure stands on the page."""
    block, seat = failure.key
    return f"f-{names.index(failure.policy)}-{block}-{seat}"


def worst_link(failures: Sequence[FailedEpisode], names: Sequence[str], policy: str) -> object:
    """A link to a policy's worst moment, a dash where it has none."""
    worst = worst_of(failures, policy)
    if worst is None:
        return "–"
    partner = _partner(worst.episode.record)
    return el("a", f"{worst.reason}{f' with {partner}' if partner else ''}", href=f"#{_anchor_of(worst, names)}")


def failure_exhibit(
    result: KeptResult, failures: Sequence[FailedEpisode], pictures: Mapping[Key, Illustration], why_none: str
) -> Exhibit:
    """All failures; `why_none` says why there are no pictures at all."""
    names = list(result.episodes)
    columns = ("policy", "block", "seat", "part", "town", "x_m", "y_m", "user", "reason", "whose", "partner")
    plain = [
        [failure.policy, *failure.key, record.part, record.town, *record.end_m, record.profile, failure.reason,
         failure.whose, record.partner, failure.speed_mps, failure.severity, failure.unaided, failure.command]
        for failure in failures
        for record in (failure.episode.record,)
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
    record = failure.episode.record
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
    record = failure.episode.record
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

"""A block's figures as a row of the study's table."""

from __future__ import annotations

from wcsim.drive.keeping.open_study import OpenStudy
from wcsim.drive.keeping.study_plan import END, StudyPart
from wcsim.drive.keeping.study_table import Row
from wcsim.drive.session import DriveSession
from wcsim.users.recording.drive_types import wcsim_version


def block_row(study: OpenStudy, part: StudyPart, session: DriveSession, file: str, ended: str) -> Row:
    """What was driven in a block.

    Args:
        study: The study, and who takes part.
        part: The block, and where it stands.
        session: The drive, at its end.
        file: Of its recording.
        ended: Why: "minutes", "arrivals", or "stopped" by the participant.
    """
    tally, place = session.tally, session.place
    moving_s = tally.moving_ticks * session.tick_s
    return {
        **_head(study, part.block.name),
        "part": str(part.number),
        "assistance": "on" if part.block.assistance else "off",
        "level": "" if session.assistance.level is None else f"{session.assistance.level:g}",
        "policy": session.assistance.name,
        "town": place.town.name,
        "seed": str(place.seed),
        "episode": place.episode,
        "recording": file,
        "ended": ended,
        "minutes": f"{session.counted_s / 60.0:.4f}",
        "kpi1": "" if tally.kpi1 is None else f"{tally.kpi1:.5f}",
        "kpi2": f"{tally.kpi2:.2f}",
        "distance_m": f"{tally.way_m:.2f}",
        "speed_mps": f"{tally.way_m / moving_s:.4f}" if moving_s else "",
        "arrivals": str(tally.arrivals),
        "given_up": str(tally.given_up),
        "crashes": str(tally.crashes),
        "warnings": str(tally.warnings),
        "interventions": str(tally.interventions),
        "helps": str(tally.helps),
        "overrulings": str(tally.overrules),
    }


def end_row(study: OpenStudy) -> Row:
    """The row of the answers after all blocks."""
    return _head(study, END)


def _head(study: OpenStudy, block: str) -> dict[str, str]:
    return {
        "study": study.file.name,
        "study_sha256": study.sha256[:12],
        "wcsim": wcsim_version(),
        "participant": str(study.participant),
        "order": study.order,
        "block": block,
    }

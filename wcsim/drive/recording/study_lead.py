"""Opens a study, and leads a participant through it: what is next, when a drive is over.

A block's figures are a row of the study's table.
"""

import hashlib
import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from wcsim.agents.opening.named_policy import open_named_policy, resolve_policy_config
from wcsim.agents.policy_api import Levelled
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.config import parse
from wcsim.config.study import StudyFile, StudyPlace
from wcsim.core.files import iter_unused_paths
from wcsim.core.reading import SETTINGS, escape, is_file, parse_toml, read_text
from wcsim.drive.recording.study_plan import (
    END,
    Row,
    StepKind,
    StudyPart,
    StudyStep,
    answer_choices,
    append_row,
    order_words,
    read_rows,
    remaining_steps,
    step_questions,
    step_view,
    table_columns,
)
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import PRESET, DriveStart, check_recordable, checked
from wcsim.errors import ConfigError, WcsimError
from wcsim.log.drive import read_wcsim_version
from wcsim.towns.scenario.town import expanded

_MOST_PARTICIPANTS: Final = 9999
_COUNTED: Final = ("arrivals", "given_up", "crashes", "warnings", "interventions", "helps")
_NO_ANSWER: Final = -1
_SHIPPED: Final = Path(__file__).parents[2] / "config" / "presets" / "studies"


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenStudy:
    """A study and who takes part in it now."""

    file: StudyFile
    sha256: str  # hex, of the file's bytes
    participant: int  # 1 or more
    out: Path  # the folder of all results
    network: str = ""  # somebody's own, module:Class, that the policy may look with

    @property
    def table(self) -> Path:
        """The only table, of all participants."""
        return self.out / f"{self.file.name}.csv"

    @property
    def folder(self) -> Path:
        """Of this participant's recordings."""
        return self.out / f"participant-{self.participant:03d}"

    @property
    def order(self) -> str:
        """The order of this participant's blocks."""
        return order_words(self.file, self.participant)


def open_study(
    name_or_path: str, participant: int, out: Path | None = None, named: str = "", network: str = ""
) -> OpenStudy:
    """Read a study's file and check all that can be checked before anybody drives.

    Args:
        name_or_path: One that comes with wcsim, or a file.
        participant: From 1 on.
        out: Where results go; studies/NAME where it is not said.
        named: The policy of the file, named again by who starts it, as a class runs as code.
        network: An own network of the policy, which runs as code too.

    Raises:
        ConfigError: It is no study, a part of it is missing, or the table is another study's.
        TownError: There is no such town.
        PolicyError: There is no such policy, or it has no such level.
    """
    if not 1 <= participant <= _MOST_PARTICIPANTS:
        raise ConfigError(f"--participant {participant}: expected 1 to {_MOST_PARTICIPANTS}")
    path = (
        _SHIPPED / f"{name_or_path}.toml"
        if name_or_path in _shipped_studies()
        else expanded(name_or_path)
    )
    if not is_file(path):
        known = ", ".join(_shipped_studies())
        raise ConfigError(
            f"--study {escape(name_or_path)}: there is no such study; "
            f"expected {known}, or a TOML file"
        )
    text = read_text(path, SETTINGS)
    file = parse(StudyFile, parse_toml(text, escape(path), SETTINGS), escape(path))
    digest = hashlib.sha256(text.encode()).hexdigest()
    # Another policy than the file's is refused, and a class that is not named again.
    if named and named != file.policy:
        told = f"{escape(path)} says policy = {escape(file.policy)!r}"
        raise ConfigError(f"--policy {escape(named)} with --study: {told}; leave --policy out")
    if parse_policy_name(file.policy).kind == "class" and not named:
        raise ConfigError(
            f"{escape(path)}: its policy is the class {escape(file.policy)}, and loading it runs "
            f"its code; if you trust it, name it: --policy {shlex.quote(escape(file.policy))}"
        )
    place_of_results = out or Path("studies") / file.name
    study = OpenStudy(
        file=file, sha256=digest, participant=participant, out=place_of_results, network=network
    )
    for place in (*file.places, *([file.practice_place] if file.practice_place else [])):
        check_recordable(checked(study_start(file, place, network)))
    _require_levels(study, escape(path))
    _participant_rows(study)
    return study


def study_start(file: StudyFile, place: StudyPlace, network: str) -> DriveStart:
    """What a place opens; a suite's episode has its own user. `network` is as in `OpenStudy`."""
    drives = DriveStart(policy=file.policy, network=network)
    if place.suite:
        return replace(drives, profile="", suite=place.suite, block=place.block, seat=place.seat)
    return replace(drives, town=place.town, profile=file.profile, seed=place.seed)


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyHands:
    """What a study needs of whoever runs the drives."""

    # Replaces the drive before and records into that file; may raise WcsimError.
    open: Callable[[DriveStart, Path], DriveSession]
    close: Callable[[], None]  # the drive that is open, if any
    show: Callable[[dict[str, Any]], object]  # as of `step_view`
    say: Callable[[str], object]  # a line for whoever started the study
    clock: Callable[[], float]  # monotonic seconds


class StudyLead:
    """One participant's way through a study, from what is in its table on.

    Args:
        study: The study.
        hands: Who opens drives and shows pages.
    """

    def __init__(self, study: OpenStudy, hands: StudyHands) -> None:
        """Raises ConfigError for a table that cannot be read."""
        self._study, self._hands = study, hands
        done = {row["block"] for row in _participant_rows(study)}
        steps = remaining_steps(study.file, study.participant, done)
        parts = dict.fromkeys(step.part for step in steps if step.part is not None)
        # The figures of parts that were driven before, but whose questions were not answered.
        self._rows = dict[str, Row]()
        for part in parts:
            path = self._result(part)
            for row in read_rows(path, table_columns(study.file)):
                if row["study_sha256"] == study.sha256[:12]:
                    self._rows[part.block.name] = row
            if part.block.name in self._rows:
                hands.say(
                    f"{part.block.name} was driven before; "
                    f"only its questions are left: {escape(path)}"
                )
        self._steps = remaining_steps(study.file, study.participant, done, self._rows)
        self._at, self._view = 0, dict[str, Any]()
        self._session: DriveSession | None = None
        self._file, self._failed, self._rested_s = "", False, 0.0
        # Whole seconds that are left of a drive or a rest, as they were shown last.
        self._shown_s = -1
        left = dict.fromkeys(step.part.block.name for step in self._steps if step.part is not None)
        hands.say(
            f"study {study.file.name}, participant {study.participant}: order {study.order}; "
            f"to do: {', '.join(left) or 'nothing'}; table {escape(study.table)}"
        )

    @property
    def step(self) -> StudyStep:
        """The step of now."""
        return self._steps[self._at]

    @property
    def drives(self) -> bool:
        """Whether time goes."""
        return self.step.kind is StepKind.DRIVE and self._session is not None

    def begin(self) -> None:
        """Show the first step."""
        self._enter()

    def go_on(self, step: int) -> None:
        """The participant presses this step's button or ends a drive; old steps are ignored.

        Raises:
            WcsimError: It may not be pressed yet, or a question's answers are due.
        """
        if step != self._at or self.step.kind is StepKind.END:
            return
        if self.step.kind is StepKind.ASK:
            raise WcsimError("the questions are not answered yet; answer them first")
        if self.step.kind is StepKind.REST and self._hands.clock() < self._rested_s:
            raise WcsimError("the rest is not over yet; wait until it is")
        if self.step.kind is StepKind.READ and self._session is None:
            self._prepare()
            return
        if self.step.kind is StepKind.DRIVE:
            self._finish("stopped")
            return
        self._next()

    def answer(self, step: int, answers: Sequence[int]) -> None:
        """Write the answers to this step's questions: numbers from 0; `_NO_ANSWER` skips.

        Raises:
            WcsimError: They are not this step's, or could not be written.
        """
        if step != self._at or self.step.kind is not StepKind.ASK:
            return
        asked = step_questions(self._study.file, self.step)
        told: dict[str, str] = {}
        if len(answers) != len(asked):
            raise WcsimError(f"got {len(answers)} answers; expected {len(asked)}: reload the page")
        for question, number in zip(asked, answers, strict=True):
            words = answer_choices(question)
            if not _NO_ANSWER <= number < len(words):
                raise WcsimError(
                    f"got answer {number} to question {question.name}; "
                    f"expected 0 to {len(words) - 1}: reload the page"
                )
            told[question.column] = "" if number == _NO_ANSWER else words[number]
        part = self.step.part
        self._write(_head(self._study, END) if part is None else self._rows[part.block.name], told)
        # The table has the part's figures now, so their file goes: a part that is driven again, as
        # after a pilot, must not count as driven.
        if part is not None:
            path = self._result(part)
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                self._hands.say(
                    f"{escape(path)}: cannot be removed ({error.strerror}); "
                    "its row is in the table: remove the file"
                )
        self._next()

    def wait(self) -> None:
        """Time passes without a tick: a page that opens during a rest shows what is left of it."""
        left_s = max(0.0, self._rested_s - self._hands.clock())
        if self.step.kind is StepKind.REST and math.ceil(left_s) != self._shown_s:
            self._tell_rest(left_s)

    def driven(self) -> None:
        """A tick has been driven: the part is over after its time, or its arrivals."""
        session, part = self._session, self.step.part
        if session is None or part is None or self.step.kind is not StepKind.DRIVE:
            return
        block, self._failed = part.block, self._failed or bool(session.assistance.failed)
        left_s = 60.0 * block.minutes - session.counted_s
        over = block.arrivals is not None and session.metrics.arrivals >= block.arrivals
        if over or left_s <= 1e-6:
            self._finish("arrivals" if over else "minutes")
        elif int(left_s) != self._shown_s:
            self._tell_left()

    # --- steps ---

    def _next(self) -> None:
        self._at += 1
        self._enter()

    def _enter(self) -> None:
        step = self.step
        self._view = step_view(self._study.file, step, self._at, self._study.participant)
        if step.kind is StepKind.READ:
            self._prepare()
        elif step.kind is StepKind.DRIVE:
            self._tell_left()
        elif step.kind is StepKind.REST:
            self._rested_s = self._hands.clock() + self._study.file.pause_s
            self._tell_rest(self._study.file.pause_s)
        else:
            self._show()

    def _prepare(self) -> None:
        """Open the part's street, while the participant reads what it is."""
        part = self.step.part
        if part is None:
            return
        self._show(ready=False, trouble="")
        self._file, self._failed = "", False
        name = f"{part.number}-{part.block.name}.drive"
        path = next(iter_unused_paths(self._study.folder / name), None)
        try:
            if path is None:
                raise WcsimError(
                    f"{escape(self._study.folder / name)}: all file names for this part are taken; "
                    "remove old attempts"
                )
            session = self._hands.open(
                study_start(self._study.file, part.place, self._study.network), path
            )
            if part.block.level is not None:
                session.set_level(part.block.level)
            session.assist(part.block.assistance)
        except WcsimError as error:
            self._show(ready=True, button="Try again", trouble=str(error))
            return
        self._session, self._file = session, str(path)
        self._view = step_view(self._study.file, self.step, self._at, self._study.participant)
        self._show()

    def _finish(self, ended: str) -> None:
        """A part has been driven: keep its figures, until the answers to it are there.

        Why it has `ended`: "minutes", "arrivals", or "stopped" by the participant.
        """
        session, part = self._session, self.step.part
        if session is None or part is None:
            return
        metrics, place = session.metrics, session.place
        moving_s = metrics.moving_ticks * session.tick_s
        row: Row = {
            **_head(self._study, part.block.name),
            "part": str(part.number),
            "assistance": "on" if part.block.assistance else "off",
            "level": "" if session.assistance.level is None else f"{session.assistance.level:g}",
            "policy": session.assistance.name,
            "town": place.town.name,
            "seed": str(place.seed),
            "episode": place.episode,
            "recording": self._file,
            "ended": ended,
            "minutes": f"{session.counted_s / 60.0:.4f}",
            "kpi1": "" if metrics.kpi1 is None else f"{metrics.kpi1:.5f}",
            "kpi2": f"{metrics.kpi2:.2f}",
            "distance_m": f"{session.way_m:.2f}",
            "speed_mps": f"{session.way_m / moving_s:.4f}" if moving_s else "",
            "overrulings": str(metrics.overrules),
            **{name: str(getattr(metrics, name)) for name in _COUNTED},
            "policy_failed": "yes" if self._failed else "no",
        }
        self._session, self._rows[part.block.name] = None, row
        self._hands.close()
        try:
            after = self._steps[self._at + 1]
            # Questions at the end of the study have no part.
            if after.kind is StepKind.ASK and after.part is part and part.number:
                append_row(self._result(part), table_columns(self._study.file), row)
            else:
                self._write(row, {})
        except WcsimError as error:
            self._hands.say(
                f"{error}; the results of this part: {', '.join(map(str, row.values()))}"
            )
        self._next()

    def _result(self, part: StudyPart) -> Path:
        return self._study.folder / f"{part.number}-{part.block.name}.csv"

    def _write(self, row: Row, answers: Row) -> None:
        append_row(self._study.table, table_columns(self._study.file), {**row, **answers})
        self._hands.say(
            f"participant {self._study.participant}: "
            f"{row['block']} saved in {escape(self._study.table)}"
        )

    # --- what is shown ---

    def _tell_left(self) -> None:
        session, part = self._session, self.step.part
        if session is None or part is None:
            return
        left_s = max(0.0, 60.0 * part.block.minutes - session.counted_s)
        arrivals = part.block.arrivals
        self._shown_s = int(left_s)
        arrivals_left = None if arrivals is None else arrivals - session.metrics.arrivals
        self._show(left_s=left_s, arrivals_left=arrivals_left)

    def _tell_rest(self, left_s: float) -> None:
        self._shown_s = math.ceil(left_s)
        self._show(wait_s=left_s)

    def _show(self, **changes: object) -> None:
        self._view = {**self._view, **changes}
        self._hands.show(self._view)


def _shipped_studies() -> tuple[str, ...]:
    """The studies that come with wcsim."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.toml")))


def _participant_rows(study: OpenStudy) -> tuple[dict[str, str], ...]:
    """The participant's rows. Raises ConfigError for a table of another study."""
    rows = read_rows(study.table, table_columns(study.file))
    other = next((row for row in rows if row["study_sha256"] != study.sha256[:12]), None)
    if other is not None:
        raise ConfigError(
            f"{escape(study.table)}: belongs to another study file "
            f"({escape(other['study_sha256'], 12)}, this is {study.sha256[:12]}); "
            "expected the same file: restore it, or name another folder with --out"
        )
    return tuple(row for row in rows if row["participant"] == str(study.participant))


def _require_levels(study: OpenStudy, where: str) -> None:
    """Set each level once. Raises PolicyError or ConfigError: the policy does not have it."""
    file = study.file
    blocks = [*file.blocks, *([file.practice] if file.practice else [])]
    wanted = {block.level: block.name for block in blocks if block.level is not None}
    policy = open_named_policy(
        file.policy, resolve_policy_config(file.policy, PRESET, ()), 0, study.network or None
    )
    try:
        for level, name in wanted.items():
            levels = policy.levels if isinstance(policy, Levelled) else None
            if levels is None or not min(levels) <= level <= max(levels):
                told = (
                    "no levels"
                    if levels is None
                    else f"levels of {min(levels):g} to {max(levels):g}"
                )
                raise ConfigError(
                    f"{where}: block {name} has level {level:g}, but policy {policy.name} has "
                    f"{told}; change the level or the policy"
                )
    finally:
        close = getattr(policy, "close", None)
        if close is not None:
            close()


def _head(study: OpenStudy, block: str) -> dict[str, str]:
    return {
        "study": study.file.name,
        "study_sha256": study.sha256[:12],
        "wcsim": read_wcsim_version(),
        "participant": str(study.participant),
        "order": study.order,
        "block": block,
    }

"""Small studies for tests, and who goes through them without a page."""

from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

from wcsim.core.files import iter_unused_paths
from wcsim.drive.recording.session_recorder import SessionRecorder
from wcsim.drive.recording.study_lead import OpenStudy, StudyHands, StudyLead
from wcsim.drive.recording.study_plan import StepKind
from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart
from wcsim.types import Joystick

STUDY = """
name = "tiny"
title = "A tiny study"
told = ["Drive."]
pause_s = 5
thanks = ["Thanks."]
[[places]]
town = "{town}"
seed = 4
[practice]
name = "practice"
title = "Practice"
assistance = true
minutes = 0.05
[[blocks]]
name = "alone"
title = "Alone"
assistance = false
minutes = 0.05
[[blocks]]
name = "more"
title = "With more"
told = ["It helps."]
assistance = true
level = 1.5
minutes = 0.05
[[questions]]
name = "effort"
asks = "How hard was it?"
low = "easy"
high = "hard"
[[questions]]
name = "again"
asks = "Again?"
kind = "yes_no"
[[questions]]
name = "best"
asks = "Which one?"
kind = "choice"
choices = ["alone", "with more"]
after = "end"
"""

AHEAD = Wish(stick=Joystick(0.0, 0.8))


def write_study(folder: Path, town: Path, text: str = STUDY) -> Path:
    path = folder / "tiny.toml"
    path.write_text(text.replace("{town}", str(town)))
    return path


class Participant:
    """Somebody who reads, drives and answers; it stands for runner and page."""

    def __init__(self, study: OpenStudy) -> None:
        self.views: list[SimpleNamespace] = []
        self.said: list[str] = []
        self.now_s = 100.0
        self.session: DriveSession | None = None
        self.broken = False
        self._held = ExitStack()
        hands = StudyHands(
            open=self._open,
            close=self.close,
            show=lambda view: self.views.append(SimpleNamespace(**view)),
            say=self.said.append,
            clock=lambda: self.now_s,
        )
        self.lead = StudyLead(study, hands)
        self.lead.begin()

    @property
    def view(self) -> SimpleNamespace:
        return self.views[-1]

    def _open(self, start: DriveStart, path: Path) -> DriveSession:
        self.close()
        self.session = self._held.enter_context(DriveSession(start))
        self.session.add_observer(SessionRecorder(self.session, iter_unused_paths(path), lambda _: None))
        return self.session

    def close(self) -> None:
        self._held.close()
        self.session = None

    def press(self) -> None:
        self.lead.go_on(self.view.step)

    def drive(self, ticks: int = 200) -> int:
        """Until the part is over, or so many ticks; how many there were."""
        for number in range(ticks):
            if not self.lead.drives or self.session is None:
                return number
            self.session.tick(AHEAD)
            self.lead.driven()
        return ticks

    def answer(self, *answers: int) -> None:
        self.lead.answer(self.view.step, answers)

    def until(self, kind: StepKind) -> None:
        """Press, rest and drive till a step of this kind comes; questions are answered with the first answers."""
        for _ in range(40):
            if self.view.kind is kind:
                return
            if self.view.kind is StepKind.DRIVE:
                self.drive()
            elif self.view.kind is StepKind.ASK:
                self.answer(*[0 for _ in self.view.questions])
            else:
                self.now_s += self.view.wait_s
                self.press()
        raise AssertionError(self.view)

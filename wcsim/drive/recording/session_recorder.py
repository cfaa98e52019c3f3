"""Records a drive in a file from which the same drive can be simulated (docs/recordings.md)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from wcsim.bridge.replay.replayed import first_inputs
from wcsim.bridge.user_drives import drive_header
from wcsim.core.reading import escape
from wcsim.drive.driven import DriveRecord, DriverKind, EventKind
from wcsim.drive.session import DriveSession
from wcsim.errors import WcsimError
from wcsim.log.records import (
    MOST_DETAIL,
    Admitted,
    Dismissed,
    DriveTick,
    Header,
    Input,
    Note,
    with_fields,
)
from wcsim.log.writer import LogWriter
from wcsim.users.profiles import profile_to_json

_NO_NAME = "all names for a further file are taken; start wcsim drive again"
_RECORDED = (
    "the simulated user is a recording, which a drive cannot be replayed with; choose a profile"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderStatus:
    """What has changed about the recording."""

    on: bool  # ticks go into a file
    file: str = ""  # it, or the one that they went into
    told: str = ""  # for the person
    log: str = ""  # for the console; "" for nothing to log


class SessionRecorder:
    """Records a session from its first tick on. A file that cannot be written never ends the drive.

    Args:
        session: What is recorded; it has not been driven yet.
        names: Of new files, one for each world.
        tell: Called when a recording begins and ends.
    """

    def __init__(
        self, session: DriveSession, names: Iterator[Path], tell: Callable[[RecorderStatus], object]
    ) -> None:
        self._session, self._names, self._tell = session, names, tell
        self._recorder: LogWriter | None = None
        # Of the world that is driven; None where nothing is kept of it.
        self._header: Header | None = None
        self._file = ""
        # From before the first tick, when there is no file yet.
        self._waiting: list[Input | Note] = []
        self._before, self._kept = session.ticks, 0
        self._begin()

    def __call__(self, record: DriveRecord) -> None:
        """Write it; a world's end is a file's end."""
        if isinstance(record, Note) and record.kind == EventKind.REBUILT:
            self.close()
            self._before = record.tick
            self._begin()
            return
        if self._header is None:
            return
        if isinstance(record, Admitted):
            user = self._session.world.seats[0].profile
            if user is None:
                self._stop(_RECORDED)
                return
            self._write(Dismissed(epoch=0, tick=record.tick, seat=0))
            record = with_fields(record, spec=replace(record.spec, profile=profile_to_json(user)))
        elif isinstance(record, Note):
            record = with_fields(record, detail=record.detail[:MOST_DETAIL])
        self._write(record)

    def close(self) -> None:
        """The file is whole; a second call does nothing."""
        self._header = None
        if self._recorder is not None:
            recorder, self._recorder = self._recorder, None
            recorder.close()
            minutes = self._kept * self._session.tick_s / 60.0
            log = f"wrote {escape(self._file)}: {self._kept} ticks, {minutes:.1f} min"
            self._tell(RecorderStatus(on=False, file=self._file, log=log))

    # --- files ---

    def _begin(self) -> None:
        """Another world: what its file begins with, or why there is none."""
        session, place = self._session, self._session.place
        beside = session.world.seats[0].profile
        self._file, self._waiting, self._kept = "", [], 0
        # A recorded user beside the person may belong to a generated scene, which makes it again.
        same_user = session.profile == place.spec.profile
        sits_in_scene = place.scene and not place.start.profile and same_user
        if beside is None and not sits_in_scene:
            self._stop(_RECORDED)
            return
        self._header = drive_header(
            place.town,
            place.config,
            place.seed,
            policy=session.assistance.name,
            level="" if session.assistance.level is None else f"{session.assistance.level:g}",
            episode=place.episode,
            scene=place.scene,
        )
        # "" is the user of the scene, which is made again.
        sits = "" if beside is None else profile_to_json(beside)
        self._waiting += first_inputs(replace(place.spec, profile=sits), place.seed)
        # The file would not know what was switched before this world.
        if not session.assistance.on:
            self._note_first(EventKind.ASSISTANCE, "off")
        if session.shape != (1.0, 1.0):
            self._note_first(EventKind.STICK_SHAPE, session.shape_told)
        if session.driver is DriverKind.SIMULATED:
            self._note_first(EventKind.DRIVER, session.driver.value)
        self._tell(RecorderStatus(on=True, told="Recording starts when you drive."))

    def _open(self, header: Header) -> LogWriter:
        path = next(self._names, None)
        if path is None:
            raise WcsimError(_NO_NAME)
        self._recorder, self._file = LogWriter(path, header), str(path)
        for event in self._waiting:
            self._recorder.append(event)
        self._waiting = []
        log = f"recording to {escape(path)}: {self._session.place.told}"
        self._tell(RecorderStatus(on=True, file=self._file, log=log))
        return self._recorder

    def _write(self, record: DriveRecord | Dismissed) -> None:
        """Write it, with number and time in the file's world; before its first tick it waits."""
        place: dict[str, float] = {"tick": record.tick - self._before}
        if isinstance(record, DriveTick | Note):
            place["time_s"] = place["tick"] * self._session.tick_s
        record = with_fields(record, **place)
        if self._recorder is None and not isinstance(record, DriveTick):
            self._waiting.append(record)
            return
        try:
            if self._header is not None:
                (self._recorder or self._open(self._header)).append(record)
                self._kept += isinstance(record, DriveTick)
        except WcsimError as error:
            self._stop(str(error))

    def _note_first(self, kind: EventKind, told: str) -> None:
        self._waiting.append(Note(tick=0, time_s=0.0, kind=kind, detail=told))

    def _stop(self, why: str) -> None:
        """Nothing more is kept of this world; what was, is."""
        self.close()
        told = "Recording has stopped" if self._file else "This drive is not recorded"
        log = f"not recording: {why}"
        self._tell(RecorderStatus(on=False, file=self._file, told=f"{told}: {why}", log=log))

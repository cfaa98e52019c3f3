"""A recorded joystick in the place of a simulated user, and the file that it is read from.

The file is a recorded drive (`log/drive.py`), whose episodes are replayed in their order, or a
table of comma-separated values. Its columns are time_s, x (right) and y (forward), or t_s, axis0
(left) and axis1 (forward), the axes of ROS's joystick message. A sample holds until the next one.
Recording and episode start together. After the recording the stick rests and the user gives up.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Final

import numpy as np

from wcsim.core.constants import RECORDED
from wcsim.core.reading import STICK, escape, read_lines
from wcsim.errors import ConfigError, JournalError
from wcsim.log.drive import read_drive, read_wcsim_version
from wcsim.log.reader import is_log_file
from wcsim.log.records import DriveTick
from wcsim.types import F64, Joystick, Outline, UserView
from wcsim.users.hand import clip_to_disc
from wcsim.users.profiles import UserProfile, find_profile, profile_from_json
from wcsim.users.user import User

COLUMNS: Final = ("time_s", "x", "y")
_ROS_COLUMNS: Final = ("t_s", "axis0", "axis1")
_BOUNDS: Final = {"time_s": "seconds", "x": "-1 to 1", "y": "-1 to 1"}
_LONGEST_GAP_S: Final = 0.5
_SAME_TIME_S: Final = 1e-6
MOST_SAMPLES = 1_000_000  # an hour of 240 a second


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _JoystickRecording:
    """A joystick over time; see `read_stick_recording` and `_joystick_of_drive`."""

    name: str
    time_s: F64  # (n,) rising, from 0 to _LONGEST_GAP_S on, n >= 2
    sticks: F64  # (n, 2) x, y on the unit disc
    intents: F64 | None = None  # (n, 2) the intent from then on, where that is known
    town: str = ""  # that it was driven in, where that is known
    town_sha256: str = ""  # of that town's content
    # Of a drive that has several, the first one among them.
    episodes: tuple[_JoystickRecording, ...] = ()

    @property
    def end_s(self) -> float:
        """When the last sample, held as long as an average one, is over."""
        return float(self.time_s[-1] + (self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    def at(self, time_s: F64) -> F64:
        """The stick (N, 2) at times (N,); at rest before the first sample and after the end."""
        index = np.searchsorted(self.time_s, time_s + _SAME_TIME_S, side="right") - 1
        there = (index >= 0) & (time_s < self.end_s - _SAME_TIME_S)
        return np.where(there[:, None], self.sticks[index], 0.0)

    def intent_at(self, time_s: float) -> Joystick | None:
        """The intent at a time; None where that is not known."""
        if self.intents is None or time_s >= self.end_s - _SAME_TIME_S:
            return None
        index = int(np.searchsorted(self.time_s, time_s + _SAME_TIME_S, side="right")) - 1
        return Joystick(*self.intents[index].tolist()) if index >= 0 else None

    def user(self, episode: int, outline: Outline) -> _RecordedUser:
        """The user that replays an episode of it; after the last episode the first is next."""
        recording = self.episodes[episode % len(self.episodes)] if self.episodes else self
        return _RecordedUser(recording, outline)

    def require_driven_here(self, town: str, town_sha256: Callable[[], str]) -> None:
        """Refuse a drive of another town, or of another state of this one.

        Raises:
            ConfigError: With both towns.
        """
        if self.town_sha256 and self.town_sha256 != (here := town_sha256()):
            raise ConfigError(
                f"{escape(self.name)}: was driven in {escape(self.town, 80)} "
                f"({self.town_sha256[:12]}), this is {town} ({here[:12]}); "
                "expected the same town: name it, or restore its files"
            )


class _RecordedUser(User):
    """Replays a recording in one episode. It never requests help, and ends with the recording.

    Where the intent beyond what the hand did is not known, the intent is the stick itself.
    """

    def __init__(self, recording: _JoystickRecording, outline: Outline) -> None:
        super().__init__(recording.at(np.zeros(1)))
        self._recording = recording
        self._middle_x_m = outline.middle_x_m
        self._time_s = 0.0
        self._has_ended = False

    @property
    def intent(self) -> Joystick:
        """The intent in the recording, else the stick itself."""
        return self._recording.intent_at(self._time_s) or self.joystick

    def move_hand(self, steps: int, dt_s: float) -> Joystick:
        """Move on by a tick of `steps` physics steps; the stick afterwards."""
        times_s: F64 = self._time_s + dt_s * np.arange(1, steps + 1, dtype=np.float64)
        self._sticks = self._recording.at(times_s)
        self._time_s += steps * dt_s
        return self.joystick

    def look(self, view: UserView) -> None:
        """Note how far the chair has come; at the recording's end the user gives up, once."""
        if self._path is None:
            return
        self._move_along(self._path, self._middle_arc_m(self._path, view, self._middle_x_m))
        if not self._has_ended and self._time_s >= self._recording.end_s - _SAME_TIME_S:
            self._has_ended = True
            self.gave_up = True


def find_user(name: str) -> UserProfile | _JoystickRecording:
    """The user called `name`.

    It is a profile, that of a file "FILE.toml" or of `profile_to_json`, or the recording of
    "recorded:FILE".

    Raises:
        ConfigError: There is no such profile (the message names all), or the file cannot be used.
    """
    if name.startswith(RECORDED):
        return read_stick_recording(FilePath(name.removeprefix(RECORDED)))
    if name.startswith("{"):
        return profile_from_json(name, "a user's profile as JSON")
    return find_profile(name)


def read_stick_recording(path: FilePath) -> _JoystickRecording:
    """Read and check a recorded joystick: a drive, or a table.

    Raises:
        ConfigError: The file cannot be read, has no samples, or one of them is no number, out of
            bounds, not later than the one before, or more than 0.5 s later; with the line, the
            value and what was expected. Or it is a drive of another version of wcsim.
    """
    if is_log_file(path):
        return _joystick_of_drive(path)
    numbers = array("d")
    for line, row, right in _rows(path):
        where = f"{escape(path)}:{line}"
        if len(numbers) >= 3 * MOST_SAMPLES:
            raise ConfigError(
                f"{where}: more than {MOST_SAMPLES} samples; expected at most so many: cut the file"
            )
        time_s, x, y = _sample(where, row)
        before_s = numbers[-3] if numbers else None
        if before_s is None:
            if not 0.0 <= time_s <= _LONGEST_GAP_S:
                raise ConfigError(
                    f"{where}: time_s is {time_s} s; "
                    f"expected the first sample at 0 to {_LONGEST_GAP_S} s"
                )
        elif not before_s < time_s <= before_s + _LONGEST_GAP_S + _SAME_TIME_S:
            raise ConfigError(
                f"{where}: time_s is {time_s} s after {before_s} s; "
                f"expected later, by at most {_LONGEST_GAP_S} s: "
                "a gap is not filled, cut the recording there"
            )
        numbers.extend((time_s, right * x, y))
    table = np.array(numbers).reshape(-1, 3)
    if len(table) < 2:
        raise ConfigError(
            f"{escape(path)}: {len(table)} samples; "
            f"expected at least two lines below {','.join(COLUMNS)}"
        )
    # As `clip_to_disc` has it, of all samples at once.
    sticks = table[:, 1:] / np.maximum(np.hypot(table[:, 1], table[:, 2]), 1.0)[:, None]
    return _JoystickRecording(name=str(path), time_s=table[:, 0], sticks=sticks)


def _rows(path: FilePath) -> Iterator[tuple[int, list[str], float]]:
    """Line number and words of each sample, and the sign of x to the right.

    A message shows nothing of a file that is no recording: it may be any file.
    """
    lines = read_lines(path, STICK)
    names = tuple(word.strip(' \t\r\n"') for word in next(lines, "").split(","))
    if names not in (COLUMNS, _ROS_COLUMNS):
        expected = f"expected the line {','.join(COLUMNS)} (or {','.join(_ROS_COLUMNS)})"
        raise ConfigError(f"{escape(path)}:1: other column names; {expected}")
    for number, line in enumerate(lines, start=2):
        for row in csv.reader((line,)):
            if row:
                yield number, row, 1.0 if names == COLUMNS else -1.0


def _sample(where: str, row: list[str]) -> tuple[float, float, float]:
    """Time and stick of a row, each a number, the stick within its bounds."""
    if len(row) != len(COLUMNS):
        raise ConfigError(f"{where}: {len(row)} values; expected {','.join(COLUMNS)}")
    values = []
    for name, text in zip(COLUMNS, row, strict=True):
        try:
            values.append(float(text))
        except ValueError:
            raise ConfigError(
                f"{where}: {name} is not a number; expected {_BOUNDS[name]}"
            ) from None
    time_s, x, y = values
    for name, value in (("x", x), ("y", y)):
        if not -1.0 <= value <= 1.0:
            raise ConfigError(f"{where}: {name} is {value}; expected -1 to 1")
    return time_s, x, y


def _joystick_of_drive(path: FilePath) -> _JoystickRecording:
    """The joystick of a recorded drive, episode by episode.

    Raises:
        ConfigError: It cannot be read, has no tick, or was made by a version of wcsim whose chairs
            moved differently.
    """
    try:
        drive = read_drive(path)
    except JournalError as error:
        raise ConfigError(str(error)) from None
    header = drive.header
    if not drive.moves_as_here:
        raise ConfigError(
            f"{escape(path)}: was driven with wcsim {escape(drive.about.wcsim, 40)}, "
            f"this is {read_wcsim_version()}; "
            "expected the same, as chairs and streets may differ: record it again"
        )
    if not drive.ticks:
        raise ConfigError(f"{escape(path)}: is empty; expected a drive with at least one tick")
    episodes = tuple(_joystick_of(part, header.tick_s, str(path)) for part in drive.episodes)
    return replace(
        episodes[0], town=header.town_name, town_sha256=header.town_sha256, episodes=episodes
    )


def _joystick_of(ticks: Sequence[DriveTick], tick_s: float, name: str) -> _JoystickRecording:
    """One episode; at the ticks' borders the stick is exact, within them as it was sampled."""
    times, sticks, intents = [], [], []
    for number, tick in enumerate(ticks):
        samples = [(tick.stick.x, tick.stick.y), *tick.sticks[:-1].tolist()]
        times += [tick_s * (number + k / len(samples)) for k in range(len(samples))]
        sticks += samples
        intents += [tick.intent] * len(samples)
    last = ticks[-1].sticks[-1].tolist() if len(ticks[-1].sticks) else sticks[-1]
    times.append(tick_s * len(ticks))
    sticks.append((last[0], last[1]))
    intents.append(ticks[-1].intent)
    known = [(intent.x, intent.y) for intent in intents if intent is not None]
    return _JoystickRecording(
        name=name,
        time_s=np.array(times),
        sticks=np.array([clip_to_disc(x, y) for x, y in sticks]),
        intents=np.array(known) if len(known) == len(intents) else None,
    )

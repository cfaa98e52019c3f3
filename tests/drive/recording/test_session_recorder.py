"""What a person drove is kept, and made again to the last bit."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wcsim.agents.opening.list_file import open_suite
from wcsim.bridge.ego import ego
from wcsim.bridge.replay.replayed import _made_scene, verify
from wcsim.bridge.user_drives import seen_drive, with_shadow
from wcsim.core.files import iter_unused_paths
from wcsim.drive import starting
from wcsim.drive.driven import DriverKind, EventKind
from wcsim.drive.recording.session_recorder import RecorderStatus, SessionRecorder
from wcsim.drive.session import DriveSession, Wish
from wcsim.drive.starting import DriveStart, check_recordable
from wcsim.errors import ConfigError, DiskFullError, TownError
from wcsim.log.drive import DriveRecording, read_drive
from wcsim.log.records import Admitted, Dismissed, Respawned, with_fields
from wcsim.log.writer import LogWriter
from wcsim.types import Joystick
from wcsim.users.profiles import find_builtin_profile
from wcsim.users.recordings.recorded_user import find_user
from wcsim.users.user import User

TIGHT_BLOCK = 16  # of dev2: a generated scene
WEAVES = [Wish(stick=Joystick(0.4 * math.sin(0.3 * number), 0.9)) for number in range(40)]


class Kept:
    """A session that is kept, and what was told of it."""

    def __init__(self, start: DriveStart, path: Path) -> None:
        self.news: list[RecorderStatus] = []
        self.path, self.session = path, DriveSession(start)
        self.session.add_observer(SessionRecorder(self.session, iter_unused_paths(path), self.news.append))

    def drive(self, ticks: int, more: Wish | None = None) -> None:
        for number in range(ticks):
            self.session.tick(more or WEAVES[number % len(WEAVES)])

    def files(self) -> list[Path]:
        return list(dict.fromkeys(Path(news.file) for news in self.news if news.file))

    def read(self) -> DriveRecording:
        """What is in its file, once it is over."""
        self.session.close()
        return read_drive(self.path)

    def again(self) -> DriveRecording:
        self.session.close()
        return same_again(self.path)


Keep = Callable[..., Kept]


@pytest.fixture
def keep(corner: Path, tmp_path: Path) -> Keep:
    """Begins a drive in the little town that is kept."""
    return lambda **start: Kept(DriveStart(town=str(corner), seed=4, **start), tmp_path / "a.drive")


@pytest.fixture
def kept(keep: Keep, monkeypatch: pytest.MonkeyPatch) -> Iterator[Kept]:
    monkeypatch.setattr(starting, "LONGEST_STEPS", 45)
    drive = keep()
    yield drive
    drive.session.close()


def users_of(drive: DriveRecording) -> list[object]:
    """Who sat in it, one after the other."""
    return [find_user(record.spec.profile) for record in drive.records if isinstance(record, Admitted)]


def same_again(path: Path) -> DriveRecording:
    drive = read_drive(path)
    found = verify(drive)
    assert (found.ticks, found.mismatches, found.farthest_m) == (len(drive.ticks), 0, 0.0), found
    return drive


def test_a_drive_with_everything_in_it_is_made_again_to_the_last_bit(kept: Kept, tmp_path: Path) -> None:
    session = kept.session
    session.face_way()
    session.assist(False)
    while not session.ended:
        kept.drive(1, Wish(stick=Joystick(0.5, 0.8)))
    crashed = session.ticks
    session.assist(True)
    kept.drive(1)
    session.new_place()
    kept.drive(11)
    session.set_level(2.0)
    kept.drive(3, Wish(stick=Joystick(0.0, 1.0), overrule=True, help=True))
    session.assist(False)
    session.drive_by(DriverKind.SIMULATED)
    kept.drive(15)
    session.say(EventKind.PAUSED)
    session.say(EventKind.GOES_ON)
    session.drive_by(DriverKind.PERSON)
    session.new_place()
    session.new_place()
    kept.drive(8)
    session.change_user("slow")
    with pytest.raises(ConfigError):
        session.change_user("nobody")
    kept.drive(50)
    session.assist(True)
    kept.drive(10)
    session.again()
    kept.drive(20)
    session.close()

    first, second = kept.files()
    assert (first, second) == (tmp_path / "a.drive", tmp_path / "a-2.drive")
    drive = same_again(first)
    assert drive.ticks[crashed - 1].crashed
    assert math.dist(drive.ticks[crashed].p_WB_m, drive.ticks[0].p_WB_m) < 0.3, "it goes on where it began, so near"
    assert (len(drive.ticks), drive.about.driver, drive.about.policy) == (crashed + 98, "person", "dwa")
    assert [user.name for user in users_of(drive)] == ["competent", "slow", "slow"]
    flags = [(tick.overruled, tick.helped) for tick in drive.ticks]
    assert flags.count((True, True)) == 3 and flags.count((False, False)) == crashed + 95
    assert sum(tick.truncated for tick in drive.ticks) == 1
    users = drive.ticks[crashed + 15 : crashed + 30]
    assert all(tick.intent is not None and tick.sticks.shape == (24, 2) for tick in users)
    assert all(tick.intent is None and tick.sticks.shape == (0, 2) for tick in drive.ticks[: crashed + 15])
    assert np.allclose(users[3].sticks[-1], (users[4].stick.x, users[4].stick.y), atol=1e-6)
    respawned = [record for record in drive.records if isinstance(record, Respawned)]
    assert len(respawned) > 4, "three were asked for, one is that after the crash, and some turn to their way"
    again = same_again(second)
    assert (len(again.ticks), again.ticks[0].tick) == (20, 1)
    assert users_of(again) == [find_builtin_profile("slow")], "the street begins with who sits there now"
    assert not kept.news[-1].on and "20 ticks" in kept.news[-1].log


def test_how_the_stick_was_shaped_before_a_world_is_in_its_file(keep: Keep) -> None:
    drive = keep(speed=0.5)
    drive.drive(3)
    notes = [note for note in drive.again().events if note.kind == EventKind.STICK_SHAPE]
    assert [note.detail for note in notes] == ["speed 0.5, sensitivity 1"]


def test_a_change_that_is_left_out_is_noticed(kept: Kept) -> None:
    """Each of what is noted matters: without it the drive is another one."""
    kept.drive(10)
    kept.session.change_user("slow")
    kept.drive(10)
    drive = kept.read()
    assert verify(drive).mismatches == 0
    kept_records = tuple(record for record in drive.records if not isinstance(record, Respawned | Dismissed))
    first, *others = (record for record in kept_records if isinstance(record, Admitted))
    assert others and first != others[0]
    left_out = replace(drive, records=tuple(record for record in kept_records if record not in others))
    assert verify(left_out).mismatches > 5


def test_ways_end_as_they_did(keep: Keep, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next way begins where the user beside says that this one is over."""
    monkeypatch.setattr(ego, "_GOAL_RANGE_M", (2.0, 5.0))
    drive = keep(policy="follow")
    session = drive.session
    for _ in range(150):
        session.tick(Wish(stick=session.client.user))  # a person, who drives as the user would
    made = drive.again()
    assert sum(tick.arrived for tick in made.ticks) >= 2 and not any(tick.intent for tick in made.ticks)
    late = [with_fields(tick, arrived=False) for tick in made.ticks]
    firsts = made.records[:2]
    assert verify(replace(made, records=(*firsts, *late))).mismatches >= 2, "an end that differs is noticed"


def test_a_person_is_patient_and_a_user_is_not(keep: Keep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    user = tmp_path / "hasty.toml"
    user.write_text('base = "competent"\ngive_up_s = 1.0\n')
    drive = keep(policy="zero", profile=str(user))
    drive.drive(90)
    drive.session.drive_by(DriverKind.SIMULATED)
    drive.drive(5)
    drive.session.assist(False)
    drive.drive(15)
    made = drive.again()
    gave_up = [number for number, tick in enumerate(made.ticks) if tick.gave_up]
    assert gave_up and gave_up[0] >= 90, "who stood for 9 s was a person"
    monkeypatch.setattr(User, "patient", property(lambda _: False, lambda *_: None), raising=False)
    assert verify(made).mismatches > 10


def test_a_person_who_was_kept_is_a_user(kept: Kept) -> None:
    kept.drive(20)
    drive, user = kept.read(), find_user(f"recorded:{kept.path}")
    assert not hasattr(user, "reaction_s")
    assert user.at(np.array([0.5]))[0] == pytest.approx((drive.ticks[5].stick.x, drive.ticks[5].stick.y))


def test_a_full_disk_ends_the_file_and_never_the_drive(
    kept: Kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept.drive(10)
    with monkeypatch.context() as full:
        full.setattr(LogWriter, "_write", lambda *_: (_ for _ in ()).throw(DiskFullError("a.drive: make room")))
        kept.drive(5)
    assert not kept.news[-1].on and "Recording has stopped" in kept.news[-1].told
    kept.drive(5)
    assert kept.session.ticks == 20
    kept.session.again()
    kept.drive(3)
    assert len(kept.again().ticks) == 10
    assert len(same_again(tmp_path / "a-2.drive").ticks) == 3, "another world is another attempt"


def test_a_drive_beside_a_recorded_user_is_not_kept_and_says_so(kept: Kept) -> None:
    kept.drive(10)
    kept.session.again()
    kept.session.change_user(f"recorded:{kept.path}")
    assert not kept.news[-1].on and "is a recording" in kept.news[-1].told
    kept.drive(3)
    kept.session.close()
    assert kept.files() == [kept.path]


def test_a_drive_that_never_moved_leaves_no_file(kept: Kept, tmp_path: Path) -> None:
    kept.session.new_place()
    kept.session.close()
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_made_again_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"the recorded user recorded:a\.csv cannot be part of a recorded drive"):
        check_recordable(DriveStart(profile="recorded:a.csv"))
    assert check_recordable(DriveStart(suite="dev2", block=TIGHT_BLOCK, profile="")).block == TIGHT_BLOCK


@pytest.mark.parametrize("profile", ["", "competent"])
def test_a_drive_in_a_generated_scene_is_made_again(tmp_path: Path, profile: str) -> None:
    drive = Kept(DriveStart(suite="dev2", block=TIGHT_BLOCK, profile=profile), tmp_path / "a.drive")
    assert drive.session.place.scene
    drive.session.assist(False)
    for _ in range(30):
        drive.session.tick(Wish(stick=Joystick(0.1, 0.8)))
    drive.session.drive_by(DriverKind.SIMULATED)
    drive.drive(10)
    made = drive.again()
    family, seed, _ = made.about.scene.split()
    assert made.header.town_name == f"{family}-{seed}" and not made.about.profile
    (sat,) = (record for record in made.records if isinstance(record, Admitted))
    assert bool(sat.spec.profile) is bool(profile)


def test_a_scene_that_this_wcsim_draws_otherwise_is_refused() -> None:
    with pytest.raises(TownError, match="this wcsim generates another"):
        _made_scene(f"car-door 7 {'0' * 64}")
    for text in ("car-door 7", f"../car 7 {'0' * 64}", f"car-doors 7 {'0' * 64}"):
        with pytest.raises(TownError, match="which this wcsim does not know"):
            _made_scene(text)


def test_of_a_person_the_simulated_stretches_are_left_out_of_what_was_wanted(kept: Kept) -> None:
    kept.drive(8)
    kept.session.drive_by(DriverKind.SIMULATED)
    kept.drive(8)
    kept.session.drive_by(DriverKind.PERSON)
    kept.drive(8)
    made = with_shadow(seen_drive(kept.read()), find_builtin_profile("competent"))
    assert made.knows_intents
    assert [(tick.tick, tick.episode) for tick in made.ticks] == [
        *((number, 0) for number in range(1, 9)),
        *((number, 1) for number in range(17, 25)),
    ]


@pytest.mark.proof
def test_an_episode_of_a_suite_with_a_handover_is_made_again(tmp_path: Path) -> None:
    blocks = open_suite("dev2").file.blocks
    index, handover = next((n, b.episodes[0].handover_step) for n, b in enumerate(blocks) if b.part == "streets")
    drive = Kept(DriveStart(suite="dev2", block=index, profile=""), tmp_path / "a.drive")
    drive.drive(handover + 12)
    made = drive.again()
    (sat,) = (record for record in made.records if isinstance(record, Admitted))
    assert made.about.episode == f"dev2 {index}.0" and sat.spec.start is not None
    drivers = [tick.intent is not None for tick in made.ticks]
    assert drivers == [number < handover for number in range(handover + 12)], "the user drives until the handover"

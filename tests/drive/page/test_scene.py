"""The street in Chromium, drawn by software: what is hostile in it is left out, and the page draws on."""

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.drive.page.stage import ABOUT, CHROMIUM, FLAGS, IN_CHROMIUM, STATE, PageAlone, axe_finds_nothing
from wcsim.drive.session import DriveSession
from wcsim.drive.starting import DriveStart
from wcsim.view.street_pictures import moment_of
from wcsim.view.street_scene import CameraKind, StreetFeed

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(900)]
EVIL = '"><img src=x onerror=document.title=1><script>document.title=1</script>'
FILM = {
    "title": EVIL, "tick_s": 0.1, "ticks": 2, "points": [], "tells_unsafe": True, "camera": "", "live": False,
    "unknown": [EVIL], "failed": [{"policy": EVIL, "block": 1, "seat": 0, "told": EVIL}], "policy": EVIL, "block": 0,
    "warns": True, "tells_who": True, "actions": "",
}  # fmt: skip
KPIS = dict.fromkeys(("kpi1", "kpi2", "crashes", "drops", "arrivals", "warnings", "interventions")) | {
    "ticks": 1,
    "way_m": 0.0,
}
SHOT = {
    "at": 0, "first": 0, "count": 2, "reading": False, "told": EVIL, "ended": EVIL, "paused": True, "pace": 1.0,
    "live": False, "epoch": 0, "tick": 0, "seat": 0, "crash": EVIL, "size_mb": 0.1,
    "chairs": [{"seat": 0, "name": EVIL, "chair": {"speed_mps": 0.0}, "kpis": KPIS}],
}  # fmt: skip
WORDS: dict[str, list[tuple[str, dict[str, Any]]]] = {
    "index.html": [
        ("about", {**ABOUT, "place": EVIL, "town": EVIL, "policy": EVIL, "profile": EVIL, "towns": [EVIL]}),
        ("notice", {"kind": "bad", "told": EVIL}),
        ("busy", {"told": EVIL, "waits": False}),
        ("state", {**STATE, "crash": EVIL, "waiting": EVIL, "profile": EVIL}),
    ],
    "play.html": [
        ("about", FILM),
        ("marks", {"marks": [[0, 0, EVIL, EVIL], [1, 0, "crash", EVIL]]}),
        ("state", SHOT),
    ],
}


class Street(PageAlone):
    """A page, the files of a street, and its moments."""

    def __init__(self, context: Any, file: str, corner: Path) -> None:
        self.files: dict[str, bytes] = {}
        super().__init__(context, file)
        with DriveSession(DriveStart(town=str(corner), policy="dwa", seed=4), ()) as drive:
            moment = moment_of(drive.world, drive.client, drive.route, drive.done_m)
            feed = StreetFeed(drive.world.street, drive.world.config.cameras[0], 3)
            self.lines: dict[str, dict[str, Any]] = {}
            for name, told in feed.news(moment):
                if isinstance(told, bytes):
                    self.files[name] = told
                else:
                    self.lines[name] = told
            self.moment = feed.picture(moment, CameraKind.NOTHING)

    def _read(self, route: Any) -> None:
        _, is_part, name = route.request.url.partition("/street/")
        if is_part:
            body = self.files.get(name)
            route.fulfill(status=404 if body is None else 200, body=body or b"")
        else:
            super()._read(route)

    def show(self, moment: bytes) -> None:
        """A moment, in the message of its number."""
        self._asked += 1
        self._socket.send(self._asked.to_bytes(4, "little") + moment[4:])

    def draws(self) -> None:
        """It draws another picture of a good moment."""
        before = self.frames()
        self.show(self.moment)
        self.until(lambda: self.frames() > before)

    def seen(self) -> np.ndarray:
        """What the scene looks like without words, (9, 16, 3): its sharpness may change."""
        hide = "for (const each of document.querySelectorAll('#scene ~ *')) each.style.display = 'none'"
        self.page.evaluate(hide)
        picture = cv2.imdecode(np.frombuffer(self.page.locator("#scene").screenshot(), np.uint8), cv2.IMREAD_COLOR)
        return np.asarray(cv2.resize(picture, (16, 9), interpolation=cv2.INTER_AREA), np.float64)

    def frames(self) -> int:
        return int(self.page.evaluate("document.body.dataset.frames ?? 0"))


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        here = {**os.environ, "TMPDIR": "/tmp"}  # noqa: S108
        chromium = play.chromium.launch(
            executable_path=CHROMIUM, args=[*FLAGS, "--enable-unsafe-swiftshader"], env=here
        )
        yield chromium.new_context(viewport={"width": 640, "height": 480})
        chromium.close()


@pytest.mark.parametrize("file", WORDS)
def test_what_is_hostile_is_left_out_and_the_page_draws_on(context: Any, corner: Path, file: str) -> None:
    street = Street(context, file, corner)
    tile = next(name for name in street.files if not name.startswith("models"))
    count = np.frombuffer(street.files[tile], "<u4", 2)
    vertices, faces = int(count[0]), int(count[1])
    bad_place = bytearray(street.files[tile])
    struct.pack_into("<f", bad_place, 12, float("nan"))
    bad_corner = bytearray(street.files[tile])
    struct.pack_into("<I", bad_corner, 12 + 12 * vertices, 2**32 - 1)
    street.files |= {
        "nan": bytes(bad_place),
        "corner": bytes(bad_corner),
        "short": street.files[tile][:-4],
        "huge": struct.pack("<3I", 2**31, 2**31, 2**31),
        "none": b"",
    }
    assert faces > 1

    # 1. Words and names that are markup.
    for say, told in WORDS[file]:
        street.hear(say, **told)
    street.hear("street", **{**street.lines["street"], "names": [EVIL] * 64})
    street.hear("way", **street.lines["way"])
    street.draws()
    before = street.seen()

    # 2. Tiles that are none: those that are good are drawn.
    good = street.lines["street"]["tiles"]
    bad = ["nan", "corner", "short", "huge", "none", "missing", "../page.css", EVIL]
    street.hear("street", **{**street.lines["street"], "tiles": [*bad, *good]})
    street.until(lambda: street.page.evaluate("document.body.dataset.tiles") == str(len(good)))
    street.draws()

    # 3. Moments that are none.
    nowhere = np.full(3, np.nan).tobytes() + np.full(6, np.nan, "<f4").tobytes()
    head = street.moment[: 4 + 5]
    body = street.moment[9:]
    for moment in (head + nowhere + body[48:], head + body[:48] + b"\xff\xff" + body[50:], head + body[:20], head):
        street.show(moment)
        street.draws()

    # 4. Lines that are none.
    for line in ("{", "[]", '{"say": "constructor"}', '{"say": "street"}', '{"say": "way", "points": [[0, 0]]}'):
        street._socket.send(line)
    street.hear("street", **{**street.lines["street"], "number": 9, "from": [0.0, None, 0.0]})
    street.draws()

    # 5. It looks as before: a number that is none would stay in the camera's place forever.
    street.page.wait_for_timeout(1000)
    after = street.seen()
    assert before.std() > 20.0
    assert np.abs(after - before).mean() < 8.0
    assert street.errors == []
    assert street.page.evaluate("document.querySelectorAll('img, body script').length") == 0
    assert street.page.title() != "1"
    street.page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("file", WORDS)
def test_axe_finds_nothing_in_either_scheme(context: Any, corner: Path, file: str, scheme: str) -> None:
    street = Street(context, file, corner)
    street.page.emulate_media(color_scheme=scheme)
    for say, told in WORDS[file]:
        if say != "busy":  # which covers the picture
            street.hear(say, **told)
    for line in ("street", "way"):
        street.hear(line, **street.lines[line])
    street.draws()
    axe_finds_nothing(street.page)
    street.page.close()

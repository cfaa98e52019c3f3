"""Pages by themselves: their files, and a socket whose other end is the test. What they say is heard at once."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from wcsim.drive.driven import DriverKind
from wcsim.drive.messages import spoken
from wcsim.drive.serving.access_control import content_policy
from wcsim.drive.serving.server import PAGE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage"]
IN_CHROMIUM = (
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: install Debian's package chromium"),
)
ADDRESS = "http://127.0.0.1:9/"
POLICY = content_policy("127.0.0.1:9")
KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
PAD = "window.pads = []; navigator.getGamepads = () => window.pads;"
PATIENCE_MS = 60_000
Heard = list[dict[str, Any]]
STEADY = 4  # so many alike, one after the other, are what the page says of its stick now
REST = (0.0, 0.0)
PRESSED = ("ArrowUp", "ArrowDown", "Control", "Meta", "Space", "Enter", "b", "o", "1", "2", "3")

ABOUT: dict[str, Any] = {
    "place": "a corner", "town": "corner", "seed": 21, "policy": "dwa", "profile": "competent", "points": [REST],
    "towns": ["corner"], "profiles": ["competent"], "suites": {}, "levels": (0.0, 2.0), "own_level": 1.0,
    "tells_unsafe": True, "tick_s": 0.1,
}  # fmt: skip
KPIS = {
    "kpi1": 0.0, "kpi2": 1.0, "ticks": 1, "way_m": 0.0, "crashes": 0, "drops": 0, "arrivals": 0, "helps": 0,
    "overrules": 0, "warnings": 0, "interventions": 0,
}  # fmt: skip
STATE = {
    "tick": 1, "time_s": 0.1, "driver": DriverKind.PERSON, "paused": False, "waiting": "", "let_go": False,
    "alone": False, "pace": 1.0, "stick": REST, "commanded": REST, "unsafe": [], "assisted": True, "level": 1.0,
    "help_s": 0.0, "warning": False, "intervening": False, "overruled": False, "on_road": False, "speed_mps": 0.0,
    "left_m": 9.0, "bearing_deg": 0.0, "crash": "", "profile": "competent", "kpis": KPIS, "real": 1.0,
    "shape": [1.0, 1.0],
}  # fmt: skip


def let_go(page: Any) -> None:
    """Release whatever a test may have pressed on a page, and make its browser forget what it has kept."""
    for key in PRESSED:
        page.keyboard.up(key)
    for button in ("left", "middle", "right"):
        page.mouse.up(button=button)
    page.mouse.move(0, 0)
    page.evaluate("localStorage.clear()")


def axe_finds_nothing(page: Any) -> None:
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    assert [(each["id"], [node["html"][:90] for node in each["nodes"]]) for each in found] == []


def touches(page: Any) -> Callable[[str, float], None]:
    """Puts a finger so much of the disc's half above its middle."""
    send = page.context.new_cdp_session(page).send
    disc = page.locator("#stick svg")
    disc.scroll_into_view_if_needed()
    box = disc.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def touch(kind: str, ahead: float) -> None:
        points = [] if kind == "touchEnd" else [{"x": x, "y": y - ahead * box["height"] / 2}]
        send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    return touch


class PageAlone:
    """A page that has met its server.

    Args:
        context: Of a browser.
        file: Of the page.
    """

    def __init__(self, context: Any, file: str) -> None:
        self._file = file
        self.said: Heard = []
        self.errors: list[str] = []
        self._socket: Any = None
        self._asked = 0
        context.set_default_timeout(PATIENCE_MS)
        context.route("**/*", self._read)
        context.route_web_socket("**/socket", self._meet)
        self.page = context.new_page()
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.add_init_script(PAD)
        self.open()

    def open(self) -> None:
        """Read the page, again too."""
        self._socket = None
        self.page.goto(ADDRESS)
        self.until(lambda: self._socket is not None)

    def anew(self) -> None:
        """Read the page as somebody does who comes for the first time and holds nothing."""
        let_go(self.page)
        self.said.clear()
        self.errors.clear()
        self.open()

    def hear(self, say: str, **told: object) -> None:
        """The server says something."""
        self._socket.send(spoken(say, told).decode())

    def until(self, is_so: Any) -> None:
        for _ in range(PATIENCE_MS // 20):
            if is_so():
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"never; the last it said were {self.said[-3:]}")

    def catch_up(self) -> None:
        """Until the page has taken all that it has heard, and what it said by then has come: it answers pictures."""
        self._asked += 1
        self._socket.send(self._asked.to_bytes(4, "little"))
        self.until(lambda: {"say": "shown", "number": self._asked} in self.said)

    def text(self, selector: str) -> str:
        return str(self.page.locator(selector).text_content())

    def _read(self, route: Any) -> None:
        name = route.request.url.removeprefix(ADDRESS) or self._file
        path = PAGE / Path(name).name
        headers = {"Content-Type": KINDS[path.suffix], "Content-Security-Policy": POLICY}
        route.fulfill(body=path.read_bytes(), headers=headers)

    def _meet(self, socket: Any) -> None:
        self._socket = socket
        socket.on_message(lambda data: self.said.append(json.loads(data)))


class Stage(PageAlone):
    """The page of a drive, which drives."""

    def __init__(self, context: Any) -> None:
        super().__init__(context, "index.html")

    def open(self) -> None:
        """Read the page, again too."""
        super().open()
        self.hear("about", **ABOUT)
        self.role(drives=True)
        self.state()

    def role(self, *, drives: bool) -> None:
        self.hear("role", drives=drives, taken=not drives, told="" if drives else "Another page is driving.")
        self.page.wait_for_selector(f"body[data-drives={str(drives).lower()}]")

    def state(self, **changes: object) -> None:
        """The drive is as it is."""
        self.hear("state", **{**STATE, **changes})
        self.catch_up()

    def sticks(self) -> set[tuple[float, float]]:
        """Where it says that its stick is, once it says so again and again: one place."""
        return {(stick["x"], stick["y"]) for stick in self._sticks()}

    def overrules(self) -> bool:
        """What it says of the button that overrules."""
        return bool(self._sticks()[-1]["overrule"])

    def away(self) -> bool:
        """What it says of whether somebody looks at it."""
        return bool(self._sticks()[-1]["away"])

    def heard(self, say: str) -> Heard:
        """What it has said of this kind since it was asked last."""
        self.catch_up()
        found = [message for message in self.said if message["say"] == say]
        self.said.clear()
        return found

    def _sticks(self) -> Heard:
        self.catch_up()
        self.said.clear()
        newest: Heard = []

        def is_steady() -> bool:
            newest[:] = [message for message in self.said if message["say"] == "stick"][-STEADY:]
            return len(newest) == STEADY and newest.count(newest[0]) == STEADY

        self.until(is_steady)
        return newest

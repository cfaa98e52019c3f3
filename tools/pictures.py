"""Make the pictures and figures of README and docs: `python -m tools.pictures [PART ...]`.

A part is what one run shows. Runs lie in results/, and are not made again while they are there.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from tools import sensor_pictures
from tools.speed_chart import PICTURES, drawn
from wcsim.agents.evaluation.suite.result_files import TestResult, read_result
from wcsim.cli.main import main as wcsim
from wcsim.types import U8
from wcsim.view.report.comparisons import verdict
from wcsim.view.report.failures import order_of
from wcsim.view.report.twin_film import film_twins, telling_episode

RUNS, README = Path("results"), Path("README.md")
FIGURES = PICTURES / "help.json"  # what README says of the help
FRAME_MS = 100
QUALITY, MOST_BYTES = 45, 2_500_000
_SAID = re.compile(r"(?<=<!-- help -->\n).*?(?=\n<!-- /help -->)", re.DOTALL)


def main(words: Sequence[str]) -> None:
    """Make the named parts, or all. Raises SystemExit for an unknown one."""
    for name in words or PARTS:
        if name not in PARTS:
            raise SystemExit(f"unknown part {name!r}; expected one of: {', '.join(PARTS)}")
        print(f"{name}: {PARTS[name].__doc__}", flush=True)
        PARTS[name]()


def _run(name: str, words: str) -> Path:
    """The folder of a run; it is made by a command where it is not there."""
    out = RUNS / name
    if not out.exists():
        wcsim([*words.split(), "--out", str(out)])
    return out


def film() -> None:
    """A drive of `wcsim demo`, alone and with help, 5 minutes."""
    run = _run("demo", "demo")
    result = read_result(run / "test")
    policy = next(reversed(result.episodes))
    key = telling_episode(result, policy)
    _, frames = film_twins(RUNS / "film.webm", order_of(result, run / "test", ()), result, policy, key, lambda *_: None)
    write_webp(PICTURES / "ride.webp", frames, FRAME_MS)


def write_webp(path: Path, frames: Sequence[U8], frame_ms: int) -> None:
    """An animation that runs for ever. Raises SystemExit when it is too large for a page."""
    film = cv2.Animation()
    film.frames = [np.ascontiguousarray(frame[..., ::-1]) for frame in frames]
    film.durations = [frame_ms] * len(frames)
    cv2.imwriteanimation(str(path), film, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    if path.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{path}: {path.stat().st_size} bytes; expected at most {MOST_BYTES}: reduce QUALITY")


def figures() -> None:
    """What the help of the shipped network is worth on the list hard, 4 minutes."""
    test = _run("help", "test shipped --suite hard --only --forks 0 --jobs 2")
    say_help(read_result(test), FIGURES, README)


def say_help(result: TestResult, figures: Path, readme: Path) -> None:
    """Write a test's rows to a file, and its verdict into README."""
    said = verdict(result)
    kept = {"verdict": said, "list_sha256": result.list_sha256, "pooled": result.to_json()["pooled"]}
    figures.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    readme.write_text(_SAID.sub(said, readme.read_text(encoding="utf-8")), encoding="utf-8")


def learning() -> None:
    """Steps between crashes while preset reward learns, 41 minutes."""
    run = _run("reward-1", "train --preset reward --town helsinki --worlds 1")
    wcsim(["report", str(run)])
    shutil.copy(run / "report" / "steps-between-crashes.svg", PICTURES / "learning.svg")


def pages() -> None:
    """The report of the demo's drives, the page to drive on and that of a film; they need chromium and playwright."""
    from playwright.sync_api import sync_playwright

    report = RUNS / "demo" / "test" / "report.html"
    wcsim(["report", str(report.parent)])
    drive = _run("one.drive", "users record helsinki --minutes 2")
    with sync_playwright() as play:
        # The second flag draws the street without a graphics card.
        args = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        chromium = play.chromium.launch(executable_path=shutil.which("chromium"), args=args)
        page = chromium.new_page(viewport={"width": 1440, "height": 900})  # ends with the playwright

        def shot(address: str, name: str) -> None:
            page.goto(address)
            page.wait_for_timeout(15_000)  # until the street is there
            if name == "drive_page.png":
                page.select_option("#driver", "simulated")
                page.locator("#lamp-warning[data-on=true]").wait_for(timeout=600_000)
                page.click("#pause")
                page.wait_for_timeout(4_000)  # what stands still is drawn as fine as the screen
            page.screenshot(path=PICTURES / name)

        shot(report.resolve().as_uri(), "report_page.png")
        for words, name in (("drive --policy shipped", "drive_page.png"), (f"log play {drive}", "film_page.png")):
            command = f"{Path(sys.executable).parent / 'wcsim'} {words} --port 0"
            with subprocess.Popen(command.split(), stdout=subprocess.PIPE, text=True) as served:
                lines = (re.search(r"http://\S+", line) for line in served.stdout or ())
                shot(next(found[0] for found in lines if found), name)
                served.terminate()


def models() -> None:
    """Cameras, IMU, chairs and users, and the chart of ticks a second from the numbers beside it, 3 minutes."""
    sensor_pictures.main(PICTURES)
    numbers = json.loads((PICTURES / "speed.json").read_text(encoding="utf-8"))
    (PICTURES / "speed.svg").write_text(drawn(numbers), encoding="utf-8")
    wcsim(["chair", "check", "--pictures", str(PICTURES)])
    words = f"-m benchmarks users --pictures {PICTURES} --routes 1 --seconds 30 --no-arrivals"
    subprocess.run([sys.executable, *words.split()], check=True)


PARTS: dict[str, Callable[[], None]] = {each.__name__: each for each in (film, figures, learning, pages, models)}

if __name__ == "__main__":
    main(sys.argv[1:])

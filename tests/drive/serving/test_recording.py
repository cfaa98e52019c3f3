"""`wcsim drive --record`: what a page drove is kept, and the commands take it."""

import re
import signal
from pathlib import Path

import pytest

from tests.drive.serving.served import FakePage, served
from wcsim.cli.main import main

pytestmark = pytest.mark.timeout(900)


def test_a_served_drive_is_kept_world_by_world(
    corner: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.drive"
    with served(corner, "--record", str(path)) as (address, process):
        with FakePage(address) as page:
            page.until(lambda message: message["say"] == "keeping" and message["on"])
            page.drive_off()
            page.say("newplace")
            page.drive_off()
            page.say("pause", on=True)
            page.state(lambda state: state["paused"])
            page.say("pause", on=False)
            page.say("again")
            page.until(lambda message: message["say"] == "about")  # before, states may be of the old world
            page.drive_off()
            page.say("open", town=str(corner), seed=9)
            page.until(lambda message: message["say"] == "about" and message["place"].endswith("seed 9"))
            page.drive_off()
            with FakePage(address) as late:
                told = late.until(lambda message: message["say"] == "keeping")
                assert told["on"] and told["file"].endswith("a-3.drive"), "who comes later is told too"
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=120)
    files = [path, tmp_path / "a-2.drive", tmp_path / "a-3.drive"]
    assert re.findall(r"^wrote (\S+): \d+ ticks", said, re.MULTILINE) == [str(each) for each in files]
    assert said.count("recording to ") == 3
    for file in files:
        assert main(["log", "verify", str(file)]) == 0
        assert "all equal" in capsys.readouterr().out
    assert main(["log", "convert", str(path), str(tmp_path / "a.mcap")]) == 0
    assert main(["drive", str(corner), "--record", str(path)]) == 2
    assert "exists; expected the name of a new file" in capsys.readouterr().err

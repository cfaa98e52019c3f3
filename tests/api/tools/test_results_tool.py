"""`make results`: parts, what is typed, what is left of the user's crashes."""

import json
import sys

from tests.view.report.results import write_result
from tools.results.__main__ import code_of, command_of, is_done, main
from tools.results.parts import Part, judged, parts, trained
from tools.results.tables import page, suite_table
from wcsim.agents.runs.run_folder import create_run_folder, make_run_manifest
from wcsim.config import RunConfig, resolve
from wcsim.server.specs import RunInfo


def test_every_part_has_a_name_of_its_own_and_settings_that_exist(tmp_path):
    found = parts(tmp_path)
    assert len({part.name for part in found}) == len(found)
    for part in found:
        for step in part.steps:
            settings = [step.words[at + 1] for at, word in enumerate(step.words) if word == "--set"]
            if "--preset" in step.words:
                resolve(step.words[step.words.index("--preset") + 1], tuple(settings))


def test_what_is_made_is_not_made_again_and_what_was_stopped_goes_on(tmp_path):
    step = trained(tmp_path, "run", 1)
    part = Part(name="p", says="", steps=(step,))
    assert command_of(step)[1:] == [*step.words] and not is_done(part)
    run = create_run_folder(tmp_path / "run", RunConfig(), make_run_manifest(RunConfig(), RunInfo(seed=1)))
    run.policy("final").mkdir()
    (run.policy("final") / "policy.json").touch()
    for status in ("running", "interrupted"):
        run.with_status(status, 100)
        assert command_of(step)[1:] == ["resume", str(tmp_path / "run")] and not is_done(part)
    run.with_status("done", 100)
    assert is_done(part)


def test_a_table_that_is_there_is_made(tmp_path):
    step = judged(tmp_path, ())
    assert not step.is_made
    step.makes.parent.mkdir()
    step.makes.touch()
    assert step.is_made


def test_a_command_that_ctrl_c_stops_saves_its_work_first(tmp_path):
    saves = (
        "import os, pathlib, signal, sys, time\nos.kill(os.getppid(), signal.SIGINT)\ntime.sleep(1.0)\n"
        "pathlib.Path(sys.argv[1]).touch()\nsys.exit(int(sys.argv[2]))"
    )
    for told, code in ((3, 3), (0, 130)):
        saved = tmp_path / f"saved-{told}"
        assert code_of([sys.executable, "-c", saves, str(saved), str(told)]) == code
        assert saved.is_file()


def test_an_unknown_part_is_refused(tmp_path, capsys):
    assert main(["laptpo", "--out", str(tmp_path)]) == 2
    assert "'laptpo' is unknown; expected one of baselines" in capsys.readouterr().out
    assert main(["--list", "quick", "--out", str(tmp_path)]) == 0
    assert "quick" in capsys.readouterr().out


def test_a_folder_without_tables_has_none(tmp_path):
    assert page(tmp_path) == ""


def test_a_table_has_the_columns_of_the_console(tmp_path):
    write_result(tmp_path)
    lines = suite_table(json.loads((tmp_path / "result.json").read_text("utf-8")), tmp_path).splitlines()
    assert "| part | policy | drives with a crash | did what was asked |" in lines[0]
    assert any(line.startswith("| all | dwa | 0 of 12 (0% to ") for line in lines)
